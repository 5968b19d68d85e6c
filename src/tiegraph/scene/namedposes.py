"""Models of other programs: place and program of a start model, and poses by image name.

The kind of a path is recognised by the contents of the folder or file; the user states none.

COLMAP's cameras are ours: x right, y down, z forward; its quaternions have w first, which pycolmap reads. The cameras
of transforms.json are OpenGL's: x right, y up, z backward (docs.nerf.studio, data conventions). The worlds of both, and
their scales, are of any kind.
"""

import json
import re
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tiegraph.errors import InputError
from tiegraph.geometry import transforms
from tiegraph.scene.atomic import regular
from tiegraph.scene.colmapmodel import is_model, matrix, read_model
from tiegraph.text import composed

ACCEPTED = (
    "a COLMAP model (the folder of images.bin or images.txt, or of sparse/0), OpenSfM's or ODM's reconstruction.json, "
    "nerfstudio's transforms.json, or the cameras that Metashape exports as XML"
)
_HEAD = 1 << 16  # letters of an XML file that contain its root


def find_start(path: Path) -> tuple[str, Path]:
    """The program (COLMAP, OpenSfM, nerfstudio, Metashape) and the file or folder of the model of ``--start``.

    Raises InputError if there is none.
    """
    if not path.exists():
        raise InputError(f"--start {path}: no such file or folder; give {ACCEPTED}")
    for program, find in _FORMATS.items():
        place = find(path)
        if place is not None:
            return program, place
    raise InputError(f"--start {path}: no model of a known kind; give {ACCEPTED}")


def called(place: Path) -> str:
    """Name of a model's file or folder in messages: "sparse/0" is clearer than "0"."""
    return f"{place.parent.name}/{place.name}" if place.name.isdigit() else place.name


def _find_colmap(path: Path) -> Path | None:
    """The model folder; of several beside each other (0, 1, ...) the one with the largest file of images."""
    if path.is_file():
        return path.parent if path.name in ("images.bin", "images.txt") else None
    if is_model(path):
        return path
    for folder in (path, path / "sparse"):
        if folder.is_dir():
            numbered = [p for p in folder.iterdir() if p.name.isdigit() and is_model(p)]
            if numbered:
                files = {p: [f for f in (p / "images.bin", p / "images.txt") if f.exists()] for p in numbered}
                return max(numbered, key=lambda p: (max(f.stat().st_size for f in files[p]), -int(p.name)))
    return None


def _find_json(path: Path, key: str, places: tuple[str, ...]) -> Path | None:
    """A JSON file with a key, or one of some places in a folder."""
    if path.is_file():
        return path if path.suffix.lower() == ".json" and f'"{key}"' in _content(path) else None
    return next((path / p for p in places if (path / p).is_file()), None)


def _content(path: Path) -> str:
    try:
        return regular(path).read_bytes().decode("utf-8", "replace")
    except OSError as error:
        raise InputError(f"--start {path}: cannot be read ({error.strerror}); give {ACCEPTED}") from None


def _find_metashape(path: Path) -> Path | None:
    if path.is_file():
        return path if path.suffix.lower() == ".xml" and _is_metashape(path) else None
    found = [p for p in sorted(path.glob("*.xml")) if p.is_file() and _is_metashape(p)]
    if len(found) > 1:
        names = ", ".join(p.name for p in found[:4])
        raise InputError(f"--start {path}: {len(found)} files of cameras in it ({names}): give the right one")
    return found[0] if found else None


def _is_metashape(path: Path) -> bool:
    return bool(re.search(r"<document\b.*?<chunk\b", _content(path)[:_HEAD], re.DOTALL))


_FORMATS = {
    "COLMAP": _find_colmap,
    "OpenSfM": partial(_find_json, key="shots", places=("reconstruction.json", "opensfm/reconstruction.json")),
    "nerfstudio": partial(_find_json, key="frames", places=("transforms.json",)),
    "Metashape": _find_metashape,
}

TRANSFORMS = "transforms.json"


def has_named_poses(path: Path) -> bool:
    """Whether a path is a COLMAP model, a transforms.json, or a folder with one."""
    return is_model(path) or (path / TRANSFORMS).is_file() or (path.suffix.lower() == ".json" and path.is_file())


def read_named_poses(path: Path) -> dict[str, np.ndarray]:
    """world_from_camera (4, 4) by image name, cameras x right, y down, z forward.

    Raises InputError, naming the damaged part, and for files without poses or with the same pose for all images.
    """
    path = Path(path)
    if path.is_dir() and not is_model(path):
        path = path / TRANSFORMS
    found = poses_of_model(read_model(path)) if path.is_dir() else poses_of_transforms(read_json(path), path)
    check_poses(found, path)
    return {composed(name): pose for name, pose in found.items()}


def check_poses(found: dict[str, np.ndarray], path: Path) -> None:
    """Raise InputError for no poses, and for several that are all the same."""
    if not found:
        raise InputError(f"{path}: no image has a pose in it; give a finished model, or omit it")
    poses = np.array(list(found.values()))
    if len(poses) > 1 and np.ptp(poses, axis=0).max() < 1e-9:
        raise InputError(f"{path}: all {len(poses)} poses are the same: a trajectory without information; omit it")


def poses_of_model(model: Any) -> dict[str, np.ndarray]:
    """world_from_camera (4, 4) by image name of a ``pycolmap.Reconstruction``."""
    posed = sorted((i for i in model.images.values() if i.has_pose), key=lambda i: i.name)
    return {i.name: transforms.invert(matrix(i.cam_from_world())) for i in posed}


def poses_of_transforms(data: Any, path: Path) -> dict[str, np.ndarray]:
    """The same from a transforms.json. Raises InputError, naming the frame."""
    frames = data.get("frames") if isinstance(data, dict) else None
    if not isinstance(frames, list):
        raise InputError(f"{path}: no list 'frames'; give a transforms.json of nerfstudio or instant-ngp")
    out: dict[str, np.ndarray] = {}
    for k, frame in enumerate(frames):
        where = f"{path}, frame {k}"
        name = frame.get("file_path") if isinstance(frame, dict) else None
        if not isinstance(name, str) or not name:
            raise InputError(f"{where}: no file_path: write the image that each pose is of")
        given = transforms.finite_array(frame.get("transform_matrix"), (4, 4), (3, 4))
        if given is None:
            raise InputError(f"{where} ({name:.80}): transform_matrix is no 4 x 4 matrix of numbers: remove that frame")
        pose = checked_pose(given, f"{where} ({name:.80}): transform_matrix")
        pose[:3, 1:3] *= -1  # from OpenGL's camera
        if name in out and not np.allclose(out[name], pose, rtol=0, atol=1e-9):
            raise InputError(f"{where}: {name:.80} has another pose above: keep the right one")
        out[name] = pose
    return out


def read_json(path: Path, what: str = "a transforms.json of nerfstudio or instant-ngp") -> Any:
    """The contents of a JSON file. Raises InputError, with the line, for an invalid one; ``what`` to give instead."""
    try:
        return json.loads(regular(path).read_text(encoding="utf-8-sig"))
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give {what}") from None
    except json.JSONDecodeError as error:
        raise InputError(f"{path}, line {error.lineno}: no JSON ({error.msg}): is the file cut off?") from None
    except (UnicodeDecodeError, RecursionError):
        raise InputError(f"{path}: no JSON text; give {what}") from None


def checked_pose(pose: np.ndarray, what: str) -> np.ndarray:
    """(4, 4) of a camera-to-world matrix (3 or 4, 4). Raises InputError, naming ``what``, if it has no rotation."""
    if not transforms.are_rotations(pose[:3, :3], 1e-2):  # tolerance of R R^T = 1
        raise InputError(
            f"{what} has no rotation in its first three columns (scaled, or mirrored): write "
            "camera-to-world matrices with a rotation and a translation"
        )
    return transforms.rigid(pose[:3, :3], pose[:3, 3])
