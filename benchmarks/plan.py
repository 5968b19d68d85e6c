"""Planned sigmas against those that runs report, and against the errors that their models really have.

``python -m benchmarks.plan canal=RUN kitti_stereo=RUN pandaset=RUN ... -o benchmarks/results/plan.json`` reads run
folders (``benchmarks/run.py --keep`` leaves them) and changes nothing there. A plan is told what is known before going:
cameras, how the rig is made, the way, how far walls are, the class of the receiver. A run whose rig was relaxed is
compared by the paths of its cameras, planned one by one: see docs/plan.md.
"""

from __future__ import annotations

import argparse
import json
import re
import sys
import tempfile
from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

import tiegraph  # noqa: F401  (zlib before pycolmap)

import pycolmap  # isort: skip

from benchmarks import datasets
from benchmarks.sigma import reference_poses
from tiegraph.geometry import transforms
from tiegraph.geometry.align import umeyama
from tiegraph.pipeline.plan import plan, reached
from tiegraph.plan.compare import comparison
from tiegraph.plan.request import CameraRequest, ImageRequest, PathRequest, PlanRequest, WorldRequest

_BOAT = WorldRequest(gnss="0.02,0.03")
_STREET = PathRequest(shape="road", length=6)
# What each set is planned from; ``{rig}`` is the rig file that a user has, ``{rig:CAMERA}`` one camera of it.
REQUESTS: Mapping[str, PlanRequest] = {
    "canal": PlanRequest(
        CameraRequest(rig="ring:5", focal_px=309, size="640x480"), ImageRequest(distance="10.4", base="1.92"),
        PathRequest(shape="canal", length=46), _BOAT,
    ),
    "canal_demo": PlanRequest(
        CameraRequest(rig="ring:5", focal_px=232, size="480x360"), ImageRequest(distance="10.4", base="2.1"),
        PathRequest(shape="canal", length=19), _BOAT,
    ),
    "kitti_stereo": PlanRequest(
        CameraRequest(rig="{rig}"), ImageRequest(distance="10", base="1.2"), PathRequest(shape="road", length=60)
    ),
    "pandaset": PlanRequest(
        CameraRequest(rig="{rig:front_camera}"), ImageRequest(distance="12", base="0.12"), _STREET,
        WorldRequest(gnss="0.5,0.5"),
    ),
}  # fmt: skip
_SIGMAS = ("position_shape", "place_world", "height_world")


def main(argv: list[str] | None = None) -> int:
    """Command line; 0 when all is compared."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="+", help="SET=FOLDER: data set and its run folder")
    parser.add_argument("-o", "--output", type=Path)
    args = parser.parse_args(argv)
    rows = []
    for item in args.runs:
        name, folder = item.split("=", 1)
        with tempfile.TemporaryDirectory() as scratch:
            rows.append(measure(name, Path(folder), Path(scratch)))
        sys.stdout.write(json.dumps(rows[-1], indent=1) + "\n")
        sys.stdout.flush()
    if args.output:
        args.output.write_text(json.dumps({"rows": rows}, indent=1) + "\n")
    return 0


def measure(name: str, folder: Path, scratch: Path) -> dict[str, Any]:
    """Planned, reported and actual figures of a set, metres, and their ratios."""
    dataset = datasets.load(name, scratch)
    made = plan(_with_files(REQUESTS[name], dataset, scratch)).to_dict()
    run = reached(folder)
    path = made["path"]
    assert isinstance(path, dict)
    out: dict[str, Any] = {"set": name, "sentence": comparison(made, run).sentence}
    for key in (f"{s}_sigma_median_m" for s in _SIGMAS):
        planned, reported = path.get(key), run.get(key)
        out[key] = {
            "planned": _rounded(planned), "reported": _rounded(reported),
            "reported / planned": round(reported / planned, 2) if planned and reported else None,
        }  # fmt: skip
    error = actual_m(dataset, folder, relaxed=bool(run.get("relaxed")))
    sigma = run.get("position_shape_sigma_median_m")
    out["error_in_shape_m"] = _rounded(error)
    out["error / reported"] = round(error / sigma, 2) if sigma else None
    return out


def actual_m(dataset: datasets.Dataset, folder: Path, *, relaxed: bool) -> float:
    """Median error of positions after the best similarity; of a relaxed rig, camera by camera."""
    model = pycolmap.Reconstruction(folder / "sparse" / "0")
    truth = reference_poses(model, dataset)
    groups: dict[int, list[int]] = {}
    for frame in truth:
        images = [model.image(d.id) for d in model.frame(frame).image_ids]
        groups.setdefault(images[0].camera_id if relaxed else 0, []).append(frame)
    errors = []
    for frames in groups.values():
        poses = [model.frame(f).rig_from_world for f in frames]
        here = np.stack([p.tgt_origin_in_src() for p in poses if p is not None])
        there = np.stack([transforms.centre(truth[f]) for f in frames])
        errors.append(float(np.median(np.linalg.norm(umeyama(here, there)(here) - there, axis=1))))
    return float(np.median(errors))


def _with_files(request: PlanRequest, dataset: datasets.Dataset, scratch: Path) -> PlanRequest:
    """The request with the set's own rig file, or one camera of it."""
    text = request.camera.rig or ""
    found = re.fullmatch(r"\{rig(?::(\w+))?\}", text)
    if found is None:
        return request
    file = Path(str(dataset.rig))
    if found[1]:
        head, *sensors = file.read_text().split("[[sensors]]")
        own = next(s for s in sensors if f'name = "{found[1]}"' in s)
        file = scratch / f"{found[1]}.toml"
        file.write_text(head + "[[sensors]]" + own)
    return PlanRequest(CameraRequest(rig=str(file)), request.images, request.path, request.world)


def _rounded(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.4g}")


if __name__ == "__main__":
    sys.exit(main())
