"""A run is ended at a random moment by a random signal to a random process; then the same command goes on."""

from __future__ import annotations

import json
import os
import random
import signal
import time
from pathlib import Path

import psutil

from campaign import oracle
from campaign.case import Case, Result, finish_again
from campaign.process import Running
from campaign.world import NAMES, PATIENCE_S, World
from tiegraph.pipeline import STAGES
from tiegraph.scene.atomic import MARK

SIGNALS = ("KILL", "TERM", "INT", "HUP", "STOP+KILL")
VICTIMS = ("main", "main", "child", "child", "group")
_ITEMS = {s.name: s.makes for s in STAGES if s.item}
_END_S = 60.0  # how long a run may take to end once it was hit


def run(case: Case) -> Result:
    """One kill. The stage goes round with the case's number, all else is drawn."""
    rng, world = case.rng, case.world
    stage = NAMES[case.index % len(NAMES)]
    before = NAMES[NAMES.index(stage) - 1] if stage != NAMES[0] else ""
    victim, kind = rng.choice(VICTIMS), rng.choice(SIGNALS)
    pool = rng.choice(("local:2", "local:1", "serial")) if victim != "child" else "local:2"
    wait = _moment(rng, world, stage)
    what = f"{stage}: {kind} to {victim}, {wait['text']}, pool {pool}"
    out = world.after(before, case.folder / "out")
    running = case.server.start(world.command(out, "--pool", pool), case.folder)
    _await(running, out, stage, wait)
    hit, main = _strike(running, victim, kind)
    # Without one of its children a run may go on until it asks for it.
    ended = running.wait(_END_S if hit and main else PATIENCE_S)
    number = signal.SIGKILL if "KILL" in kind else getattr(signal, f"SIG{kind}")
    verdict = oracle.after_signal(ended, number, main) if hit else _unhit(ended)
    what += "" if hit else " (it had ended before)"
    if verdict.name not in oracle.GOOD:
        return case.result(stage, what, verdict, ended.text)
    own = _sprinkle(out, rng)
    again = world.command(out, "--pool", rng.choice((pool, "serial", "serial", "serial")))
    after, text = finish_again(case, again, out, own)
    return case.result(stage, what, verdict if after is None else after, text)


def _moment(rng: random.Random, world: World, stage: str) -> dict:
    """When to strike: after a share of the stage's time, after a number of finished files, or from the start."""
    way = rng.choice(("time", "time", "items" if stage in _ITEMS else "time", "start"))
    if way == "items":
        count = rng.randrange(1, 13)
        return {"way": way, "items": count, "text": f"after {count} files"}
    seconds = rng.uniform(0.0, 1.2 * world.seconds[stage])
    return {
        "way": way,
        "seconds": seconds,
        "text": f"{seconds:.2f} s after the start of the {'stage' if way == 'time' else 'run'}",
    }


def _await(running: Running, out: Path, stage: str, wait: dict) -> None:
    """Sleep until the moment has come or the run has ended."""
    end = time.monotonic() + PATIENCE_S
    while wait["way"] != "start" and not _begun(out, stage) and not running.poll() and time.monotonic() < end:
        time.sleep(0.005)
    if wait["way"] != "items":
        running.poll(wait["seconds"])
        return
    while not running.poll() and time.monotonic() < end:
        if _count(out, _ITEMS[stage]) >= wait["items"] or _done(out, stage):
            return
        time.sleep(0.003)


def _receipt(out: Path, stage: str) -> dict:
    for path in (out / "receipts" / f"{stage}.json", *out.glob(f"*/receipts/{stage}.json")):
        try:
            return json.loads(path.read_text())
        except (OSError, ValueError):
            continue
    return {}


def _begun(out: Path, stage: str) -> bool:
    return bool(_receipt(out, stage))


def _done(out: Path, stage: str) -> bool:
    return "finished" in _receipt(out, stage)


def _count(out: Path, makes: tuple[str, ...]) -> int:
    return sum(len(files) for made in makes for _, _, files in os.walk(out / made))


def _strike(running: Running, victim: str, kind: str) -> tuple[bool, bool]:
    """Send the signal; (was anything hit, was it the main process)."""
    if running.poll():
        return False, False
    if victim == "child":
        end = time.monotonic() + 2.0
        children = running.children()
        while not children and time.monotonic() < end and not running.poll():
            time.sleep(0.01)
            children = running.children()
        if children:
            return _send(random.Random(running.pid).choice(children).pid, kind, os.kill), False
    send = os.killpg if victim == "group" else os.kill
    return _send(running.pid, kind, send), True


def _send(pid: int, kind: str, send: object) -> bool:
    try:
        for name in kind.split("+"):
            send(pid, getattr(signal, f"SIG{name}"))  # type: ignore[operator]
            if name == "STOP":
                time.sleep(0.3)
    except (ProcessLookupError, psutil.Error):
        return False
    return True


def _unhit(ended: object) -> oracle.Verdict:
    good = ended.code == 0 and not ended.left and not ended.hung  # type: ignore[attr-defined]
    fault = oracle.text_fault(ended)  # type: ignore[arg-type]
    return fault or (oracle.Verdict(oracle.HARMLESS) if good else oracle.Verdict(oracle.STUCK, "ended unhit"))


def _sprinkle(out: Path, rng: random.Random) -> dict[str, bytes]:
    """Files of the user put into the run folder; {path below it: content}. None if the run had not marked it as its own
    yet: it is a folder of the user then, and rightly refused."""
    own: dict[str, bytes] = {}
    if not (out / MARK).exists():
        return own
    for name in ("notes.txt", "masks/mine.png", "sparse/mine.txt"):
        if rng.random() < 0.4:
            own[name] = f"mine: {name}".encode()
            (out / name).parent.mkdir(exist_ok=True, parents=True)
            (out / name).write_bytes(own[name])
    return own
