"""A file of a finished run is damaged; the same command again must make it anew, or say what is wrong with it."""

from __future__ import annotations

from pathlib import Path

from campaign import mutate, oracle
from campaign.case import Case, Result, wrong
from campaign.compare import owned
from campaign.world import NAMES, PATIENCE_S


def run(case: Case) -> Result:
    """One damaged file: the stage goes round with the case's number, every third time it is the stage's receipt."""
    rng, world = case.rng, case.world
    stage = NAMES[case.index % len(NAMES)]
    end = NAMES[-1]
    out = world.after(end, case.folder / "out")
    path = _victim(out, stage, rng, receipt=case.index // len(NAMES) % 3 == 2)
    rules = (*mutate.BYTES, mutate.folder_instead, mutate.gone, mutate.loop_instead)
    linked = path.is_symlink()
    if linked:  # never write through a link into the inputs
        content = path.read_bytes()
        path.unlink()
        path.write_bytes(content)
    try:
        what = f"{stage}: {path.relative_to(out)}: {rng.choice(rules)(path, rng)}"
    except mutate.Unfit:
        what = f"{stage}: {path.relative_to(out)}: {mutate.gone(path, rng)}"
    if rng.random() < 0.5:  # later stages must run again and meet the damage
        _outdate(out, stage, rng)
        what += ", a later receipt gone"
    damage = _content(path)
    ended = case.server.run(world.command(out, "--pool", "serial"), case.folder, PATIENCE_S)
    words = (path.name, path.parent.name, path.stem, stage, *_made(stage))
    if ended.code == 0:
        fault = wrong(case, ended, out, {}, changed=True)
        if fault is None and _content(path) == damage:
            fault = oracle.Verdict(oracle.SILENT, "the damaged file is there still")
        if fault is None:
            fault = oracle.Verdict(oracle.SAID if oracle.holds(ended.text, (path.name,)) else oracle.HARMLESS)
        return case.result(stage, what, fault, ended.text)
    verdict = oracle.refusal(ended, words)
    if verdict.name in oracle.GOOD:  # a refusal is right once; the remedy it names is to remove the file
        verdict = _heals(case, out, path, verdict)
    return case.result(stage, what, verdict, ended.text)


def _heals(case: Case, out: Path, path: Path, verdict: oracle.Verdict) -> oracle.Verdict:
    if path.is_dir() and not path.is_symlink():
        path.rmdir()
    else:
        path.unlink(missing_ok=True)
    ended = case.server.run(case.world.command(out, "--pool", "serial"), case.folder, PATIENCE_S)
    return wrong(case, ended, out, {}, changed=True) or verdict


def _content(path: Path) -> object:
    """What is at a path; None = nothing."""
    if path.is_symlink():
        return path.readlink()
    if path.is_dir():
        return "folder"
    return path.read_bytes() if path.exists() else None


def _made(stage: str) -> tuple[str, ...]:
    from tiegraph.pipeline import STAGES

    return next(s.makes for s in STAGES if s.name == stage)


def _victim(out: Path, stage: str, rng: object, receipt: bool) -> Path:
    """A file of the stage."""
    if receipt:
        found = sorted(out.rglob(f"receipts/{stage}.json"))
    else:
        found = sorted(out / name for name, owner in owned(out).items() if owner == stage)
    return rng.choice(found)  # type: ignore[attr-defined]


def _outdate(out: Path, stage: str, rng: object) -> None:
    later = NAMES[NAMES.index(stage) + 1 :] or NAMES[-1:]
    for path in out.rglob(f"receipts/{rng.choice(later)}.json"):  # type: ignore[attr-defined]
        if path.is_file():
            path.unlink()
