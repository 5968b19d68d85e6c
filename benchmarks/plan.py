"""Planned sigmas against those that runs report, and against the errors that their models really have.

``python -m benchmarks.plan canal=RUN kitti_stereo=RUN pandaset=RUN ... -o benchmarks/results/plan.json`` reads run
folders (``benchmarks/run.py --keep`` leaves them) and changes nothing there. A plan is told what is known before going:
cameras, how the rig is made, the way, how far walls are, the class of the receiver. ``station=STORE``, the folder of
``benchmarks.closerange``: its wide camera's path, and the depths of its dense cameras.
"""

from __future__ import annotations

import json
import re
from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import tiegraph  # noqa: F401  (zlib before pycolmap)

import pycolmap  # isort: skip

from benchmarks import datasets
from benchmarks.closerange import world
from benchmarks.sfm.finished import arguments, each_run
from benchmarks.sigma import reference_poses
from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import umeyama
from tiegraph.pipeline.plan import plan, reached
from tiegraph.plan.planner import comparison
from tiegraph.plan.request import CameraRequest, ImageRequest, PathRequest, PlanRequest, WorldRequest
from tiegraph.scene.cloudfile import read_cloud

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
        PathRequest(shape="canal", length=19), WorldRequest(gnss="0.35,0.56"),
    ),
    "kitti_stereo": PlanRequest(
        CameraRequest(rig="{rig}"), ImageRequest(distance="10", base="1.2"), PathRequest(shape="road", length=60)
    ),
    "pandaset": PlanRequest(
        CameraRequest(rig="{rig:front_camera}"), ImageRequest(distance="12", base="0.12"), _STREET,
        WorldRequest(gnss="0.5,0.5"),
    ),
}  # fmt: skip
# Of the drawing in closerange/world.py: 12 stations at 12, 20 and 30 degrees above a body of 28 cm on a floor.
STATION = PlanRequest(
    CameraRequest(rig="{rig:wide}", calibration_px=0.05), ImageRequest(distance="0.5", base="0.0735", sidelap=0.0),
    PathRequest(shape="orbit", width=0.28, height=0.28, pitch=-20.7),
)  # fmt: skip
_SQUARE_GAIN = 0.5  # sigma of a depth from four cameras in a square over that of two a side apart
_BLUNDER_M = 0.005  # as benchmarks.closerange has it
_SIGMAS = ("position_shape", "place_world", "height_world")


def measure(name: str, folder: Path, scratch: Path) -> dict[str, Any]:
    """Planned, reported and actual figures of a set, metres, and their ratios."""
    if name == "station":
        return station(name, folder, scratch)
    dataset = datasets.load(name, scratch)
    made = plan(_with_files(REQUESTS[name], dataset, scratch)).to_dict()
    run = reached(folder)
    path = made["path"]
    assert isinstance(path, dict)
    out: dict[str, Any] = {"set": name, "sentence": comparison(made, run).sentence}
    for key in (f"{s}_sigma_median_m" for s in _SIGMAS):
        planned, reported = path.get(key), run.get(key)
        out[key] = _beside(planned, reported)
    error = float(np.median(np.linalg.norm(errors_m(dataset, folder), axis=1)))
    sigma = run.get("position_shape_sigma_median_m")
    return {**out, "error_in_shape_m": _rounded(error), "error / reported": round(error / sigma, 2) if sigma else None}


def station(name: str, store: Path, scratch: Path) -> dict[str, Any]:
    """The same of the textured object of ``benchmarks.closerange``: places of the wide camera, depths of the shots."""
    made = plan(_of_rig(STATION, store / "rig.toml", scratch)).to_dict()
    path = made["path"]
    assert isinstance(path, dict)
    model = pycolmap.Reconstruction(store / "textured" / "out" / "sparse" / "0")
    images = sorted(model.images.values(), key=lambda i: i.name)
    truth = world.stations() @ transforms.invert(world.sensor_from_rig()[world.NAMES.index("wide")])
    there = truth[[int(Path(i.name).stem) for i in images]][:, :3, 3]
    here = np.stack([i.projection_center() for i in images])
    fit = umeyama(here, there)
    counts = json.loads((store / "textured" / "out" / "receipts" / "sparse.json").read_text())["counts"]
    sigma = fit.scale * counts["position_sigma_median"]
    error = float(np.median(np.linalg.norm(fit(here) - there, axis=1)))
    return {
        "set": name,
        "position_shape_sigma_median_m": _beside(path["position_shape_sigma_median_m"], sigma),
        "ties_an_image": _beside(path["ties_an_image"], sum(i.num_points3D for i in images) / len(images)),
        "error_in_shape_m": _rounded(error),
        "error / reported": round(error / sigma, 2),
        "depth of a shot": _depths(store, truth),
    }


def _depths(store: Path, truth: np.ndarray) -> dict[str, Any]:
    """Sigma of the points on the body: planned for the median depth, stated by the clouds, and their true errors."""
    off, stated, deep = [], [], []
    for file in sorted((store / "textured" / "out" / "shots").glob("*.ply")):
        cloud = read_cloud(file)
        points = transforms.apply(truth[int(file.stem.split("_")[-1])], cloud.xyz_m)
        error = world.distance_m(points)
        kept = world.on_body(points) & (np.abs(error) < _BLUNDER_M)
        off.append(error[kept])
        stated.append(np.asarray(cloud.sigma_m)[kept])
        deep.append(cloud.xyz_m[kept, 2])
    error, depth = np.concatenate(off), float(np.median(np.concatenate(deep)))
    camera = world.cameras()[0]
    base = float(np.linalg.norm(transforms.centre(world.sensor_from_rig()[1])))
    lens = CameraRequest(focal_px=camera.mean_focal_length(), size=f"{camera.width}x{camera.height}")
    rows = plan(PlanRequest(lens, ImageRequest(distance=f"{depth:.4f}", base=f"{base:.4f}"))).to_dict()["stations"]
    assert isinstance(rows, list)
    planned = _SQUARE_GAIN * rows[0]["depth_sigma_2_rays_m"]
    return {
        "median_depth_m": _rounded(depth), **_beside(planned, float(np.median(np.concatenate(stated)))),
        "error_m": _rounded(1.4826 * float(np.median(np.abs(error)))), "error_rms_m": _rounded(_rms(error)),
    }  # fmt: skip


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


def _beside(planned: float | None, reported: float | None) -> dict[str, float | None]:
    return {
        "planned": _rounded(planned), "reported": _rounded(reported),
        "reported / planned": round(reported / planned, 2) if planned and reported else None,
    }  # fmt: skip


def errors_m(dataset: datasets.Dataset, folder: Path) -> np.ndarray:
    """(F, 3) errors of the places of the reference cameras after the best similarity."""
    model = pycolmap.Reconstruction(folder / "sparse" / "0")
    truth = reference_poses(model, dataset)
    poses = [model.frame(f).rig_from_world for f in truth]
    here = np.stack([p.tgt_origin_in_src() for p in poses if p is not None])
    there = np.stack([transforms.centre(p) for p in truth.values()])
    return umeyama(here, there)(here) - there


def _with_files(request: PlanRequest, dataset: datasets.Dataset, scratch: Path) -> PlanRequest:
    """The request with the set's own rig file, or one camera of it."""
    return request if dataset.rig is None else _of_rig(request, Path(str(dataset.rig)), scratch)


def _of_rig(request: PlanRequest, file: Path, scratch: Path) -> PlanRequest:
    found = re.fullmatch(r"\{rig(?::(\w+))?\}", request.camera.rig or "")
    if found is None:
        return request
    if found[1]:
        head, *sensors = file.read_text().split("[[sensors]]")
        own = next(s for s in sensors if f'name = "{found[1]}"' in s)
        file = scratch / f"{found[1]}.toml"
        file.write_text(head + "[[sensors]]" + own)
    return replace(request, camera=request.camera.model_copy(update={"rig": str(file)}))


def _rounded(value: float | None) -> float | None:
    return None if value is None else float(f"{value:.4g}")


if __name__ == "__main__":
    each_run(arguments(__doc__).parse_args(), measure)
