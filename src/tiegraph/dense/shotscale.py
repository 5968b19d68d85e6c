"""The unit of a model by the depth maps of shots (paper 004, section 4): a calibrated rig gives a scaled cloud of each
station, so that one camera will do for the poses; its model has no scale, but its points lie on the surface of the
clouds."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tiegraph.geometry import transforms
from tiegraph.geometry.align import robust_sigma
from tiegraph.scene.results import DepthMap

_LEAST_POINTS = 10  # that must fall onto the depth maps of a shot: its median is better than a point by three
_GRID = 0.04  # relative step of the units tried first; half of it is how well a depth must agree there


@dataclass(frozen=True)
class ShotScale:
    """Metres in a unit of the model; its relative sigma by how the shots scatter; points and shots that tell."""

    metres_per_unit: float
    sigma: float
    points: int
    shots: int


@dataclass(frozen=True, eq=False)
class Seen:
    """Points of the model (P, 3) in the frame of a camera that sees them, model units; where that camera is in the rig,
    metres; and a depth map of another camera of the same shot, whose ``cam_from_world`` is from the rig's frame."""

    shot: int
    points: np.ndarray
    rig_from_camera: np.ndarray
    depth: DepthMap

    def read(self, scale: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Depths of the points at scales (..., 1) or (..., P), and those that the map has where they fall, NaN = none;
        both (..., P)."""
        camera = self.depth.cam_from_world @ self.rig_from_camera
        at = scale[..., None] * (self.points @ camera[:3, :3].T) + camera[:3, 3]
        height, width = self.depth.depth_m.shape
        with np.errstate(divide="ignore", invalid="ignore"):
            place = at[..., :2] / at[..., 2:] * self.depth.K[[0, 1], [0, 1]] + self.depth.K[:2, 2]
            inside = (at[..., 2] > 0) & (place >= 0).all(axis=-1) & (place < (width, height)).all(axis=-1)
        column, row = np.moveaxis(np.where(inside[..., None], place, 0).astype(int), -1, 0)
        return at[..., 2], np.where(inside, self.depth.depth_m[row, column], np.nan)

    def scales(self, start: float) -> np.ndarray:
        """Metres per unit (P,) by which each point falls onto the map, sought from ``start``; NaN = none.

        A point runs along its ray with the scale: in steps, its scale is the one that gives it the depth read where it
        falls. On a surface without jumps each step shrinks the error by the parallax times the slope.
        """
        camera = self.depth.cam_from_world @ self.rig_from_camera
        along = self.points @ camera[2, :3]
        scale, step = np.full(len(self.points), start), np.full(len(self.points), np.inf)
        for _ in range(8):  # at a parallax of 6 degrees each shrinks the error ten times on slopes of 45
            with np.errstate(divide="ignore", invalid="ignore"):
                found = (self.read(scale)[1] - camera[2, 3]) / along
                step = np.abs(found / scale - 1)
            scale = np.where(found > 0, found, np.nan)
        near = np.abs(scale / start - 1) < _GRID
        return np.where((step < 1e-3) & near, scale, np.nan)


def shot_scale(seen: Sequence[Seen]) -> ShotScale | None:
    """The unit at which most points lie on the depth maps, then the median over shots of the median of their points;
    None where too few tell."""
    start = _most_agree([s for s in seen if len(s.points)])
    if start is None:
        return None
    by_shot: dict[int, list[np.ndarray]] = {}
    for one in seen:
        by_shot.setdefault(one.shot, []).append(one.scales(start))
    every = [np.concatenate(parts) for parts in by_shot.values()]
    good = [s for scales in every if len(s := scales[np.isfinite(scales)]) >= _LEAST_POINTS]
    if not good:
        return None
    medians = np.array([np.median(s) for s in good])
    scale = float(np.median(medians))
    scatter = robust_sigma(medians / scale - 1)
    sigma = scatter / float(np.sqrt(len(medians)))
    return ShotScale(metres_per_unit=scale, sigma=sigma, points=sum(map(len, good)), shots=len(medians))


def _most_agree(seen: Sequence[Seen]) -> float | None:
    """Of units over a wide range the one at which most points have the depth of the maps where they fall.

    Depths alone do not tell: a wide camera sees much that the maps do not reach.
    """
    mapped = [s for s in seen if np.isfinite(s.depth.depth_m).any()]
    ratios = [np.nanmedian(s.depth.depth_m) / np.median(s.points[:, 2]) for s in mapped]
    if not ratios:
        return None
    count = int(np.ceil(np.log(16) / np.log1p(_GRID)))
    tried = float(np.median(ratios)) * (1 + _GRID) ** np.arange(-count, count + 1)
    agree = np.zeros(len(tried), int)
    for one in seen:
        depth, read = one.read(tried[:, None])
        with np.errstate(invalid="ignore"):
            agree += (np.abs(read / depth - 1) < _GRID / 2).sum(axis=1)
    best = int(agree.argmax())
    rival = max(agree[: max(0, best - 2)].max(initial=0), agree[best + 3 :].max(initial=0))
    return float(tried[best]) if agree[best] > max(_LEAST_POINTS, 1.5 * rival) else None


def in_camera(cam_from_world: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (P, 3) of the model in the frame of a camera, those before it."""
    local = transforms.apply(cam_from_world, points)
    return local[local[:, 2] > 0]
