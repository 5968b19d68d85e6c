"""Start models: what COLMAP, OpenSfM (ODM), nerfstudio and Metashape made of images, to go on from (``--start``).

What is read of each: the poses of images and their cameras, both by image name. Poses are world_from_camera with
cameras x right, y down, z forward; their world and its unit may be any. Other programs' conventions stand in
``startforeign`` and ``scene.namedposes``.
"""

from __future__ import annotations

import math
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tiegraph.errors import InputError
from tiegraph.scan.priors.startforeign import Found, metashape, opensfm_model
from tiegraph.scan.rigfiles.cameraread import FoundCamera
from tiegraph.scan.rigfiles.rigreader import is_number
from tiegraph.scene.colmapmodel import is_model, read_model
from tiegraph.scene.namedposes import check_poses, poses_of_model, poses_of_transforms, read_json
from tiegraph.scene.startplace import ACCEPTED, called, find_start


@dataclass(frozen=True)
class StartModel:
    """A model to go on from: where it was read and whose it is, poses (4, 4) and cameras by image name, the number of
    its images without a pose, and what to say of it."""

    path: Path
    program: str
    poses: dict[str, np.ndarray]
    cameras: dict[str, FoundCamera] = field(default_factory=dict)
    unposed: int = 0
    notes: tuple[str, ...] = ()

    def cameras_of(self) -> str:
        """Whose its cameras are, in words: those that a bag has come without poses."""
        return "the start model" if self.poses else self.program


def read_start(path: Path) -> StartModel:
    """The model that ``--start`` names. Raises InputError for what is none, or is damaged."""
    program, place = find_start(Path(path))
    found = _READERS[program](place)
    check_poses(found.poses, place)
    return StartModel(
        path=place,
        program=program,
        poses=found.poses,
        cameras=found.cameras,
        unposed=found.unposed,
        notes=tuple(f"{called(place)}: {note}" for note in found.notes),
    )


# --- COLMAP ---------------------------------------------------------------------------------------------------------


def _colmap(folder: Path) -> Found:
    model = read_model(folder)
    cameras = {
        key: FoundCamera(
            model=c.model.name,
            params=tuple(map(float, c.params)),
            size=(int(c.width), int(c.height)),
            where=f"{folder}, camera {key}",
            name=str(key),
        )
        for key, c in model.cameras.items()
    }
    beside = [p for p in folder.parent.iterdir() if p != folder and p.name.isdigit() and is_model(p)]
    notes = [f"the largest of {len(beside) + 1} models there"] if beside and folder.name.isdigit() else []
    poses = poses_of_model(model)
    return Found(
        poses=poses,
        cameras={i.name: cameras[i.camera_id] for i in sorted(model.images.values(), key=lambda i: i.name)},
        unposed=len(model.images) - len(poses),
        notes=notes,
    )


# --- nerfstudio -----------------------------------------------------------------------------------------------------


def _transforms(path: Path) -> Found:
    data = read_json(path, ACCEPTED)
    poses = poses_of_transforms(data, path)
    cameras: dict[str, FoundCamera] = {}
    notes: list[str] = []
    for k, frame in enumerate(data["frames"]):
        try:
            camera = _nerf_camera({**data, **frame}, f"{path}" if _LENS.isdisjoint(frame) else f"{path}, frame {k}")
        except InputError as error:
            notes.append(f"no camera is taken from it: {error}")
            cameras.clear()
            break
        if camera is not None:
            cameras[frame["file_path"]] = camera
    return Found(poses=poses, cameras=cameras, notes=notes)


_LENS = frozenset({"fl_x", "fl_y", "cx", "cy", "w", "h", "k1", "camera_angle_x"})
_PINHOLE = ("OPENCV", "PINHOLE", "SIMPLE_PINHOLE")


def _nerf_camera(row: dict[str, Any], where: str) -> FoundCamera | None:
    """The camera of one frame, as COLMAP counts pixels; None where nothing is said of it. Raises InputError."""
    wrong = next((k for k in (*_LENS, "k2", "k3", "k4", "p1", "p2") if k in row and not is_number(row[k])), None)
    if wrong is not None:
        raise InputError(f"{where}: {wrong} = {row[wrong]!r:.99}: expected a finite number")
    if not {"w", "h"} <= row.keys() or not {"fl_x", "camera_angle_x"} & row.keys():
        return None
    width, height = int(row["w"]), int(row["h"])
    fx = row["fl_x"] if "fl_x" in row else width / 2 / math.tan(row["camera_angle_x"] / 2)
    wide = (fx, row.get("fl_y", fx), row.get("cx", width / 2), row.get("cy", height / 2))
    k1, k2, k3, k4, p1, p2 = (float(row.get(n, 0.0)) for n in ("k1", "k2", "k3", "k4", "p1", "p2"))
    kind = str(row.get("camera_model", "OPENCV_FISHEYE" if row.get("is_fisheye") else "OPENCV"))
    if kind == "OPENCV_FISHEYE":
        model, rest = kind, [k1, k2, k3, k4]
    elif kind in _PINHOLE and not k4:
        model, rest = ("FULL_OPENCV", [k1, k2, p1, p2, k3, 0.0, 0.0, 0.0]) if k3 else ("OPENCV", [k1, k2, p1, p2])
    else:
        raise InputError(f"{where}: camera_model {kind} with k4 = {k4:g}; read are {', '.join(_PINHOLE)} without k4, "
                         "OPENCV_FISHEYE")  # fmt: skip
    return FoundCamera(model=model, params=tuple(map(float, (*wide, *rest))), size=(width, height), where=where)


_READERS: dict[str, Callable[[Path], Found]] = {
    "COLMAP": _colmap,
    "OpenSfM": opensfm_model,
    "nerfstudio": _transforms,
    "Metashape": metashape,
}


def must_be_whole(start: StartModel, whole: bool) -> None:
    """Raises InputError where views of the images are mapped: a model knows whole ones by their names."""
    if not whole:
        raise InputError(
            f"--start {start.path}: a model of whole images, of which views are mapped here (panoramas, fisheye "
            "lenses): leave it out, or take fisheye images as they are by --scan.fisheye whole"
        )
