"""Trajectories of visual odometry, SLAM or an INS: TUM files (with times) and KITTI files (a pose a frame)."""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from tiegraph.errors import InputError
from tiegraph.geometry.transforms import angle_deg, quaternion_xyzw, rigid
from tiegraph.scan.folders import words
from tiegraph.scene.regular import regular
from tiegraph.scene.results import Trajectory

_TUM, _KITTI = 8, 12
_SUFFIXES = (".tum", ".txt", ".kitti")
_SAME_START_M, _SAME_START_DEG = 1e-3, 0.1


def read_trajectory(path: Path) -> Trajectory:
    """Poses of a file: TUM (``t x y z qx qy qz qw``) or KITTI (12 numbers, 3x4 row by row; its times are NaN).

    Sorted by time; rows with the time of another row are left out. Raises InputError with the line number for a wrong
    number of columns, text, or a quaternion or rotation that is none.
    """
    try:
        lines = regular(path).read_text(encoding="utf-8-sig", errors="replace").splitlines()
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give a TUM file: t x y z qx qy qz qw") from None
    rows = [(k + 1, line.replace(",", " ").split()) for k, line in enumerate(lines) if line.strip()]
    rows = [(n, cells) for n, cells in rows if not cells[0].startswith(("#", "%"))]
    if not rows:
        raise InputError(f"{path}: no poses; give a TUM file: t x y z qx qy qz qw")
    width = len(rows[0][1])
    if width not in (_TUM, _KITTI):
        raise InputError(
            f"{path}, line {rows[0][0]}: {width} columns; expected 8 (TUM: t x y z qx qy qz qw) or 12 (KITTI)"
        )
    numbers = np.array([_row(path, n, cells, width) for n, cells in rows])
    lines_at = [n for n, _ in rows]
    return _tum(path, numbers, lines_at) if width == _TUM else _kitti(path, numbers, lines_at)


def _row(path: Path, line: int, cells: list[str], width: int) -> list[float]:
    if len(cells) != width:
        raise InputError(f"{path}, line {line}: {len(cells)} columns, but the lines above have {width}")
    try:
        values = [float(c) for c in cells]
    except ValueError:
        raise InputError(f"{path}, line {line}: not all cells are numbers: {' '.join(cells)}") from None
    if not np.isfinite(values).all():
        raise InputError(f"{path}, line {line}: not a finite number; leave lost poses out of the file")
    return values


def _tum(path: Path, numbers: np.ndarray, lines: list[int]) -> Trajectory:
    length = np.linalg.norm(numbers[:, 4:], axis=1)
    bad = np.flatnonzero(np.abs(length - 1) > 1e-2)
    if len(bad):
        raise InputError(
            f"{path}, line {lines[bad[0]]}: the quaternion qx qy qz qw has length {length[bad[0]]:.3g}, not 1"
        )
    order = np.argsort(numbers[:, 0], kind="stable")
    numbers = numbers[order[np.concatenate([[True], np.diff(numbers[order, 0]) > 1e-9])]]
    poses = rigid(Rotation.from_quat(numbers[:, 4:]).as_matrix(), numbers[:, 1:4])
    return Trajectory(numbers[:, 0], poses, np.full(len(numbers), np.nan))


def _kitti(path: Path, numbers: np.ndarray, lines: list[int]) -> Trajectory:
    matrices = numbers.reshape(-1, 3, 4)
    off = np.abs(matrices[:, :, :3] @ np.swapaxes(matrices[:, :, :3], 1, 2) - np.eye(3)).max(axis=(1, 2))
    bad = np.flatnonzero(off > 1e-2)
    if len(bad):
        raise InputError(f"{path}, line {lines[bad[0]]}: columns 1-3, 5-7, 9-11 are not a rotation")
    rotation = Rotation.from_matrix(matrices[:, :, :3]).as_matrix()
    poses = rigid(rotation, matrices[:, :, 3])
    return Trajectory(np.full(len(poses), np.nan), poses, np.full(len(poses), np.nan))


def write_tum(path: Path, time_s: np.ndarray, world_from_rig: np.ndarray) -> None:
    """Write poses (T, 4, 4) as TUM; unknown poses are left out, unknown times become the row's number."""
    lines = ["# time_s x y z qx qy qz qw"]
    for k, (t, pose) in enumerate(zip(time_s, world_from_rig)):
        if np.isfinite(pose[:3]).all():
            values = [*pose[:3, 3], *quaternion_xyzw(pose[:3, :3])]
            lines.append(f"{t if np.isfinite(t) else k:.6f} " + " ".join(f"{v:.9f}" for v in values))
    Path(path).write_text("\n".join(lines) + "\n")


def trajectory_files(path: Path, tracks: Sequence[str]) -> dict[int, Path]:
    """Trajectory file of each pass: ``path`` is one file for all (key -1), or a folder with one a pass.

    In a folder the file's name contains the name of the pass: vo_up.tum, vo_down.tum. Raises InputError if the path is
    not there, or if no file of the folder fits a pass.
    """
    path = Path(path)
    if path.exists() and not path.is_dir():
        return {-1: path}
    if not path.exists():
        raise InputError(f"--trajectory {path}: no such file or folder")
    files = sorted(f for f in path.iterdir() if f.suffix.lower() in _SUFFIXES and not f.name.startswith("."))
    tum = [f for f in files if f.suffix.lower() == ".tum"]
    files = tum or files
    if len(files) == 1:
        return {-1: files[0]}
    found = {k: f for k, name in enumerate(tracks) if (f := _for_pass(name, files)) is not None}
    if not found:
        raise InputError(
            f"--trajectory {path}: none of its files ({', '.join(f.name for f in files) or 'none ends in .tum, .txt'}) "
            f"has the name of a pass in its own ({', '.join(tracks) or 'there is no pass'}), as in vo_up.tum"
        )
    return found


def _for_pass(name: str, files: Sequence[Path]) -> Path | None:
    slug = name.lower().replace("/", "_").replace(" ", "_")
    if slug.isalpha():
        exact = [f for f in files if slug in words(f.stem)]
    else:
        exact = [f for f in files if f.stem.lower() == slug or f.stem.lower().endswith("_" + slug)]
    exact = exact or [f for f in files if slug in f.stem.lower().replace(" ", "_")]
    return exact[0] if len(exact) == 1 else None


def same_start(trajectories: Sequence[Trajectory]) -> bool:
    """Whether trajectories all begin at the same pose: each then has a world of its own, as odometry starts at zero."""
    first = [t.world_from_rig[0] for t in trajectories]
    return all(
        np.linalg.norm(p[:3, 3] - first[0][:3, 3]) < _SAME_START_M
        and angle_deg(p[:3, :3], first[0][:3, :3]) < _SAME_START_DEG
        for p in first[1:]
    )
