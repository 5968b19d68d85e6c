"""Depth maps compared with each other: a depth stands if enough images say the same (paper 004, section 5.3)."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import astuple, dataclass, fields, replace

import cv2
import numpy as np

from tiegraph.dense.settings import DenseSettings
from tiegraph.dense.tuning import RayTuning
from tiegraph.geometry.transforms import invert
from tiegraph.scene.results import DepthMap, row_strips

LoadDepth = Callable[[str], "DepthMap | None"]


@dataclass(frozen=True)
class Consistency:
    """What the comparison did to a depth map: pixels before, kept, dropped for two reasons; ``two_rays`` of the kept
    are seen by two images because no more could see them."""

    before: int
    kept: int
    few_views: int
    seen_through: int
    two_rays: int

    @staticmethod
    def total(parts: Iterable[Consistency]) -> Consistency:
        """Of several depth maps together."""
        return Consistency(*(sum(column) for column in zip((0,) * len(fields(Consistency)), *map(astuple, parts))))

    def table(self) -> dict:
        """The table {"columns", "rows"} of a receipt: what became of the pixels, and how many percent that is."""
        rows = {
            "matched with the partners, before the comparison": self.before,
            "kept": self.kept,
            "of these seen by two images, for no third could see them": self.two_rays,
            "dropped: too few depth maps say the same": self.few_views,
            "dropped: as many images see through them as confirm them": self.seen_through,
        }
        columns = ["pixels of the depth maps", "pixels", "%"]
        return {"columns": columns, "rows": [[k, n, round(100 * n / max(self.before, 1), 1)] for k, n in rows.items()]}


def check(
    depth: DepthMap,
    partners: Sequence[str],
    witnesses: Sequence[str],
    load: LoadDepth,
    settings: DenseSettings,
    tuning: RayTuning,
) -> tuple[DepthMap, Consistency]:
    """The depth map with witnesses counted and averaged in, pixels dropped on which fewer than ``min_views`` depth maps
    agree (one more where the sigma is above ``vague_share``), and those that as many images see through as confirm. To
    be hidden from most images is no reason: the inside of a porch is.

    The image's own matches do not count for this: two partners one step apart to either side mistake equal beams by the
    same depth, other images' depth maps hardly do. A partner without a depth map counts by its match.
    ``partners`` in the order of the bits of ``depth.support``; ``load`` returns a depth map by name or None where there
    is none. Where fewer images than ``min_views`` have the point in their frame all of them must agree, two at least,
    and one other depth map must say the same: ``views`` tells these points.
    """
    # Pixels compared together, so that the intermediate columns stay in the cache
    rows = row_strips(depth.depth_m.shape, 1 << 16)
    names = ("depth_m", "sigma_m", "views", *(() if depth.support is None else ("support",)))
    strips = [replace(depth, **{n: getattr(depth, n)[r] for n in names}) for r in rows]  # the camera is of the whole
    tallies = [_Tally.begin(strip) for strip in strips]
    unseen = set(partners)
    for name in witnesses:
        other = load(name)
        if other is None:
            continue
        unseen.discard(name)
        surface = _Surface.of(other)
        for k, strip in enumerate(strips):
            counted = _bit(strip, partners.index(name)) if name in partners else np.zeros(strip.depth_m.shape, bool)
            said = _compare(strip, rows[k].start, surface, settings.tolerance_px, tuning)
            tallies[k] = tallies[k].heard(said, counted)
    mapless = [k for k, name in enumerate(partners) if name in unseen]
    judged = [_judged(*pair, mapless, settings.min_views, tuning) for pair in zip(strips, tallies, strict=True)]
    joined = replace(
        depth,
        depth_m=np.concatenate([d.depth_m for d, _ in judged]),
        sigma_m=np.concatenate([d.sigma_m for d, _ in judged]),
        views=np.concatenate([d.views for d, _ in judged]),
        support=None,
    )
    return joined, Consistency.total(counts for _, counts in judged)


def _judged(
    depth: DepthMap, tally: _Tally, mapless: Sequence[int], min_views: int, tuning: RayTuning
) -> tuple[DepthMap, Consistency]:
    """What stays when all witnesses were heard but the ``mapless`` partners, which have no depth map."""
    known = np.isfinite(depth.depth_m)
    possible = 1 + tally.possible + len(mapless)  # a partner without a depth map might see everything
    relative = _relative_sigma(depth, tally)
    needed = np.clip(possible, 2, min_views + (relative > tuning.vague_share))
    alone = (needed < min_views) & (tally.maps < 2)
    matched = np.sum([_bit(depth, k) for k in mapless], axis=0, dtype=np.int16)
    few = known & ((tally.maps + matched < needed) | alone)
    floating = known & ~few & (tally.against >= tally.views)
    kept = known & ~few & ~floating
    counts = [int(np.count_nonzero(m)) for m in (known, kept, few, floating, kept & (tally.views == 2))]
    mean = np.where(kept, tally.weight, np.nan) / np.where(kept, tally.weighted, 1)
    sigma, views = relative * mean, np.where(kept, np.minimum(tally.views, 255), 0)
    found = {"depth_m": mean.astype(np.float32), "sigma_m": sigma.astype(np.float32), "views": views.astype(np.uint8)}
    return replace(depth, **found), Consistency(*counts)


def _bit(depth: DepthMap, k: int) -> np.ndarray:
    """(H, W) bool: the k-th partner took part."""
    if depth.support is None:
        return np.zeros(depth.depth_m.shape, bool)
    return (depth.support >> np.uint8(k)) & np.uint8(1) > 0


@dataclass(frozen=True, eq=False)
class _Said:
    """What one witness says of our pixels (H, W): whether its frame holds the point, agrees, sees through it; where it
    agrees our inverse depth by its depth, and that one's variance."""

    possible: np.ndarray
    agrees: np.ndarray
    through: np.ndarray
    inverse: np.ndarray
    variance: np.ndarray


@dataclass(frozen=True, eq=False)
class _Tally:
    """What the images say of each pixel (H, W): how many agree, see through it, could see it; how many depth maps
    are in the mean, and the sums of inverse depth by precision and of precision."""

    views: np.ndarray
    against: np.ndarray
    possible: np.ndarray
    maps: np.ndarray
    weighted: np.ndarray
    weight: np.ndarray

    @staticmethod
    def begin(depth: DepthMap) -> _Tally:
        """Before any witness was heard."""
        known = np.isfinite(depth.depth_m)
        inverse = np.where(known, 1 / np.where(known, depth.depth_m, 1), 0).astype(np.float64)
        weight = 1 / np.square(np.where(known, depth.sigma_m * inverse**2, 1.0))
        none = np.zeros(known.shape, np.int16)
        return _Tally(
            views=depth.views.astype(np.int16),
            against=none,
            possible=none,
            maps=none + np.int16(1),
            weighted=inverse * weight,
            weight=weight,
        )

    def heard(self, said: _Said, counted: np.ndarray) -> _Tally:
        """With one more witness; ``counted`` = its image is in ``views`` already."""
        weight = np.where(said.agrees, 1 / said.variance, 0)
        return _Tally(
            views=self.views + (said.agrees & ~counted),
            against=self.against + said.through,
            possible=self.possible + (said.possible | counted),
            maps=self.maps + said.agrees,
            weighted=self.weighted + said.inverse * weight,
            weight=self.weight + weight,
        )


def _relative_sigma(depth: DepthMap, tally: _Tally) -> np.ndarray:
    """(H, W) standard deviation of the mean as a share of the depth."""
    # Depth maps of neighbours come from the same image pairs: the mean has the variance of one of them, less only by
    # what the images add that are new.
    gain = np.maximum(depth.views.astype(np.float32) - 1, 1) / np.maximum(tally.views - 1, 1)
    known = tally.weighted > 0
    return np.sqrt(tally.maps * gain * tally.weight) / np.where(known, tally.weighted, np.inf)


def _compare(depth: DepthMap, top: int, surface: _Surface, tolerance_px: float, tuning: RayTuning) -> _Said:
    """One witness beside some rows of our depth map, of which ``top`` is the first."""
    z, sigma_z = depth.depth_m, depth.sigma_m
    other = surface.camera
    other_from_depth = other.cam_from_world @ invert(depth.cam_from_world)
    along = _along(depth, other_from_depth[:3, :3], top, len(z))  # our rays in the other's frame, per unit of depth
    x, y, ahead = (a * z + np.float32(t) for a, t in zip(along, other_from_depth[:3, 3], strict=True))
    their_z = np.where(ahead > 0, ahead, np.float32(np.nan))
    column = np.float32(other.K[0, 0]) * x / their_z + np.float32(other.K[0, 2])
    row = np.float32(other.K[1, 1]) * y / their_z + np.float32(other.K[1, 2])
    height, width = other.depth_m.shape
    possible = (column >= 0) & (column <= width) & (row >= 0) & (row <= height)  # NaN compares false
    inverse, relative_sigma = surface.at(column, row, tuning.max_relative)
    relative = 1 / (inverse * their_z) - 1  # their surface behind our point, as a share of its depth; NaN = not seen
    spread = np.hypot(sigma_z / z / np.float32(depth.sigma_px), relative_sigma / np.float32(other.sigma_px))
    tolerance = np.clip(tolerance_px * spread, tuning.min_relative, tuning.max_relative)
    agrees = np.abs(relative) <= tolerance
    through = relative > 1.5 * tolerance
    # Our ray meets their surface, taken as parallel to their image, a little further on; oblique rays are held back.
    said = z + np.where(agrees, relative * their_z, 0) / np.maximum(along[2], 0.3)
    said = np.where(agrees, 1 / np.where(agrees, said, 1), 0)
    variance = np.where(agrees, np.square(relative_sigma * said), 1)
    return _Said(possible=possible, agrees=agrees, through=through, inverse=said, variance=variance)


def _along(depth: DepthMap, rotation: np.ndarray, top: int, rows: int) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Rays with z = 1 through the pixel centres of some rows, turned: three columns (rows, W) f4. They are affine in
    the pixel, so each is a row plus a column."""
    matrix = rotation @ np.linalg.inv(depth.K)
    u = np.arange(depth.depth_m.shape[1]) + 0.5
    v = np.arange(top, top + rows) + 0.5
    x, y, z = ((m[0] * u)[None, :] + (m[1] * v + m[2])[:, None] for m in matrix)
    return x.astype(np.float32), y.astype(np.float32), z.astype(np.float32)


@dataclass(frozen=True, eq=False)
class _Surface:
    """A depth map to be looked up: inverse depth with 0 in holes, 1 where known, sigma as a share of the depth."""

    camera: DepthMap
    inverse: np.ndarray
    known: np.ndarray
    relative_sigma: np.ndarray

    @staticmethod
    def of(depth: DepthMap) -> _Surface:
        """Of a depth map."""
        known = np.isfinite(depth.depth_m)
        inverse = np.where(known, 1 / np.where(known, depth.depth_m, 1), 0).astype(np.float32)
        return _Surface(
            camera=depth,
            inverse=inverse,
            known=known.astype(np.float32),
            relative_sigma=(depth.sigma_m * inverse).astype(np.float32),
        )

    def at(self, column: np.ndarray, row: np.ndarray, max_relative: float) -> tuple[np.ndarray, np.ndarray]:
        """Inverse depth (linear between pixels of one surface, which is exact on planes; else the nearest pixel's) and
        its sigma as a share; NaN = nothing there."""
        x = np.clip(np.where(np.isfinite(column), column - np.float32(0.5), -9), -9, 32000)
        y = np.clip(np.where(np.isfinite(row), row - np.float32(0.5), -9), -9, 32000)

        def look(values: np.ndarray, how: int, outside: float) -> np.ndarray:
            return cv2.remap(values, x, y, how, borderMode=cv2.BORDER_CONSTANT, borderValue=outside)

        near = look(self.inverse, cv2.INTER_NEAREST, 0.0)
        linear = look(self.inverse, cv2.INTER_LINEAR, 0.0)
        whole = look(self.known, cv2.INTER_LINEAR, 0.0) > 0.999
        smooth = whole & (np.abs(linear - near) < max_relative * near)
        relative_sigma = look(self.relative_sigma, cv2.INTER_NEAREST, np.nan)
        return np.where(near > 0, np.where(smooth, linear, near), np.float32(np.nan)), relative_sigma
