"""The child of a case: runs the command line of the tree under test; early stages come from the clean run.

``python drive.py SPEC.json`` with that tree on the path. The spec: ``src`` (that tree), ``command`` (of ``tiegraph
run``), ``out``, ``until``, ``clean`` (a finished run folder of the survey without its fault, or null) and ``redo`` (the
first stages that see the fault). What they and those after them need is taken over from the clean folder, with keys and
hashes that say what these files now stand for, as if that stage had run here; the tool itself then decides what to run.
"""

from __future__ import annotations

import json
import os
import shutil
import sys
from pathlib import Path
from typing import Any

_SCENE = ("time_s", "world_from_rig", "position_sigma_m", "origin", "prior")  # what positions and times change in it
_LINKED = ("masks", "classes", "preview")  # read only, one file an image


def main(spec: dict[str, Any]) -> int:
    """Run one case; the exit code of the command line."""
    import tiegraph
    from tiegraph.cli.main import main as command_line

    found = Path(tiegraph.__file__).resolve().parents[1]
    if found != Path(spec["src"]):
        raise SystemExit(f"{sys.executable} runs {found}, not {spec['src']}: `sh setup.sh` in that checkout")
    command, out = [str(w) for w in spec["command"]], Path(spec["out"])
    if spec["clean"] and "scan" not in spec["redo"]:
        code = command_line([*command, "--until", "scan"])
        if code:
            return code
        adopt(out, Path(spec["clean"]), set(spec["redo"]), command)
    return command_line([*command, "--until", spec["until"]])


def adopt(out: Path, clean: Path, redo: set[str], command: list[str]) -> None:
    """Take over from ``clean`` what the stages made that neither are in ``redo`` nor come after one that is."""
    from tiegraph.pipeline import STAGES
    from tiegraph.project.stages import Receipts

    keys, late = _keys(command), set(redo)
    mine, theirs = Receipts(out), Receipts(clean)
    for stage in STAGES:
        if late & set(stage.needs):
            late.add(stage.name)
        if stage.name == "scan" or stage.name in late or "key" not in theirs.read(stage.name):
            continue
        ledger = theirs.files(stage.name) or {}
        for name in ledger:
            _take(clean / name, out / name, name.split("/")[0] in _LINKED)
        if stage.name == "network":
            _new_positions(out, clean)
        _enter(out, stage, ledger, (mine, theirs), keys[stage.name])


def _keys(command: list[str]) -> dict[str, str]:
    """The key of every stage for a command line of ``tiegraph run``."""
    from tiegraph.api import open_project
    from tiegraph.pipeline import STAGES

    at = {word: k for k, word in enumerate(command)}
    given = {n: command[at[f"--{n}"] + 1] for n in ("rig", "gnss", "times") if f"--{n}" in at}
    project = open_project(command[1], command[at["-o"] + 1], **given)
    return project.as_run().keys(STAGES)


def _take(source: Path, target: Path, link: bool) -> None:
    target.parent.mkdir(parents=True, exist_ok=True)
    if target.exists() or target.is_symlink():
        return
    if source.is_symlink():
        os.symlink(os.readlink(source), target)
    elif link:
        os.link(source, target)
    else:
        shutil.copy2(source, target)


def _new_positions(out: Path, clean: Path) -> None:
    """The network's copy of the scene with the positions that this run's scan found."""
    new, was = (json.loads((folder / "scene.json").read_text()) for folder in (out, clean))
    path = out / "network" / "scene.json"
    checked = json.loads(path.read_text())
    if any(new[c] != was[c] for c in ("names", "frame", "sensor")):
        raise RuntimeError("the scan sorted the images otherwise than that of the clean run")
    path.unlink()
    path.write_text(json.dumps(checked | {c: new[c] for c in _SCENE}))


def _enter(out: Path, stage: Any, ledger: dict, receipts: tuple[Any, Any], key: str) -> None:
    from tiegraph.project.stages import digest_of, recorded

    mine, theirs = receipts
    receipt = theirs.read(stage.name)
    if stage.name == "network":
        ledger = ledger | recorded(out, ["network/scene.json"])
    made = digest_of({n: e for n, e in ledger.items() if n not in stage.changes}, stage.makes)
    whole = {need: mine.read(need).get("made") for need in stage.needs}
    mine.write_files(stage.name, ledger)
    mine.write(stage.name, receipt | {"key": key, "from": whole, "made": made, "adopted": True})


if __name__ == "__main__":
    sys.exit(main(json.loads(Path(sys.argv[1]).read_text())))
