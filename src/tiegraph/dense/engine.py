"""The engine interface of the dense stage, and the engines that match rectified pairs.

An engine makes the depth map of one reference view from its partner views (``DenseEngine``). The engines here share
rectification, masking, the way back into the reference and the triangulation over all partners; they differ only in the
matcher of a rectified pair (``PairMatcher``). An engine that matches otherwise is one more entry of ``ENGINES``.
"""

import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from functools import partial

import cv2
import numpy as np

from tiegraph.dense.plan import DepthRange
from tiegraph.dense.settings import DenseSettings
from tiegraph.dense.sgbm import MAX_CELLS, match_sgbm
from tiegraph.dense.triangulate import Candidates, triangulate
from tiegraph.dense.tsgm import available, kernel_in_use, match_tsgm, volume_bytes
from tiegraph.dense.tuning import RayTuning, Tuning
from tiegraph.geometry.stereo import Pinhole, Rectification, rectify
from tiegraph.scene.results import DepthMap, row_strips

_BITS = np.array([bin(k).count("1") for k in range(256)], np.uint8)

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
    demand for ``min_views`` comes after the comparison of depth maps (``consistency``), which adds witnesses.
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
    return [f if f is not None else Candidates.nothing(shape) for f in found] or [Candidates.nothing(shape)]


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
    if name == "tsgm" and not available():
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
) -> Candidates | None:
    height, width = reference.mask.shape
    pair = rectify(
        reference.pinhole,
        partner.pinhole,
        (depth_range.near, depth_range.far),
        tuning.pairs.max_pixels_ratio * height * width,
        most,
    )
    if pair is None:
        _log.debug("%s and %s share no part that can be rectified", reference.name, partner.name)
        return None
    left, right, right_mask = _rectified_images(reference, partner, pair)
    use = _warp(
        reference.mask.astype(np.uint8), pair.rect_from_reference, pair.size, cv2.INTER_NEAREST, replicate=False
    )
    disparity = matcher(left, right, pair.disparities, settings, tuning, use > 0)
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
    left = _warp(_grey(reference.image_bgr), pair.rect_from_reference, pair.size, cv2.INTER_CUBIC)
    rect_from_partner = shift @ pair.rect_from_partner
    right = _warp(_grey(partner.image_bgr), rect_from_partner, right_size, cv2.INTER_CUBIC)
    use = _warp(partner.mask.astype(np.uint8), rect_from_partner, right_size, cv2.INTER_NEAREST, replicate=False) > 0
    # Behind the partner's camera the homography shows a mirrored image.
    partner_from_rect = np.linalg.inv(rect_from_partner)[2]
    x, y = np.arange(right_size[0]) + 0.5, np.arange(h) + 0.5
    front = partner_from_rect[0] * x[None, :] + partner_from_rect[1] * y[:, None] + partner_from_rect[2] > 0
    return left, right, use & front


def _grey(bgr: np.ndarray) -> np.ndarray:
    return cv2.cvtColor(bgr, cv2.COLOR_BGR2GRAY)


def _warp(
    image: np.ndarray, target_from_source: np.ndarray, size: tuple[int, int], how: int, replicate: bool = True
) -> np.ndarray:
    """warpPerspective with pixel-corner coordinates."""
    half = np.array([[1.0, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
    matrix = np.linalg.inv(half) @ target_from_source @ half
    border = cv2.BORDER_REPLICATE if replicate else cv2.BORDER_CONSTANT
    return cv2.warpPerspective(image, matrix, size, flags=how, borderMode=border, borderValue=0)


def _to_reference(
    disparity: np.ndarray,
    pair: Rectification,
    shape: tuple[int, int],
    depth_range: DepthRange,
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
    half = np.array([[1.0, 0, 0.5], [0, 1, 0.5], [0, 0, 1]])
    matrix = np.linalg.inv(half) @ rect_from_reference @ half
    size = (shape[1], shape[0])

    def warp(values: np.ndarray, how: int, outside: float) -> np.ndarray:
        return cv2.warpPerspective(
            values, matrix, size, flags=how | cv2.WARP_INVERSE_MAP, borderMode=cv2.BORDER_CONSTANT, borderValue=outside
        )

    nearest = warp(disparity, cv2.INTER_NEAREST, np.nan)
    known = np.isfinite(disparity).astype(np.float32)
    weight = warp(known, cv2.INTER_LINEAR, 0.0)
    linear = warp(np.where(known > 0, disparity, np.float32(0)), cv2.INTER_LINEAR, 0.0)
    smooth = (weight > 0.999) & (np.abs(linear - nearest) < 1)
    return np.where(smooth, linear, nearest)
