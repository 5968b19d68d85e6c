"""A cloud of a shot made ready: thinned to several voxels, with normals, descriptors and what small_gicp needs.

How far the points of a shot stand apart: by their distance from what took them, because that is what decides it.
"""

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from scipy.spatial import cKDTree

from tiegraph.errors import EngineMissing
from tiegraph.geometry import transforms
from tiegraph.geometry.align import robust_sigma
from tiegraph.geometry.coarse import Shape, normals, shape_of, side_for, thinned
from tiegraph.stations.tuning import Tuning

_UPWARDS = np.array([0.36, 0.48, 0.8])  # walls have a side too


@dataclass(frozen=True)
class Shot:
    """Points (N, 3) of a shot; normals (N, 3) of its file, None = it has none; the sigma (N,) that it states, NaN =
    none. ``known``: its pose (4, 4) in the world, None = unknown. ``own_frame``: its points are in the frame of what
    took it, so that their distance from there is known."""

    name: str
    xyz: np.ndarray
    normal: np.ndarray | None = None
    sigma_m: np.ndarray | None = None
    known: np.ndarray | None = None
    own_frame: bool = True

    def seen_from(self) -> tuple[np.ndarray, bool]:
        """(N, 3) directions in which the surface was seen from, and whether that is sure: else towards the origin of
        the shot's own frame, or in a world upwards."""
        if self.normal is not None:
            return self.normal, True
        return -self.xyz if self.own_frame else np.broadcast_to(_UPWARDS, self.xyz.shape), False


@dataclass(frozen=True)
class Sample:
    """Some points as measured (M, 3), about the middle of the cloud; their lines of sight (M, 3), distance from what
    took them and the sigma they state (M,), metres; NaN = unknown."""

    xyz: np.ndarray
    ray: np.ndarray
    distance_m: np.ndarray
    sigma_m: np.ndarray


class Level:
    """A thinned cloud (N, 3) about its middle: normals, a tree, and its own roughness."""

    def __init__(self, xyz: np.ndarray, side: float, neighbours: int) -> None:
        self.xyz, self.side = xyz, side
        self.tree = cKDTree(xyz)
        self.normal = normals(xyz, neighbours)
        near = xyz[self.tree.query(xyz, k=min(9, len(xyz)))[1][:, 1:]] - xyz[:, None]
        off = np.einsum("nki,ni->nk", near, self.normal)
        self.rough = robust_sigma(off - off.mean(axis=1, keepdims=True))
        # In voxels, because small_gicp's covariances and limits are absolute numbers.
        gicp = engine()
        self.gicp = gicp.PointCloud(xyz / side)
        self.gicp_tree = gicp.KdTree(self.gicp)
        gicp.estimate_covariances(self.gicp, self.gicp_tree, neighbours)


@dataclass(frozen=True)
class Station:
    """A shot ready to be laid on others. Its points are about their ``middle`` (3,); ``known``: world_from_station
    (4, 4) of the points about the middle; ``eye`` (3,) from where they were seen, about the middle, None = unknown."""

    name: str
    middle: np.ndarray
    shape: Shape
    levels: list[Level]
    sample: Sample
    known: np.ndarray | None = None
    eye: np.ndarray | None = None

    @property
    def coarse(self) -> Level:
        """The thinnest level."""
        return self.levels[0]

    @property
    def shift(self) -> np.ndarray:
        """(4, 4) from the shot's own frame to that about the middle."""
        out = np.eye(4)
        out[:3, 3] = -self.middle
        return out

    @property
    def shift_back(self) -> np.ndarray:
        """(4, 4) inverse of ``shift``."""
        return transforms.invert(self.shift)


def common_side(shots: Sequence[Shot], tuning: Tuning) -> float:
    """Side of the coarse voxels: one for all, that of the median cloud."""
    return float(np.median([side_for(s.xyz, tuning.coarse.points) for s in shots]))


def station_of(shot: Shot, side: float, tuning: Tuning) -> Station:
    """Make a shot ready. Raises ValueError if too few points are left of it."""
    middle = np.median(shot.xyz, axis=0)
    xyz = shot.xyz - middle
    shape = shape_of(xyz, side, tuning.coarse, *shot.seen_from())
    if len(shape.xyz) < tuning.pair.least_points:
        raise ValueError(
            f"only {len(shape.xyz)} voxels of {side:.3g} m have points: its surface is too small beside the others'"
        )
    levels = [
        Level(thinned(xyz, side * share)[0], side * share, tuning.coarse.normal_neighbours)
        for share in tuning.pair.levels
    ]
    known = None
    if shot.known is not None:
        known = shot.known.copy()
        known[:3, 3] += shot.known[:3, :3] @ middle
    return Station(
        name=shot.name,
        middle=middle,
        shape=shape,
        levels=levels,
        sample=_sample(shot, middle),
        known=known,
        eye=-middle if shot.own_frame else None,
    )


def _sample(shot: Shot, middle: np.ndarray) -> Sample:
    some = slice(None, None, max(1, len(shot.xyz) // 20_000))
    xyz = shot.xyz[some]
    unknown = np.full(len(xyz), np.nan)
    distance = np.linalg.norm(xyz, axis=1) if shot.own_frame else unknown
    return Sample(
        xyz=xyz - middle,
        ray=xyz / np.maximum(distance, 1e-12)[:, None],
        distance_m=distance,
        sigma_m=unknown if shot.sigma_m is None else shot.sigma_m[some],
    )


def engine() -> Any:
    """The module small_gicp. Raises EngineMissing without it."""
    try:
        import small_gicp
    except ImportError:
        raise EngineMissing("clouds are laid on each other by small_gicp: pip install tiegraph[stations]") from None
    return small_gicp


# --- how far the points of a shot stand apart ------------------------------------------------------------------------


def spacing_of(xyz: np.ndarray, from_origin: bool) -> np.ndarray:
    """(N,) the usual spacing of points (N, 3) as far away as each: a stray point has that of its distance, not its own.

    ``from_origin``: the points are in the frame of what took them; else one spacing for all.
    """
    some = slice(None, None, max(1, len(xyz) // 10_000))
    third = cKDTree(xyz).query(xyz[some], k=min(4, len(xyz)))[0][:, -1]  # a disc that wide holds three others
    if not from_origin:
        return np.full(len(xyz), float(np.median(third)))
    away = np.linalg.norm(xyz, axis=1)
    order = np.argsort(away[some], kind="stable")
    parts = np.array_split(order, min(20, len(order)))
    middle = [float(np.median(away[some][p])) for p in parts]
    return np.interp(away, middle, [float(np.median(third[p])) for p in parts])
