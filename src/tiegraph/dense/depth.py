"""The two steps of a depth map, each for one image in one worker: match with partners, then compare with neighbours.

In the comparison a depth stands if enough images say the same (paper 004, section 5.3).
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass, fields, replace
from pathlib import Path
from typing import NamedTuple

import cv2
import numpy as np

from tiegraph.dense.engine import ENGINES, installed
from tiegraph.dense.plan import ImagePlan
from tiegraph.dense.settings import DenseSettings
from tiegraph.dense.tuning import RayTuning, Tuning
from tiegraph.dense.undistort import load_view
from tiegraph.geometry.transforms import invert
from tiegraph.plugins import chosen
from tiegraph.scene.results import DepthMap, row_strips

LoadDepth = Callable[[str], "DepthMap | None"]


def depth_map(
    plan: ImagePlan, images: Path, masks: Path | None, settings: DenseSettings, tuning: Tuning, threads: int = 1
) -> DepthMap:
    """First step: match one image with its partners. ``masks`` None = use all pixels.

    ``threads`` limits OpenCV in this process. Raises InputError for an image that cannot be read.
    """
    cv2.setNumThreads(threads)
    engine = chosen("dense", installed(settings.engine)[0], ENGINES)
    reference = load_view(plan.view, images, masks, settings)
    partners = [load_view(view, images, masks, settings) for view in plan.partners]
    return engine(reference, partners, plan.depth_range, settings, tuning)  # type: ignore[no-any-return]


def confirmed_map(
    plan: ImagePlan, depth: DepthMap, load: LoadDepth, settings: DenseSettings, tuning: Tuning
) -> tuple[DepthMap, Consistency]:
    """Second step, when all first steps are done: compare with the witnesses' first maps (``load`` by name), then fit
    normals."""
    partners = [view.name for view in plan.partners]
    confirmed, counts = check(depth, partners, plan.witnesses, load, settings, tuning.rays)
    return with_normals(confirmed), counts


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
        every = list(parts)
        return Consistency(*(sum(getattr(part, f.name) for part in every) for f in fields(Consistency)))

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
    # The camera is of the whole
    tallies = [Tally(replace(depth, **{n: getattr(depth, n)[r] for n in names}), r.start) for r in rows]
    unseen = set(partners)
    for name in witnesses:
        other = load(name)
        if other is None:
            continue
        unseen.discard(name)
        surface = Surface(other)
        for tally in tallies:
            partner = partners.index(name) if name in partners else None
            tally.hear(surface, partner, settings.tolerance_px, tuning)
    mapless = [k for k, name in enumerate(partners) if name in unseen]
    judged = [tally.judged(mapless, settings.min_views, tuning) for tally in tallies]
    columns = ("depth_m", "sigma_m", "views")
    depth_m, sigma_m, views = (np.concatenate([found[n] for found, _ in judged]) for n in columns)
    joined = replace(depth, depth_m=depth_m, sigma_m=sigma_m, views=views, support=None)
    return joined, Consistency.total(counts for _, counts in judged)


class Tally:
    """What the images say of each pixel (H, W) of some rows of a depth map, of which ``top`` is the first: how many
    agree (``views``), see through it (``against``), could see it (``possible``); how many depth maps are in the mean
    (``maps``), and the sums of inverse depth by precision (``weighted``) and of precision (``weight``)."""

    def __init__(self, depth: DepthMap, top: int = 0) -> None:
        self.depth, self.top = depth, top
        known = np.isfinite(depth.depth_m)
        inverse = np.where(known, 1 / np.where(known, depth.depth_m, 1), 0).astype(np.float64)
        self.weight = 1 / np.square(np.where(known, depth.sigma_m * inverse**2, 1.0))
        self.weighted = inverse * self.weight
        self.views = depth.views.astype(np.int16)
        self.against, self.possible = np.zeros((2, *known.shape), np.int16)
        self.maps = np.ones(known.shape, np.int16)

    def matched(self, k: int) -> np.ndarray:
        """(H, W) bool: the k-th partner took part."""
        if self.depth.support is None:
            return np.zeros(self.depth.depth_m.shape, bool)
        return (self.depth.support >> np.uint8(k)) & np.uint8(1) > 0

    def hear(self, surface: Surface, partner: int | None, tolerance_px: float, tuning: RayTuning) -> None:
        """One more witness; ``partner``: its number, if it is a partner, which may be in ``views`` already."""
        seen = surface.seen(self.depth, self.top, tolerance_px, tuning)
        agrees = seen.agrees
        said = np.where(agrees, 1 / np.where(agrees, seen.said, 1), 0)
        variance = np.where(agrees, np.square(seen.relative_sigma * said), 1)
        weight = np.where(agrees, 1 / variance, 0)
        counted = np.zeros(agrees.shape, bool) if partner is None else self.matched(partner)
        self.views += agrees & ~counted
        self.against += seen.through
        self.possible += seen.possible | counted
        self.maps += agrees
        self.weighted += said * weight
        self.weight += weight

    def judged(
        self, mapless: Sequence[int], min_views: int, tuning: RayTuning
    ) -> tuple[dict[str, np.ndarray], Consistency]:
        """What stays when all witnesses were heard but the ``mapless`` partners, which have no depth map: fields of the
        depth map, and counts."""
        known = np.isfinite(self.depth.depth_m)
        possible = 1 + self.possible + len(mapless)  # a partner without a depth map might see everything
        # Depth maps of neighbours come from the same image pairs: the mean has the variance of one of them, less only
        # by what the images add that are new.
        gain = np.maximum(self.depth.views.astype(np.float32) - 1, 1) / np.maximum(self.views - 1, 1)
        relative = np.sqrt(self.maps * gain * self.weight) / np.where(self.weighted > 0, self.weighted, np.inf)
        needed = np.clip(possible, 2, min_views + (relative > tuning.vague_share))
        alone = (needed < min_views) & (self.maps < 2)
        matched = np.sum([self.matched(k) for k in mapless], axis=0, dtype=np.int16)
        few = known & ((self.maps + matched < needed) | alone)
        floating = known & ~few & (self.against >= self.views)
        kept = known & ~few & ~floating
        counts = [int(np.count_nonzero(m)) for m in (known, kept, few, floating, kept & (self.views == 2))]
        mean = np.where(kept, self.weight, np.nan) / np.where(kept, self.weighted, 1)
        sigma, views = relative * mean, np.where(kept, np.minimum(self.views, 255), 0)
        found = {"depth_m": mean.astype(np.float32), "sigma_m": sigma.astype(np.float32)}
        return found | {"views": views.astype(np.uint8)}, Consistency(*counts)


class Seen(NamedTuple):
    """What a depth map says of the pixels (H, W) of another one: which lie in its image (``possible``), which it
    confirms (``agrees``) and sees through (``through``), to another surface for sure (``beyond``), the depth it says of
    those it confirms (``said``), and its sigma as a share."""

    possible: np.ndarray
    agrees: np.ndarray
    through: np.ndarray
    beyond: np.ndarray
    said: np.ndarray
    relative_sigma: np.ndarray


def gone(depth: DepthMap, others: Sequence[str], load: LoadDepth, tolerance_px: float, tuning: RayTuning) -> np.ndarray:
    """(H, W) bool: the pixels of a finished depth map that were there in its own pass only, such as a parked car, which
    all images of that pass confirm: at least two finished maps of images of other passes (``others``) see another
    surface beyond them, and more than confirm them. A small step between both may be of passes that do not lie on each
    other, and is left to the comparison of passes."""
    through, agree = np.zeros((2, *depth.depth_m.shape), np.int16)
    for name in others:
        if (other := load(name)) is None:
            continue
        surface = Surface(other)
        for rows in row_strips(depth.depth_m.shape, 1 << 16):
            part = replace(depth, depth_m=depth.depth_m[rows], sigma_m=depth.sigma_m[rows])
            seen = surface.seen(part, rows.start, tolerance_px, tuning)
            through[rows] += seen.beyond
            agree[rows] += seen.agrees
    return (through >= 2) & (through > agree)


class Surface:
    """A depth map to be looked up: inverse depth with 0 in holes, 1 where known, sigma as a share of the depth."""

    def __init__(self, depth: DepthMap) -> None:
        self.camera, known = depth, np.isfinite(depth.depth_m)
        self.inverse = np.where(known, 1 / np.where(known, depth.depth_m, 1), 0).astype(np.float32)
        self.known = known.astype(np.float32)
        self.relative_sigma = (depth.sigma_m * self.inverse).astype(np.float32)

    def seen(self, depth: DepthMap, top: int, tolerance_px: float, tuning: RayTuning) -> Seen:
        """What it says of some rows of another depth map, of which ``top`` is the first."""
        other = self.camera
        z, sigma_z = depth.depth_m, depth.sigma_m
        other_from_depth = other.cam_from_world @ invert(depth.cam_from_world)
        # Our rays with z = 1 in the other's frame: they are affine in the pixel, so each is a row plus a column
        u, v = np.arange(z.shape[1]) + 0.5, np.arange(top, top + len(z)) + 0.5
        matrix = other_from_depth[:3, :3] @ np.linalg.inv(depth.K)
        along = [((m[0] * u)[None, :] + (m[1] * v + m[2])[:, None]).astype(np.float32) for m in matrix]
        x, y, ahead = (a * z + np.float32(t) for a, t in zip(along, other_from_depth[:3, 3], strict=True))
        their_z = np.where(ahead > 0, ahead, np.float32(np.nan))
        column = np.float32(other.K[0, 0]) * x / their_z + np.float32(other.K[0, 2])
        row = np.float32(other.K[1, 1]) * y / their_z + np.float32(other.K[1, 2])
        height, width = other.depth_m.shape
        possible = (column >= 0) & (column <= width) & (row >= 0) & (row <= height)  # NaN compares false
        inverse, relative_sigma = self.at(column, row, tuning.max_relative)
        relative = 1 / (inverse * their_z) - 1  # their surface behind our point, as a share of its depth; NaN = unseen
        spread = np.hypot(sigma_z / z / np.float32(depth.sigma_px), relative_sigma / np.float32(other.sigma_px))
        tolerance = np.clip(tolerance_px * spread, tuning.min_relative, tuning.max_relative)
        agrees = np.abs(relative) <= tolerance
        # Our ray meets their surface, taken as parallel to their image, a little further on; oblique ones are held back
        said = z + np.where(agrees, relative * their_z, 0) / np.maximum(along[2], 0.3)
        return Seen(
            possible=possible,
            agrees=agrees,
            through=relative > 1.5 * tolerance,
            beyond=relative > 1.5 * tuning.max_relative,
            said=said,
            relative_sigma=relative_sigma,
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


_RADIUS_PX = 3  # of the window that a plane is fitted in


def with_normals(depth: DepthMap) -> DepthMap:
    """The depth map with normals (H, W, 3) f4 in the camera frame that face the camera; NaN where no plane fits.

    On a plane inverse depth is an affine function of the pixel: 1/z = a u + b v + c, and the normal is along
    (a fx, b fy, a cx + b cy + c). The least squares fit in a window is a few box filters, holes left out.
    """
    found = 1 / depth.depth_m[np.isfinite(depth.depth_m)]
    middle = float(np.median(found.astype(float))) if len(found) else 1.0
    normal, K = np.empty((*depth.depth_m.shape, 3), np.float32), depth.K
    for rows in row_strips(depth.depth_m.shape):
        top = max(0, rows.start - _RADIUS_PX)
        depth_m, inner = depth.depth_m[top : rows.stop + _RADIUS_PX], slice(rows.start - top, rows.stop - top)
        known = np.isfinite(depth_m)
        inverse = np.where(known, 1 / np.where(known, depth_m, 1), 0).astype(np.float64)
        (a, b, c), good = (values[..., inner, :] for values in _planes(known.astype(np.float64), inverse / middle))
        u, v = np.arange(depth_m.shape[1]) + 0.5, (np.arange(rows.start, rows.stop) + 0.5)[:, None]
        # The window's plane is w = a (u' - u) + b (v' - v) + c about its centre (u, v).
        x, y = (u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1]
        n_x, n_y = a * K[0, 0], b * K[1, 1]
        across = np.stack([n_x, n_y, c - n_x * x - n_y * y], axis=-1)
        across = -across / np.maximum(np.linalg.norm(across, axis=-1, keepdims=True), 1e-12)
        normal[rows] = np.where((good & known[inner])[..., None], across, np.nan)
    return replace(depth, normal=normal)


def _planes(known: np.ndarray, w: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Coefficients (3, H, W) of the plane w = a du + b dv + c that fits the known pixels in the window about each pixel
    best, and where it fits well (H, W) bool."""
    k0 = np.ones(2 * _RADIUS_PX + 1)
    k1 = np.arange(-_RADIUS_PX, _RADIUS_PX + 1, dtype=float)
    k2 = k1**2

    def moment(values: np.ndarray, kx: np.ndarray, ky: np.ndarray) -> np.ndarray:
        return cv2.sepFilter2D(values, cv2.CV_64F, kx, ky, borderType=cv2.BORDER_CONSTANT)

    wm = w * known
    n, su, sv = moment(known, k0, k0), moment(known, k1, k0), moment(known, k0, k1)
    suu, svv, suv = moment(known, k2, k0), moment(known, k0, k2), moment(known, k1, k1)
    sw, swu, swv = moment(wm, k0, k0), moment(wm, k1, k0), moment(wm, k0, k1)
    sww = moment(wm * w, k0, k0)
    count = np.maximum(n, 1)
    mu, mv, mw = su / count, sv / count, sw / count
    cuu, cvv, cuv = suu / count - mu**2, svv / count - mv**2, suv / count - mu * mv
    cwu, cwv = swu / count - mw * mu, swv / count - mw * mv
    det = cuu * cvv - cuv**2
    safe = np.where(det > 1e-3, det, 1)
    a, b = (cwu * cvv - cwv * cuv) / safe, (cwv * cuu - cwu * cuv) / safe
    c = mw - a * mu - b * mv
    residual = np.maximum(sww / count - mw**2 - a * cwu - b * cwv, 0)
    good = (n >= 12) & (det > 1e-3) & (residual <= (0.02 * mw) ** 2)  # more is an edge
    return np.stack([a, b, c]), good
