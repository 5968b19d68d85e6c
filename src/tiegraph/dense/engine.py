"""The engine interface of the dense stage, and the engines that match rectified pairs.

An engine makes the depth map of one reference view from its partner views (``DenseEngine``). The engines here share
rectification, masking, the way back into the reference and the triangulation over all partners; they differ only in the
matcher of a rectified pair (``PairMatcher``). An engine that matches otherwise is one more entry of ``ENGINES``.

**Triangulation** (paper 004, section 5.3 and figure 5): one point on each ray of the base image from the disparities of
all its partners. A disparity is the place of the corresponding ray in the partner's epipolar image, and that place is a
linear function of the inverse depth along the base pixel's ray. So the intersection of all rays that minimises the
errors in the images is a weighted mean of inverse depths: the linear solution is already the one that Hartley &
Zisserman refine to, and what is left to refine is who takes part and with what weight.
"""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np

from tiegraph.dense.plan import DepthRange
from tiegraph.dense.settings import DenseSettings
from tiegraph.dense.tsgm import MAX_CELLS, kernel_in_use, kernels, match_sgbm, match_tsgm, volume_bytes
from tiegraph.dense.tuning import RayTuning, Tuning
from tiegraph.geometry.stereo import Pinhole, Rectification, rectify
from tiegraph.scene.results import DepthMap, row_strips

_BITS = np.array([bin(k).count("1") for k in range(256)], np.uint8)
_HALF = np.array([[1.0, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])  # from OpenCV's pixel coordinates to ours

_log = logging.getLogger(__name__)


@dataclass(frozen=True, eq=False)
class DenseView:
    """An undistorted image: image_bgr (H, W, 3) u1, mask (H, W) bool (True = use), K (3, 3), cam_from_world (4, 4)."""

    name: str
    image_bgr: np.ndarray
    mask: np.ndarray
    K: np.ndarray
    cam_from_world: np.ndarray

    @property
    def pinhole(self) -> Pinhole:
        """The camera alone."""
        return Pinhole(self.K, self.cam_from_world, (self.image_bgr.shape[1], self.image_bgr.shape[0]))


@dataclass(frozen=True, eq=False)
class Candidates:
    """What one partner proposes: inverse (H, W) f4 inverse depth, unit (H, W) f4 that of one pixel; NaN = none.

    Inverse depth is the natural variable: disparities are linear in it, and so are their errors.
    """

    inverse: np.ndarray
    unit: np.ndarray

    @staticmethod
    def nothing(shape: tuple[int, int]) -> "Candidates":
        """A partner that proposes nothing."""
        return Candidates(np.full(shape, np.nan, np.float32), np.full(shape, np.nan, np.float32))


DenseEngine = Callable[[DenseView, Sequence[DenseView], DepthRange, DenseSettings, Tuning], DepthMap]

# (left (h, w) u1, right (h, w + disparities) u1, disparities, settings, tuning, use (h, w) bool: where the disparity
# matters) -> (h, w) f4 disparity of left, NaN = none.
# Column ``disparities`` of right lies under column 0 of left; left x shows what right x + disparities - d shows.
PairMatcher = Callable[[np.ndarray, np.ndarray, int, DenseSettings, Tuning, np.ndarray], np.ndarray]


def rectified_engine(
    reference: DenseView,
    partners: Sequence[DenseView],
    depth_range: DepthRange,
    settings: DenseSettings,
    tuning: Tuning,
    matcher: PairMatcher,
    max_cells: float = np.inf,
) -> DepthMap:
    """Depth map of the reference: each rectified pair matched, the rays of all partners intersected.

    Keeps pixels on which at least one partner's match stands, with the number of images that agree in ``views``; the
    demand for ``min_views`` comes after the comparison of depth maps (``depth``), which adds witnesses.
    """
    candidates = propose(reference, partners, depth_range, settings, tuning, matcher, max_cells)
    return solve(reference, candidates, settings, tuning.rays)


def propose(
    reference: DenseView,
    partners: Sequence[DenseView],
    depth_range: DepthRange,
    settings: DenseSettings,
    tuning: Tuning,
    matcher: PairMatcher,
    max_cells: float = np.inf,
) -> list[Candidates]:
    """What each partner says of each pixel of the reference; at least one entry. Pairs with more pixels times
    disparities than ``max_cells`` are matched at a coarser resolution."""
    shape = reference.mask.shape
    most = int(min(tuning.pairs.max_disparities, max_cells / (shape[0] * shape[1] * tuning.pairs.max_pixels_ratio)))
    most = max(most, 16)
    found = [_match_pair(reference, p, depth_range, settings, tuning, matcher, most) for p in partners]
    return found or [Candidates.nothing(shape)]


def solve(
    reference: DenseView, candidates: Sequence[Candidates], settings: DenseSettings, tuning: RayTuning
) -> DepthMap:
    """The depth map of the reference from its partners' proposals (``triangulate``)."""
    found = triangulate(candidates, settings.tolerance_px, tuning)
    inverse = np.where(reference.mask, found.inverse, np.float32(np.nan))
    depth = (1.0 / inverse).astype(np.float32)
    views = _BITS[found.support] + np.uint8(1)
    known = np.isfinite(depth)
    return DepthMap(
        image=reference.name,
        depth_m=depth,
        sigma_m=np.where(known, found.sigma * depth * depth, np.float32(np.nan)).astype(np.float32),
        views=np.where(known, views, 0).astype(np.uint8),
        K=reference.K,
        cam_from_world=reference.cam_from_world,
        support=np.where(known, found.support, 0).astype(np.uint8),
        sigma_px=found.sigma_px,
    )


# OpenCV's matcher does not bound its cost volume; tsgm does (``tsgm.volume_bytes``).
ENGINES: dict[str, DenseEngine] = {
    "tsgm": partial(rectified_engine, matcher=match_tsgm),
    "sgbm": partial(rectified_engine, matcher=match_sgbm, max_cells=MAX_CELLS),
}


def installed(name: str) -> tuple[str, str]:
    """(name of the engine that can be used here, remark): OpenCV's stands in where the native module was not built."""
    if name == "tsgm" and not kernels():
        return "sgbm", (
            "the native matcher was not built (no C++ compiler at installation): depth maps by OpenCV's; "
            "install a compiler and tiegraph again for tsgm"
        )
    return name, ""


def matched_by(settings: DenseSettings, tuning: Tuning) -> str:
    """What matches the pairs in this process: OpenCV, a kernel of tsgm, or a plug-in."""
    name = installed(settings.engine)[0]
    return kernel_in_use(tuning.tsgm) if name == "tsgm" else {"sgbm": "OpenCV"}.get(name, name)


def most_volume_bytes(size: tuple[int, int], tuning: Tuning) -> int:
    """Most bytes of cost volumes that a pair of reference images (width, height) takes with tsgm."""
    scale, most = np.sqrt(tuning.pairs.max_pixels_ratio), tuning.pairs.max_disparities
    return volume_bytes(int(np.ceil(scale * size[1])), int(np.ceil(scale * size[0])), most, tuning.tsgm)


def _match_pair(
    reference: DenseView,
    partner: DenseView,
    depth_range: DepthRange,
    settings: DenseSettings,
    tuning: Tuning,
    matcher: PairMatcher,
    most: int,
) -> Candidates:
    height, width = reference.mask.shape
    sought, most_pixels = (depth_range.near, depth_range.far), tuning.pairs.max_pixels_ratio * height * width
    pair = rectify(reference.pinhole, partner.pinhole, sought, most_pixels, most)
    if pair is None:
        _log.debug("%s and %s share no part that can be rectified", reference.name, partner.name)
        return Candidates.nothing((height, width))
    left, right, right_mask = _rectified_images(reference, partner, pair)
    use = _warped_mask(reference.mask, pair.rect_from_reference, pair.size)
    disparity = matcher(left, right, pair.disparities, settings, tuning, use)
    known = np.isfinite(disparity)  # whose right pixel is a usable pixel of the partner
    for rows in row_strips(disparity.shape):
        column = np.arange(disparity.shape[1]) + pair.disparities - np.rint(np.where(known[rows], disparity[rows], 0))
        column = np.clip(column.astype(np.int64), 0, right_mask.shape[1] - 1)
        known[rows] &= np.take_along_axis(right_mask[rows], column, axis=1)
    disparity = np.where(known, disparity, np.float32(np.nan))
    return _to_reference(disparity, pair, (height, width), depth_range)


def _rectified_images(
    reference: DenseView, partner: DenseView, pair: Rectification
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Grey left (h, w), grey right (h, w + D), and where the right shows usable pixels of the partner."""
    w, h = pair.size
    shift = np.array([[1.0, 0, pair.disparities], [0, 1, 0], [0, 0, 1]])
    right_size = (w + pair.disparities, h)
    rect_from_partner = shift @ pair.rect_from_partner
    left, right = (
        cv2.warpPerspective(
            cv2.cvtColor(view.image_bgr, cv2.COLOR_BGR2GRAY), _between_centres(rect_from_view), size,
            flags=cv2.INTER_CUBIC, borderMode=cv2.BORDER_REPLICATE,
        )
        for view, rect_from_view, size in (
            (reference, pair.rect_from_reference, pair.size), (partner, rect_from_partner, right_size)
        )
    )  # fmt: skip
    use = _warped_mask(partner.mask, rect_from_partner, right_size)
    # Behind the partner's camera the homography shows a mirrored image.
    partner_from_rect = np.linalg.inv(rect_from_partner)[2]
    x, y = np.arange(right_size[0]) + 0.5, np.arange(h) + 0.5
    front = partner_from_rect[0] * x[None, :] + partner_from_rect[1] * y[:, None] + partner_from_rect[2] > 0
    return left, right, use & front


def _between_centres(homography: np.ndarray) -> np.ndarray:
    """A homography of pixel coordinates as OpenCV counts them: (0, 0) is the centre of the first pixel."""
    return np.linalg.inv(_HALF) @ homography @ _HALF


def _warped_mask(mask: np.ndarray, target_from_source: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    matrix = _between_centres(target_from_source)
    return cv2.warpPerspective(mask.astype(np.uint8), matrix, size, flags=cv2.INTER_NEAREST, borderValue=0) > 0


def _to_reference(
    disparity: np.ndarray, pair: Rectification, shape: tuple[int, int], depth_range: DepthRange
) -> Candidates:
    """Inverse depth and its uncertainty at the reference's pixels, of disparities in the rectified window."""
    at = _resample(disparity, pair.rect_from_reference, shape)
    found = Candidates.nothing(shape)
    u, margin = np.arange(shape[1]) + 0.5, 2.0  # beyond the range sought by more is dropped
    for rows in row_strips(shape):
        v = (np.arange(rows.start, rows.stop) + 0.5)[:, None]
        per_px = pair.inverse_depth_per_px(u, v)
        inverse = per_px * (at[rows] + pair.offset)
        good = (per_px > 0) & (inverse > 1 / margin / depth_range.far) & (inverse < margin / depth_range.near)
        np.copyto(found.inverse[rows], inverse, "same_kind", where=good)
        np.copyto(found.unit[rows], per_px * np.maximum(pair.stretch(u, v), 1.0), "same_kind", where=good)
    return found


def _resample(disparity: np.ndarray, rect_from_reference: np.ndarray, shape: tuple[int, int]) -> np.ndarray:
    """Disparity (H, W) at each reference pixel: interpolated on surfaces, nearest at jumps of a pixel and gaps."""
    matrix = _between_centres(rect_from_reference)

    def warp(values: np.ndarray, how: int, outside: float) -> np.ndarray:
        return cv2.warpPerspective(values, matrix, shape[::-1], flags=how | cv2.WARP_INVERSE_MAP, borderValue=outside)

    nearest = warp(disparity, cv2.INTER_NEAREST, np.nan)
    known = np.isfinite(disparity).astype(np.float32)
    weight = warp(known, cv2.INTER_LINEAR, 0.0)
    linear = warp(np.where(known > 0, disparity, np.float32(0)), cv2.INTER_LINEAR, 0.0)
    smooth = (weight > 0.999) & (np.abs(linear - nearest) < 1)
    return np.where(smooth, linear, nearest)


@dataclass(frozen=True, eq=False)
class Triangulation:
    """inverse (H, W) f4 inverse depth along the base rays, sigma (H, W) f4 its standard deviation, NaN = none; support
    (H, W) u1 bit mask of the partners that took part; sigma_px that of one disparity."""

    inverse: np.ndarray
    sigma: np.ndarray
    support: np.ndarray
    sigma_px: float


def triangulate(candidates: Sequence[Candidates], tolerance_px: float, tuning: RayTuning) -> Triangulation:
    """The intersection of the base rays with their partners' rays.

    1. *Consensus*: the proposal that most others agree with, within ``tolerance_px`` of both pairs' pixels together and
       ``max_relative`` of the depth; between equals the one with most information.
    2. *Linear*: the mean of those that agree, weighted by precision.
    3. *Refined*: all partners judged again by their residual from the mean, those beyond ``tolerance_px`` left out, the
       others weighted by Huber.

    The sigma follows from the disparities' (``disparity_sigma_px``: what the partners of this image say of each other),
    the geometry of the rays that took part, and their residuals where these are larger than they should be.
    """
    shape = candidates[0].inverse.shape

    def proposals(pixels: slice) -> tuple[np.ndarray, np.ndarray]:
        """Of some pixels, (K, n) each."""
        chosen = ([values.ravel()[pixels] for values in (c.inverse, c.unit)] for c in candidates)
        inverse, unit = zip(*chosen, strict=True)
        return np.stack(inverse), np.stack(unit)

    count = candidates[0].inverse.size
    some = proposals(slice(None, None, max(1, count // 100_000)))  # pixels of an image that tell its sigma
    sigma_px = disparity_sigma_px(*some, tolerance_px, tuning)
    parts = row_strips((count, 1), 1 << 15)  # pixels solved together, so that the partners' columns stay in the cache
    found = [_solve(*proposals(pixels), tolerance_px, sigma_px, tuning) for pixels in parts]
    depth, sigma, support = (np.concatenate(part).reshape(shape) for part in zip(*found, strict=True))
    return Triangulation(inverse=depth, sigma=sigma, support=support, sigma_px=sigma_px)


def disparity_sigma_px(inverse: np.ndarray, unit: np.ndarray, tolerance_px: float, tuning: RayTuning) -> float:
    """One standard deviation of a disparity in this image, from the differences of the proposals (K, n) of its partners
    that agree; ``sigma_px`` of the tuning where too few do."""
    differences = [np.zeros(0, np.float32)]
    for j in range(len(inverse)):
        for k in range(j):
            apart = np.abs(inverse[j] - inverse[k]) / np.hypot(unit[j], unit[k])
            differences.append(apart[apart < tolerance_px])
    together = np.concatenate(differences)
    if len(together) < 1000:
        return tuning.sigma_px
    own = np.sqrt(1 - tuning.shared_variance)  # the shared part of an error does not differ
    return float(np.clip(1.4826 * np.median(together) / own, 0.1, 0.5))


def _solve(
    inverse: np.ndarray, unit: np.ndarray, tolerance_px: float, sigma_px: float, tuning: RayTuning
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The three steps for n pixels of K partners (K, n)."""
    known = np.isfinite(inverse)
    value = np.where(known, inverse, np.float32(0))
    weight = np.where(known, 1 / np.square(unit), np.float32(0))
    part = _consensus(inverse, unit, weight, tolerance_px, tuning.max_relative)
    mean = _mean(value, weight * part)
    for _ in range(2):
        residual = np.abs(inverse - mean) / unit  # pixels of disparity; NaN = none
        part = (residual <= tolerance_px) & (np.abs(inverse - mean) <= tuning.max_relative * mean)
        # Residual from which a ray loses weight, Huber's constant: 95 % efficient on normal errors
        robust = weight * part / np.maximum(1, np.where(part, residual, 0) / (1.345 * sigma_px))
        mean = _mean(value, robust, mean)
    bits = np.packbits(part, axis=0, bitorder="little")[0]  # of eight partners at most
    return mean, _sigma(value, weight * part, mean, sigma_px, tuning.shared_variance), bits


def _consensus(
    inverse: np.ndarray, unit: np.ndarray, weight: np.ndarray, tolerance_px: float, max_relative: float
) -> np.ndarray:
    """(K, n) bool: the largest set that agrees with one of its members."""
    count = len(inverse)
    agrees = np.zeros((count, count, inverse.shape[1]), bool)
    for j in range(count):
        agrees[j, j] = np.isfinite(inverse[j])
        for k in range(j):
            limit = tolerance_px * np.hypot(unit[j], unit[k])
            limit = np.minimum(limit, max_relative * np.minimum(inverse[j], inverse[k]))
            agrees[j, k] = agrees[k, j] = np.abs(inverse[j] - inverse[k]) <= limit  # NaN compares false
    # Votes first; information, squashed to below one vote, decides between equals.
    total = weight.sum(axis=0)
    share = 0.99 / np.where(total > 0, total, 1)
    score = np.stack([a.sum(axis=0) + share * np.sum(weight * a, axis=0) for a in agrees])
    best = np.argmax(score, axis=0)
    return np.take_along_axis(agrees, best[None, None, :], axis=0)[0]


def _mean(value: np.ndarray, weight: np.ndarray, otherwise: np.ndarray | None = None) -> np.ndarray:
    """(n,) f4 weighted mean; where nothing has weight ``otherwise``, NaN without."""
    total = weight.sum(axis=0)
    mean = np.sum(value * weight, axis=0) / np.where(total > 0, total, 1)
    return np.where(total > 0, mean, np.nan if otherwise is None else otherwise).astype(np.float32)


def _sigma(
    value: np.ndarray, weight: np.ndarray, mean: np.ndarray, sigma_px: float, shared_variance: float
) -> np.ndarray:
    """(n,) f4 standard deviation of the inverse depth: the shared part of the errors does not average out."""
    total = weight.sum(axis=0)
    safe = np.where(total > 0, total, 1)
    count = np.sum(weight > 0, axis=0)
    own = (1 - shared_variance) * sigma_px**2
    chi2 = np.sum(weight * np.square(value - mean), axis=0) / own
    inflation = np.maximum(1, chi2 / np.maximum(count - 1, 1))
    # The shared error is one of the base image: as a disparity it is the same for all partners.
    shared = shared_variance * sigma_px**2 * np.square(np.sum(np.sqrt(weight), axis=0) / safe)
    sigma = np.sqrt(own * inflation / safe + shared)
    return np.where(total > 0, sigma, np.nan).astype(np.float32)
