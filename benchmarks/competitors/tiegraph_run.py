"""Competitor: ``tiegraph run`` as a user calls it; figures from its receipts and its model."""

from __future__ import annotations

import json
import shutil
import subprocess
import sys
from pathlib import Path
from typing import Any

from command import arguments

from tiegraph.cli.verbs import VERBS
from tiegraph.papers.measured import Stages, pairs_of

_STAGES = [name for name, verb in VERBS.items() if verb.about.startswith("stage:")]  # of pipeline.STAGES, unloaded


def main() -> None:
    """Run the command, then hand over what its receipts say."""
    args = arguments(__doc__)
    stages = Stages(args.json)
    if args.base is not None:
        shutil.copytree(args.base, args.out, symlinks=True, dirs_exist_ok=True)
    command = [sys.executable, "-m", "tiegraph", "run", str(args.images), "-o", str(args.out)]
    command += ["--sparse.seed", str(args.seed)]
    for name in ("rig", "gnss", "trajectory", "times", "gcp"):
        if getattr(args, name):
            command += [f"--{name}", getattr(args, name)]
    done = subprocess.run([*command, "--until", args.until, *args.options], check=False, stdin=subprocess.DEVNULL)
    stages.data |= figures(args.out)
    stages.end(f"exit code {done.returncode}" if done.returncode else "")


def figures(out: Path) -> dict[str, Any]:
    """Stages (wall, CPU, memory, counts), pairs, models and origin of a run folder, as far as the run came."""
    paths = [out / "receipts" / f"{stage}.json" for stage in _STAGES]
    receipts = [json.loads(path.read_text()) for path in paths if path.exists()]
    receipts = [receipt for receipt in receipts if "finished" in receipt]
    data: dict[str, Any] = {"stages": [_row(receipt) for receipt in receipts], "models": _models(out / "sparse")}
    if (out / "database.db").exists():
        data["pairs"] = pairs_of(out / "database.db")
    if (out / "world.json").exists():
        data["world"] = json.loads((out / "world.json").read_text()).get("origin")
    return data


def _row(receipt: dict[str, Any]) -> dict[str, Any]:
    return {
        "stage": receipt["stage"],
        "wall_s": receipt["seconds"],
        "cpu_s": receipt["cpu_s"],
        "peak_mib": receipt["peak_mib"],
        "counts": receipt["counts"],
        "notes": receipt["notes"],
    }


def _models(sparse: Path) -> list[str]:
    """The georeferenced model first; it stands for the numbered one that it was made of (0, the largest)."""
    numbered = sorted((p for p in sparse.glob("*") if p.name.isdigit()), key=lambda p: int(p.name))
    if (sparse / "world").is_dir():
        numbered = [sparse / "world", *numbered[1:]]
    return [str(path) for path in numbered]


if __name__ == "__main__":
    main()
