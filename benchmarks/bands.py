"""Predicted against actual of all sets: in the world, and in shape over 10 m, 100 m and the whole.

``python -m benchmarks.bands SET=FOLDER ... [-o FILE] [--write]`` reads run folders (``benchmarks/run.py --keep`` leaves
them; to ``georef`` is enough), compares them with the truth of the set as ``tiegraph evaluate`` does with a reference,
and keeps a row a set in FILE; ``--run SET=FOLDER`` makes the run first. ``--write`` puts the table of FILE and of
``sigma.json`` between its markers in docs/benchmarks.md.
"""

from __future__ import annotations

import json
import math
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks import datasets
from benchmarks.sfm.finished import arguments, each_run
from benchmarks.table import line, put
from tiegraph.api import open_project
from tiegraph.evaluate import reference
from tiegraph.evaluate.accuracy import in_layers, pose_figures
from tiegraph.evaluate.trajectory import evaluate_trajectory
from tiegraph.geometry import transforms
from tiegraph.pipeline.files import checked, load_model, world_origin
from tiegraph.pipeline.georef import stated
from tiegraph.project.run import Run

_ROOT = Path(__file__).resolve().parents[1]
_RESULTS, _DOCUMENT = _ROOT / "benchmarks" / "results", _ROOT / "docs" / "benchmarks.md"
BEGIN, END = "<!-- python -m benchmarks.bands --write -->", "<!-- end of predicted against actual -->"
_BANDS = {
    "in the world": "world.reference_poses",
    "over 10 m": "shape.10m",
    "over 100 m": "shape.100m",
    "over the whole": "shape.whole",
}


def measure(name: str, folder: Path, scratch: Path) -> dict[str, Any]:
    """The row of a run: what it predicted of its cameras beside what the truth says; lengths in metres, or in units of
    the model where nothing told its scale."""
    dataset = datasets.load(name, scratch)
    project = open_project(None, folder)
    run = Run(project.folder, project.inputs, project.settings)
    scene, tuning, own = checked(run), run.settings.tuning.evaluate, stated(run, {})
    model = reference.model_poses(load_model(run.path("sparse", "world")), scene)
    full = {n: p for n, p in dataset.cam_from_world.items() if np.isfinite(p).all()}  # positions alone are not enough
    truth = {n: transforms.invert(np.asarray(p)) for n, p in full.items()}
    poses = reference.ReferencePoses(truth, {}, dataset.images)
    match, _ = reference.match_poses(poses, model, scene, tuning.trajectory.max_gap_s)
    origin = world_origin(run.folder) if own.world["placed"] else None
    same = origin is not None and dataset.truth_origin is not None
    if origin is not None and dataset.truth_origin is not None:
        match = reference.poses_to_world(match, dataset.truth_origin, origin)
    error = evaluate_trajectory(match, tuning.trajectory.relative_m, tuning.trajectory, same_frame=same)
    found = in_layers(own, pose_figures(match, error, own.predicted, tuning.trajectory))
    bands = {band: found.figure(key) for band, key in _BANDS.items()}
    return {
        "set": name,
        "images": len(scene),
        "matched": len(match),
        "unit": found.unit,
        "held_by": found.held_by,
        "bands": {b: [_rounded(f.predicted), _rounded(f.measured)] for b, f in bands.items()},
    }


def _rounded(value: float) -> float | None:
    return float(f"{value:.4g}") if math.isfinite(value) else None


def table(rows: Sequence[Mapping[str, Any]], sigma: Sequence[Mapping[str, Any]]) -> str:
    """A row a set, predicted / actual (actual over predicted); ``sigma``: rows of sigma.json, positions after the best
    similarity, for the sets that have no row of their own, too."""
    head = ["set, images", "held in the world by", *_BANDS, "after a similarity", "error of the truth"]
    lines = [line(head), line(["---"] * len(head))]
    own, other = {r["set"]: r for r in rows}, {r["set"]: r for r in sigma}
    for name in dict.fromkeys([*own, *other]):
        row, more = own.get(name), other.get(name)
        bands = ["not run"] * len(_BANDS) if row is None else [_pair(*row["bands"][b], row["unit"]) for b in _BANDS]
        title = f"`{name}`" if row is None else f"`{name}`, {row['images']}"
        pair = more and more["position_m"]
        similar = _pair(pair["predicted"], pair["actual"], "m") if pair else "not run"
        own_error = _length(more["truth_m"], "m") if more and "truth_m" in more else "not known"
        held = "" if row is None else row["held_by"]
        lines.append(line([title, held, *bands, similar, "none" if own_error == "0 mm" else own_error]))
    return "\n".join(lines)


def _pair(predicted: float | None, actual: float | None, unit: str) -> str:
    if predicted is None or actual is None:
        return "-"
    return f"{_length(predicted, unit)} / {_length(actual, unit)} ({actual / predicted:.2g})"


def _length(value: float, unit: str) -> str:
    if unit != "m":
        return f"{value:.2g}"
    return f"{1000 * value:.3g} mm" if value < 0.1 else f"{value:.3g} m"


def write(file: Path) -> None:
    """Put the table between its markers in docs/benchmarks.md."""
    rows = json.loads(file.read_text())["rows"]
    sigma = json.loads((_RESULTS / "sigma.json").read_text())["rows"]
    put(_DOCUMENT, BEGIN, END, table(rows, sigma))


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = arguments(__doc__, _RESULTS / "bands.json")
    parser.add_argument("--write", action="store_true", help="the table into docs/benchmarks.md")
    args = parser.parse_args(argv)
    each_run(args, measure, "georef")
    if args.write:
        write(args.output)
    return 0


if __name__ == "__main__":
    sys.exit(main())
