"""What an odometry's path is worth: its errors over its own sigmas where there is truth, and how it agrees with itself
where there is none.

Sigmas are of a pose relative to the first, so the odometry is begun at several frames, forwards and backwards: every
frame of every such path is a relative pose with its sigma, as a user gets it. **1 means as said**: an error is
divided by the median length of errors drawn from the covariance that is stated. A single camera has no scale: truth is
brought to the length of the chord from the first frame, and what stands across it is compared.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

import tiegraph  # noqa: F401  before pycolmap
from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import umeyama
from tiegraph.odometry.cameras import cameras_of
from tiegraph.odometry.odometry import Odometry, OdometryPath, path_of
from tiegraph.odometry.tuning import Tuning
from tiegraph.scene.colmapmodel import matrix
from tiegraph.scene.decoding import read_pixels
from tiegraph.scene.rig import Rig

_STARTS = (0.0, 0.2, 0.4, 0.6)  # of the sequence, from either end
_SHORTEST = 5  # frames of a path
_DRAWS, _SEED = 1000, 0
_PARTS = 3  # by length, as many relative poses in each


def follow(files: Sequence[Sequence[Path]], rig: Rig, frames: Sequence[int]) -> OdometryPath:
    """The path over some frames of a sequence, in the order given."""

    def read(place: int, camera: int) -> np.ndarray | None:
        return read_pixels(files[frames[place]][camera])

    tuning = Tuning()
    engine = Odometry(cameras_of((rig,)), read, tuning)
    for place in range(len(frames)):
        seen = {c: read(place, c) for c in range(len(rig.sensors))}
        engine.add(place, {c: image for c, image in seen.items() if image is not None})
    engine.finish()
    return path_of(engine, range(len(frames)), tuning.map)


def sigma_check(files: Sequence[Sequence[Path]], rig: Rig, truth: np.ndarray, first: int = 0) -> list[dict]:
    """Errors over sigmas of positions and turns by length, of frames from ``first`` on, which truth (F, 4, 4) knows."""
    rows = []
    own = np.arange(first, len(files))
    for start in _STARTS:
        left = own[round(start * len(own)) :]
        for frames in (left, (own[0] + own[-1]) - left):
            if len(frames) >= _SHORTEST:
                path = follow(files, rig, frames.tolist())
                rows += errors_over_sigmas(path, truth[frames])
    return by_length(np.array(rows))


def errors_over_sigmas(path: OdometryPath, truth: np.ndarray) -> list[tuple[float, float, float]]:
    """(length of the way, error over sigma of the position, of the turn) of each frame of the first segment."""
    way = np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(truth[:, :3, 3], axis=0), axis=1))])
    at = np.flatnonzero((path.segment == 0) & np.isfinite(path.covariance).all(axis=(1, 2)))
    rng, out = np.random.default_rng(_SEED), []
    for k in at[1:]:
        found = transforms.invert(path.world_from_rig[at[0]]) @ path.world_from_rig[k]
        true = transforms.invert(truth[at[0]]) @ truth[k]
        covariance, across = path.covariance[k], np.eye(3)
        if not path.metric:
            length = float(np.linalg.norm(found[:3, 3]))
            true[:3, 3] *= length / np.linalg.norm(true[:3, 3])
            across = np.eye(3) - np.outer(found[:3, 3], found[:3, 3]) / length**2
        turn = Rotation.from_matrix(found[:3, :3] @ true[:3, :3].T).as_rotvec()
        place = across @ (found - true)[:3, 3]
        stated = across @ covariance[:3, :3] @ across
        out.append((float(way[k] - way[at[0]]), _over(place, stated, rng), _over(turn, covariance[3:, 3:], rng)))
    return out


def _over(error: np.ndarray, covariance: np.ndarray, rng: np.random.Generator) -> float:
    """Length of an error over the median length of errors of this covariance (3, 3)."""
    drawn = rng.multivariate_normal(np.zeros(3), covariance, _DRAWS, method="eigh")
    return float(np.linalg.norm(error) / np.median(np.linalg.norm(drawn, axis=1)))


def by_length(rows: np.ndarray) -> list[dict]:
    """Medians of rows (N, 3) of ``errors_over_sigmas``, in parts of equal number by length."""
    rows = rows[np.argsort(rows[:, 0], kind="stable")]
    return [
        {
            "to_m": round(float(part[-1, 0]), 1), "poses": len(part),
            "position": round(float(np.median(part[:, 1])), 2), "turn": round(float(np.median(part[:, 2])), 2),
        }
        for part in np.array_split(rows, _PARTS)
    ]  # fmt: skip


def agreement(path: OdometryPath, other: np.ndarray, frames: np.ndarray) -> dict:
    """How other poses (K, 4, 4), NaN = none, of some frames (K,) of a path stand off it: after the best similarity, in
    % of the way, with its scale; the turns in degrees."""
    way = path.world_from_rig[path.segment == path.main(), :3, 3]
    both = (path.segment[frames] == path.main()) & np.isfinite(other).all(axis=(1, 2))
    a, b = path.world_from_rig[frames[both]], other[both]
    fit = umeyama(b[:, :3, 3], a[:, :3, 3])
    off = np.linalg.norm(fit(b[:, :3, 3]) - a[:, :3, 3], axis=1)
    length = float(np.linalg.norm(np.diff(way, axis=0), axis=1).sum())
    turned = transforms.angle_deg(fit.rotation @ b[:, :3, :3], a[:, :3, :3])
    return {
        "frames": int(both.sum()), "scale": round(float(fit.scale), 4),
        "rms_percent_of_way": round(100 * float(np.sqrt(np.mean(off**2))) / length, 3),
        "turn_median_deg": round(float(np.median(turned)), 3),
    }  # fmt: skip


def with_itself(files: Sequence[Sequence[Path]], rig: Rig, reference: Path | None) -> dict[str, dict]:
    """The path against the one run backwards, those of every second frame, and the model of a run whose images are
    named by the numbers of the frames."""
    frames = np.arange(len(files))
    path = follow(files, rig, frames.tolist())
    others = {"backwards": frames[::-1], "even frames": frames[::2], "odd frames": frames[1::2]}
    out = {}
    for name, own in others.items():
        other = follow(files, rig, own.tolist())
        poses = np.where((other.segment == other.main())[:, None, None], other.world_from_rig, np.nan)
        out[name] = agreement(path, poses, own)
    if reference is not None:
        out["tiegraph run"] = agreement(path, _of_run(reference, rig.sensors[0].folder, len(files)), frames)
    return out


def _of_run(folder: Path, camera: str, count: int) -> np.ndarray:
    """(count, 4, 4) poses of the first camera of a run, NaN = none."""
    out = np.full((count, 4, 4), np.nan)
    for image in pycolmap.Reconstruction(folder / "sparse" / "0").images.values():
        name = Path(image.name)
        if camera in name.parts and image.has_pose:
            out[int(name.stem)] = transforms.invert(matrix(image.cam_from_world()))
    return out
