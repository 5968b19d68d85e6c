"""The rig in finished runs against the truth: rotation between its cameras, metric scale, time offsets, placement.

Reads run folders (what ``benchmarks/run.py --keep`` leaves), takes their first model and does again what comes after
the mapper: place of every frame, final adjustment, rig diagnostics, relaxing. Nothing in the run folders is changed.
"""

from __future__ import annotations

import json
import time
from pathlib import Path
from typing import Any

import numpy as np

import tiegraph  # noqa: F401  (zlib before pycolmap)

import pycolmap  # isort: skip

from benchmarks import datasets
from benchmarks.accuracy import evaluate
from benchmarks.sfm.finished import arguments, each_run
from tiegraph.geometry import transforms
from tiegraph.scene.colmapmodel import image_poses
from tiegraph.scene.scene import Scene
from tiegraph.sfm.finish import finish_model
from tiegraph.sfm.mapping import believed_cameras
from tiegraph.sfm.rig.rig import rig_modes, ties_of, unsupported_sensors
from tiegraph.sfm.rigcheck import FinishRequest, Held
from tiegraph.sfm.settings import SparseSettings
from tiegraph.sfm.tuning import Tuning
from tiegraph.sfm.verified import MatchSource, ViewGraph


def measure(name: str, folder: Path, scratch: Path) -> dict[str, Any]:
    """Figures of one run: as the mapper left it, and finished anew."""
    dataset = datasets.load(name, scratch)
    scene = Scene.from_json((folder / "network" / "scene.json").read_text()).measured()
    request = _request(folder, scene, scratch)
    start = time.process_time()
    done = finish_model(request, lambda message: None)
    cpu = time.process_time() - start
    out: dict[str, Any] = {"set": name, "cpu_s": round(cpu, 1), "notes": done.notes, "tables": done.tables}
    for label, path in (("run", request.folder), ("finished", request.target)):
        model = pycolmap.Reconstruction(path)
        found = evaluate([path], dataset)
        figures = {k: found[k] for k in ("registered", "ate_m", "ate_rigid_m", "scale", "reprojection_px")}
        out[label] = {**figures, **rotations(model, scene, dataset)}
    if name == "pandaset":
        out["true_offsets_ms"] = true_offsets_ms(scene)
    return out


def _request(folder: Path, scene: Scene, scratch: Path) -> FinishRequest:
    modes = rig_modes(scene, "auto")
    constant = believed_cameras(scene, SparseSettings())
    graph = ViewGraph(folder / "database.db", scene, SparseSettings().min_matches)
    alone = unsupported_sensors(scene, graph, modes, Tuning().rig.support)
    return FinishRequest(
        folder=folder / "sparse" / "0",
        target=scratch / "finished",
        images=folder / "images",
        scene=scene,
        tuning=Tuning(),
        held=Held(modes=modes, unsupported=alone, cameras=constant),
        matched=MatchSource(folder / "database.db", ties_of(scene, graph, alone)),
    )


def rotations(model: pycolmap.Reconstruction, scene: Scene, dataset: datasets.Dataset) -> dict[str, Any]:
    """Median over the frames of the angle between found and true rotation of each camera against the reference, deg."""
    poses = image_poses(model, scene)
    errors: dict[str, list[float]] = {}
    for frame in range(scene.frames):
        images = np.flatnonzero(scene.frame == frame)
        first = [k for k in images if scene.sensor[k] == 0]
        if not first or not np.isfinite(poses[first[0]]).all() or scene.names[first[0]] not in dataset.cam_from_world:
            continue
        for k in images:
            known = dataset.cam_from_world.get(scene.names[k])
            if scene.sensor[k] == 0 or known is None or not np.isfinite(poses[k]).all():
                continue
            found = poses[k][:3, :3] @ poses[first[0]][:3, :3].T
            true = known[:3, :3] @ dataset.cam_from_world[scene.names[first[0]]][:3, :3].T
            errors.setdefault(scene.sensor_of(int(k)).name, []).append(float(transforms.angle_deg(found, true)))
    return {"rotation_deg": {camera: round(float(np.median(e)), 4) for camera, e in sorted(errors.items())}}


def true_offsets_ms(scene: Scene) -> dict[str, float]:
    """Mean of PandaSet's camera stamps against the front camera's, milliseconds."""
    folder = datasets.data_root() / "pandaset" / "camera"
    stamps = {
        s.name: np.array(json.loads((folder / s.name / "timestamps.json").read_text())) for s in scene.all_sensors
    }
    front = stamps[scene.all_sensors[0].name]
    return {camera: round(1000 * float(np.mean(t - front)), 1) for camera, t in stamps.items()}


if __name__ == "__main__":
    each_run(arguments(__doc__).parse_args(), measure)
