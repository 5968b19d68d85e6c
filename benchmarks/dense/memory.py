"""Peak memory of the dense stages on a whole survey: the main process and all its workers together.

Takes a finished run's model, images and masks (with --only cloud its depth maps too) by links; the run stays as it is.

python -m benchmarks.dense.memory OUT --store WORK -o memory.json
"""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path

from tiegraph.pipeline.dense import cloud, dense
from tiegraph.pipeline.files import FINAL
from tiegraph.project.inputs import Inputs
from tiegraph.project.progress import Meter
from tiegraph.project.run import Run
from tiegraph.project.settings import Settings

_NEEDED = ("scene.json", "world.json", "sparse", "images", "masks", FINAL, "network")
_STAGES = {"dense": dense, "cloud": cloud}


def main() -> None:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("out", type=Path, help="a run folder with sparse/world, images and final masks")
    parser.add_argument("--store", type=Path, required=True, help="an empty folder for depth maps and clouds")
    parser.add_argument("--only", choices=_STAGES)
    parser.add_argument("-o", "--output", type=Path)
    args = parser.parse_args()
    args.store.mkdir(parents=True, exist_ok=True)
    for name in (*_NEEDED, *(["depth"] if args.only == "cloud" else [])):
        if (args.out / name).exists() and not (args.store / name).exists():
            (args.store / name).symlink_to((args.out / name).resolve())
    if not (args.store / FINAL).exists():  # a run that ended before its final masks: the first ones
        (args.store / FINAL).mkdir()
        (args.store / FINAL / "masks").symlink_to((args.out / "masks").resolve())
    run = Run(args.store, Inputs(args.store / "images"), Settings())
    figures = {}
    for name, stage in _STAGES.items():
        if args.only in (None, name):
            meter = Meter(0.1)
            outcome = stage(run)
            spent = meter.stop()
            figures[name] = {**spent, "workers": run.workers, "counts": outcome.counts, "notes": list(outcome.notes)}
            sys.stdout.write(f"{name} {json.dumps(figures[name])}\n")
    run.close()
    if args.output:
        args.output.write_text(json.dumps(figures, indent=1) + "\n")


if __name__ == "__main__":
    main()
