"""A model placed by its points alone: they must lie on the surfaces that the others saw, and in one place only.

The last that is asked, of models that neither matches nor positions place. Both are levelled by their cameras. The
occupied cells of one are correlated with those of the other for turns about the vertical, and for scales where nothing
tells them; from the best of these places ICP goes on with a similarity (small_gicp knows rigid motions only, and is no
more accurate on sparse points). Every second point is held back. Walls slide along walls, and two banks look alike: a
place is believed only if most of the points held back lie on the others' and clearly fewer do in any other place.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np
import pycolmap
import scipy
from scipy.ndimage import binary_dilation
from scipy.spatial import cKDTree
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms
from tiegraph.geometry.align import Similarity, umeyama
from tiegraph.geometry.gravity import up_vector
from tiegraph.scene.colmapmodel import image_poses, tracks
from tiegraph.scene.scene import Scene
from tiegraph.sfm.tuning.world import CloudTuning, WorldTuning

_MOST_CELLS = 3e7  # of the grid that is correlated: 0.5 GB


@dataclass(frozen=True)
class Surface:
    """What models in one frame saw near their cameras: ``xyz`` (N, 3) with z up, the ``level`` (3, 3) that turned them
    so, and the usual distance ``range_`` from a camera to its points."""

    xyz: np.ndarray
    level: np.ndarray
    range_: float


@dataclass(frozen=True)
class CloudFit:
    """Where the points of a model fit best: ``world_from_model``, the share of the points held back that lie on the
    others' (``explained``), the same in the next best place (``rival``), what the cameras call up and the fit turns
    (``lean_deg``), and how far the fits to either half put the model's middle apart (``jump``, ``turn_deg``)."""

    world_from_model: Similarity
    explained: float
    rival: float
    lean_deg: float
    jump: float
    turn_deg: float

    def why_not(self, tuning: CloudTuning) -> str:
        """Why it is not believed; "" if it is."""
        shares = f"{self.explained:.0%} of its points lie on the others'"
        if self.explained < tuning.explained:
            return f"{shares} at best: they hardly overlap"
        if self.rival > tuning.rival * self.explained:
            return f"{shares} in one place and {self.rival:.0%} in another, about equally many"
        if self.lean_deg > tuning.lean_deg:
            return f"{shares} where its cameras would lean by {self.lean_deg:.0f} deg"
        return ""


def surface_of(models: Sequence[pycolmap.Reconstruction], scene: Scene, tuning: WorldTuning) -> Surface | None:
    """The points of models in one frame; None if the cameras do not tell what is up, or the points are few."""
    limits = tuning.clouds
    poses = np.full((len(scene), 4, 4), np.nan)
    seen, ranges = [], []
    for model in models:
        own = image_poses(model, scene)
        there = np.isfinite(own).all(axis=(1, 2))
        poses[there] = own[there]
        xyz, image, point = tracks(model, scene)
        seen.append(xyz)
        ranges.append(np.linalg.norm(xyz[point] - transforms.centre(own)[image], axis=1))
    side = scene.of_role("side")
    up = up_vector(poses[side], scene.frame[side], tuning.up)
    if up is None or not sum(map(len, ranges)):
        return None
    range_, every = float(np.median(np.concatenate(ranges))), np.concatenate(seen)
    centres = transforms.centre(poses[np.isfinite(poses).all(axis=(1, 2))])
    near = every[cKDTree(centres).query(every)[0] < limits.reach * range_]
    if len(near) < limits.least_points:
        return None
    some = near[np.linspace(0, len(near) - 1, min(len(near), limits.most_points)).astype(int)]
    level = Rotation.align_vectors([[0.0, 0.0, 1.0]], [up.direction])[0].as_matrix()
    return Surface(some @ level.T, level, range_)


def fit_clouds(world: Surface, model: Surface, scale: float | None, tuning: CloudTuning) -> CloudFit | None:
    """The best place of a model's points on the world's, tested; ``scale``: world units per model unit, None = unknown.
    None if nothing fits at all, or the world is too wide to be searched."""
    known, held = model.xyz[::2], model.xyz[1::2]
    search = _Search(world, tuning)
    scales = np.array([scale]) if scale is not None else world.range_ / model.range_ * tuning.scales()
    middle = np.median(model.xyz, axis=0)[None]
    found: list[tuple[float, Similarity]] = []
    for start in search.starts(known, scales):
        fit = search.refined(known, start, free=scale is None)
        if fit is None:
            continue
        score = search.explained(held, fit)
        same = next((n for n, (_, f) in enumerate(found) if search.same(f(middle), fit(middle))), None)
        if same is None:
            found.append((score, fit))
        elif score > found[same][0]:
            found[same] = score, fit
    if not found:
        return None
    found.sort(key=lambda row: -row[0])
    best = found[0][1]
    other = search.refined(held, best, free=scale is None) or best
    turned = world.level.T @ best.rotation @ model.level
    return CloudFit(
        world_from_model=Similarity(best.scale, turned, world.level.T @ best.translation),
        explained=found[0][0],
        rival=found[1][0] if len(found) > 1 else 0.0,
        lean_deg=float(np.degrees(np.arccos(np.clip(best.rotation[2, 2], -1, 1)))),
        jump=float(np.linalg.norm(best(middle) - other(middle))),
        turn_deg=float(transforms.angle_deg(best.rotation, other.rotation)),
    )


class _Search:
    """Places on the points of the world."""

    def __init__(self, world: Surface, tuning: CloudTuning) -> None:
        self._xyz, self._tuning = world.xyz, tuning
        self._tree = cKDTree(world.xyz)
        self._range, self._cell = world.range_, tuning.cell * world.range_

    def starts(self, points: np.ndarray, scales: np.ndarray) -> list[Similarity]:
        """Where the most occupied cells of the points (N, 3) fall into those of the world, over turns and scales."""
        tuning = self._tuning
        wide = np.linalg.norm(np.ptp(points[:, :2], axis=0))
        extent = np.ptp(self._xyz, axis=0) + scales.max() * np.array([wide, wide, np.ptp(points[:, 2])])
        size = [scipy.fft.next_fast_len(int(n) + 4, real=True) for n in extent / self._cell]
        if np.prod(size, dtype=float) > _MOST_CELLS:
            return []
        here, corner = _occupied(self._xyz, self._cell)
        spectrum = scipy.fft.rfftn(binary_dilation(here, np.ones((3, 3, 3))).astype(np.float32), size)
        found: list[tuple[float, Similarity]] = []
        for scale in scales:
            for yaw in np.arange(0.0, 360.0, tuning.yaw_deg):
                turn = Rotation.from_euler("z", yaw, degrees=True).as_matrix()
                moved = scale * points @ turn.T
                there, low = _occupied(moved, self._cell)
                hits = (
                    scipy.fft.irfftn(spectrum * scipy.fft.rfftn(there[::-1, ::-1, ::-1].astype(np.float32), size), size)
                    / there.sum()
                )
                for share, at in _peaks(hits, tuning.peaks):
                    shift = corner - low + (at - np.array(there.shape) + 1) * self._cell
                    found.append((share, Similarity(float(scale), turn, shift)))
        found.sort(key=lambda row: -row[0])
        return [fit for _, fit in found[: tuning.tried]]

    def refined(self, points: np.ndarray, start: Similarity, free: bool) -> Similarity | None:
        """ICP from a place; ``free``: its scale too. None if too few points have a neighbour."""
        fit = start
        for cells in self._tuning.icp_cells:
            for _ in range(self._tuning.icp_rounds):
                away, nearest = self._tree.query(fit(points), distance_upper_bound=cells * self._cell)
                near = np.isfinite(away)
                if near.sum() < self._tuning.least_neighbours:
                    return None
                factor = 1.0 if free else fit.scale
                step = umeyama(factor * points[near], self._xyz[nearest[near]], with_scale=free)
                fit = Similarity(factor * step.scale, step.rotation, step.translation)
        return fit

    def explained(self, points: np.ndarray, fit: Similarity) -> float:
        """Share of points (N, 3) that lie on those of the world."""
        return float(np.mean(self._tree.query(fit(points))[0] < self._tuning.agree * self._range))

    def same(self, one: np.ndarray, two: np.ndarray) -> bool:
        """Whether two places (1, 3) of a point are one."""
        return bool(np.linalg.norm(one - two) < self._tuning.same_cells * self._cell)


def _occupied(points: np.ndarray, cell: float) -> tuple[np.ndarray, np.ndarray]:
    """(X, Y, Z) bool: cells with a point; and their low corner (3,)."""
    low = points.min(axis=0)
    at = ((points - low) / cell).astype(int)
    out = np.zeros(at.max(axis=0) + 1, bool)
    out[tuple(at.T)] = True
    return out, low


def _peaks(values: np.ndarray, count: int) -> Iterator[tuple[float, np.ndarray]]:
    """The largest values and where they are (3,), no two next to each other; ``values`` is used up."""
    for _ in range(count):
        at = np.array(np.unravel_index(np.argmax(values), values.shape))
        yield float(values[tuple(at)]), at
        values[tuple(slice(max(k - 2, 0), k + 3) for k in at)] = 0
