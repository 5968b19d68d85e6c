"""Images arriving at a rate: does `tiegraph watch` keep up, and how long after its last byte is an image on the page?

    TIEGRAPH_DATA=... python -m benchmarks.watch [--set canal] [--images 200] [--rate 2] --work DIR [-o FILE]

The first images of a set, in the order in which a boat with its rig would write them (pass, frame, camera), are copied
one by one into a folder that is watched by a process of its own. Latency: from the end of a copy to the line that says
the image's preview and ties are made and its pose was tried; it holds the time that a file must rest before it is
opened (`watch/tuning.py`). Backlog: images not done when the last one was copied. On a machine that is busy with other
work these say how busy it is; so the CPU time of each image is taken too, and what the latencies of a queue would be
that is served by a core of its own (``own_core``).
"""

from __future__ import annotations

import argparse
import json
import os
import queue
import resource
import shutil
import signal
import subprocess
import sys
import threading
import time
import urllib.request
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.datasets import data_root
from tiegraph.watch.tuning import ArrivalsTuning

_RIGS = {"canal": "ladybug5", "canal_demo": "ladybug5"}
_PATIENCE_S = 300.0  # after the last copy


def main() -> None:
    """Run it and print the figures as JSON."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--set", default="canal")
    parser.add_argument("--images", type=int, default=200)
    parser.add_argument("--rate", type=float, default=2.0)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("--page", type=Path, help="keep the last state of the page here")
    parser.add_argument("-o", "--out", type=Path)
    options = parser.parse_args()
    made = measured(options.set, options.images, options.rate, options.work, options.page)
    text = json.dumps(made, indent=1)
    sys.stdout.write(text + "\n")
    if options.out is not None:
        options.out.write_text(text + "\n")


def measured(name: str, images: int, rate: float, work: Path, page: Path | None = None) -> dict[str, Any]:
    """The figures of one run."""
    source = data_root() / name / "images"
    files = sorted(source.rglob("*.jpg"), key=lambda p: (p.parts[-3], p.stem, p.parts[-2]))[:images]
    shutil.rmtree(work, ignore_errors=True)
    card = work / "card"
    card.mkdir(parents=True)
    command = [sys.executable, "-m", "tiegraph", "watch", str(card), "--rig", _RIGS[name], "--port", "0", "--json"]
    process = subprocess.Popen(command, stdout=subprocess.PIPE, text=True)
    lines: queue.Queue[tuple[float, dict]] = queue.Queue()
    reader = threading.Thread(target=_read, args=(process, lines), daemon=True)
    reader.start()
    address = lines.get(timeout=120)[1]["page"]
    load = os.getloadavg()[0]
    copied = _copy(files, source, card, rate)
    last = max(copied.values())
    done, models = _wait(lines, set(copied), last + _PATIENCE_S)
    time.sleep(5)
    state = json.load(urllib.request.urlopen(f"{address}state.json"))
    process.send_signal(signal.SIGINT)
    code = process.wait(timeout=30)
    used = resource.getrusage(resource.RUSAGE_CHILDREN)
    if page is not None:
        shutil.copy(work / "card_watch" / "watch.html", page)
    latency = np.array([done[n]["at"] - copied[n] for n in done])
    cpu = np.diff(sorted(d["cpu_s"] for d in done.values()), prepend=0.0)
    cpu[0] = np.median(cpu)  # the libraries were loaded before
    return {
        "set": name, "images": len(files), "rate": rate, "done": len(done), "exit_code": code,
        "latency_s": {"median": _round(np.median(latency)), "p95": _round(np.percentile(latency, 95)),
                      "max": _round(latency.max())},
        "cpu_s_an_image": _round(cpu.mean(), 3), "own_core": _queue(cpu, rate),
        "backlog_at_last_copy": sum(d["at"] > last for d in done.values()),
        "last_done_after_last_copy_s": _round(max(d["at"] for d in done.values()) - last),
        "pose_at_once": sum(d["pose"] for d in done.values()), "posed_at_end": state["counts"]["posed"],
        "models": models, "cpu_s": _round(used.ru_utime + used.ru_stime), "load_average": [_round(load),
        _round(os.getloadavg()[0])], "cores": len(os.sched_getaffinity(0)),
    }  # fmt: skip


def _queue(cpu: np.ndarray, rate: float) -> dict[str, float]:
    """Latencies of images that need so much CPU time each (s) and arrive at a rate, one after another on one core."""
    rest = ArrivalsTuning()
    came = np.arange(len(cpu)) / rate
    free, out = 0.0, []
    for at, need in zip(came + rest.settled_s + rest.look_s, cpu):
        free = max(free, at) + need
        out.append(free)
    latency = np.array(out) - came
    late = int(np.sum(np.array(out) > came[-1] + rest.settled_s + rest.look_s + 1 / rate))
    return {"median": _round(np.median(latency)), "p95": _round(np.percentile(latency, 95)), "behind": late}


def _copy(files: list[Path], source: Path, card: Path, rate: float) -> dict[str, float]:
    """When each file was there whole, by name."""
    copied = {}
    start = time.time()
    for k, file in enumerate(files):
        time.sleep(max(0.0, start + k / rate - time.time()))
        target = card / file.relative_to(source)
        target.parent.mkdir(parents=True, exist_ok=True)
        shutil.copyfile(file, target)
        copied[file.relative_to(source).as_posix()] = time.time()
    return copied


def _wait(lines: queue.Queue, wanted: set[str], until: float) -> tuple[dict[str, dict], list[dict]]:
    """What is said of each image, and of the models, until all are done and the last model is made."""
    done: dict[str, dict] = {}
    models: list[dict] = []
    while time.time() < until and not (wanted <= set(done) and models and models[-1]["of"] == len(wanted)):
        try:
            at, event = lines.get(timeout=1)
        except queue.Empty:
            continue
        if event["event"] == "image":
            done.setdefault(event["name"], {**event, "at": at})
        elif event["event"] == "model":
            models.append({k: event[k] for k in ("images", "of", "seconds")})
    return done, models


def _read(process: subprocess.Popen, lines: queue.Queue) -> None:
    assert process.stdout is not None
    for line in process.stdout:
        lines.put((time.time(), json.loads(line)))


def _round(value: float, digits: int = 2) -> float:
    return round(float(value), digits)


if __name__ == "__main__":
    main()
