"""Hierarchical semi-global matching of a rectified pair, tSGM (paper 004, section 5.2; kernels in the native module).

A pyramid level is matched over the full range where that is cheap; below it each pixel keeps the disparities its
neighbourhood had on the level above. The costs are census, on the last level blended with mutual information. Where
there is a GPU (``cuda``) the same steps run on it, with the same bits. OpenCV's matcher (Hirschmueller 2008, block
matching variant) stands in where the native module was not built.
"""

from __future__ import annotations

import logging
import threading
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from tiegraph.dense import cuda
from tiegraph.dense.settings import DenseSettings
from tiegraph.dense.tuning import TsgmTuning, Tuning
from tiegraph.errors import EngineMissing

if TYPE_CHECKING:
    from tiegraph.dense import _sgm
else:
    try:
        from tiegraph.dense import _sgm
    except ImportError:  # installed without a C++ compiler
        _sgm = None

_memory = threading.local()
_log = logging.getLogger(__name__)

_VOLUME_BYTES = 256_000_000  # of the cost volumes held at once; a level that needs more is matched in strips
_CELL_BYTES = 2  # a cost and half a sum for each pixel and disparity; over the full range costs are made anew
_BLOCK = 16  # disparities that the kernels take at once
_CENSUS, _BLEND = 0, 1  # modes of the kernels: census alone, and the mean of it and mutual information
_CUDA = "cuda"  # the kernel's name
_SGBM_MODES = {3: cv2.STEREO_SGBM_MODE_SGBM_3WAY, 5: cv2.STEREO_SGBM_MODE_SGBM, 8: cv2.STEREO_SGBM_MODE_HH}
_SUBPIXEL = 16  # OpenCV's fixed point: steps of a pixel in 16 bits; the disparities of one image may span 2000 pixels
_LEFT_RIGHT_PX = 1  # disagreement between both directions, at most: paper 004, section 5.2.2
MAX_CELLS = 800e6
"""Of OpenCV's largest cost volume, pixels times disparities: a larger pair is matched at a coarser resolution."""

Array = Any  # of NumPy, or of the device


def kernels() -> list[str]:
    """The native kernels that this machine runs, the fastest first; [] without the native module."""
    return [] if _sgm is None else list(_sgm.kernels())


def kernel_in_use(tuning: TsgmTuning) -> str:
    """The kernel that pairs are matched with in this process, a GPU with its name; touches the GPU. All kernels give
    the same bits."""
    if tuning.kernel in ("", _CUDA) and (name := cuda.device_name()) is not None:
        return f"{_CUDA} ({name})"
    return tuning.kernel or kernels()[0]


def volume_bytes(height: int, width: int, disparities: int, tuning: TsgmTuning) -> int:
    """Most bytes of cost volumes that matching a pair of images (height, width) holds at once, known before it starts.

    Levels that would need more than 256 MB are matched in strips; a strip has at least three times its overlap.
    """
    levels = _levels(disparities, tuning)
    most = 0
    for level in range(levels + 1):
        h, w = -(-height >> level), -(-width >> level)
        count = -(-disparities >> level)
        each = count if level == levels else min(count + _BLOCK, tuning.full_disparities + 2 * _BLOCK)
        each = -(-each // _BLOCK) * _BLOCK
        rows = min(h, 3 * tuning.strip_overlap_px)
        cell = 1 if level == levels else _CELL_BYTES
        most = max(most, min(h * w * each * cell, max(_VOLUME_BYTES, rows * w * each * cell)))
    return most


def match_tsgm(
    left: np.ndarray,
    right: np.ndarray,
    disparities: int,
    settings: DenseSettings,
    tuning: Tuning,
    use: np.ndarray | None = None,
) -> np.ndarray:
    """Disparity (h, w) f4 px of each left pixel, NaN = none (``dense.engine.PairMatcher``).

    Raises EngineMissing where the native module was not built.
    """
    return without_speckles(match(left, right, disparities, disparities, tuning.tsgm, use))


def match(
    left: np.ndarray,
    right: np.ndarray,
    shift: int,
    disparities: int,
    tuning: TsgmTuning,
    use: np.ndarray | None = None,
) -> np.ndarray:
    """Disparity (h, w) f4, NaN = none, checked left to right: left (x, y) shows what right (x + shift - d, y) shows.

    left (h, w) u1, right (h, any) u1, 0 <= d < disparities. Pixels not in use (h, w) bool get the least work: sky and
    platform have no answer on the coarser level, and would be searched as holes, over ``full_disparities``.
    """
    if _sgm is None:
        raise EngineMissing(
            "the native matcher is not installed: install a C++ compiler and tiegraph again, or use --dense.engine sgbm"
        )
    if tuning.kernel in ("", _CUDA) and (device := cuda.matcher()) is not None:
        try:
            return _match(left, right, shift, disparities, tuning, use, device)
        except MemoryError:
            device.release()
            _log.debug("%s and %d disparities do not fit the GPU's memory", left.shape, disparities)
    elif tuning.kernel == _CUDA:
        raise EngineMissing(
            "no GPU that CuPy works with: pip install 'tiegraph[cuda12]' (or cuda13), or leave the kernel of "
            "[tuning.dense.tsgm] empty"
        )
    return _match(left, right, shift, disparities, tuning, use, _Native())


class _Native:
    """The native module's functions on arrays of NumPy: what ``cuda.Matcher`` has for those of the device."""

    upload = download = staticmethod(np.ascontiguousarray)

    def __init__(self) -> None:
        self.halve, self.joint_greys = _sgm.halve, _sgm.joint_greys

    def ranges(self, coarse: Array, width: int, height: int, rules: _sgm.RangeRules) -> tuple[Array, Array]:
        first, blocks, _ = _sgm.ranges(coarse, width, height, rules)
        return first, blocks

    def row_blocks(self, blocks: Array) -> tuple[np.ndarray, np.ndarray]:
        return blocks.sum(axis=1, dtype=np.int64), blocks.max(axis=1)

    def match_dense(
        self, left: Array, right: Array, span: tuple[int, int], options: Any, mutual: Array | None, strips: cuda.Strips
    ) -> Array:
        parts = [
            _sgm.match_dense(left[rows], right[rows], *span, options, _workspace(), mutual)[0][inner]
            for rows, inner in strips
        ]
        return cuda.joined(parts)

    def match_ragged(
        self,
        left: Array,
        right: Array,
        ranges: tuple[Array, Array],
        options: Any,
        mutual: Array | None,
        strips: cuda.Strips,
    ) -> Array:
        (first, blocks), parts = ranges, []
        for rows, inner in strips:
            own = left[rows], right[rows], first[rows], blocks[rows]
            parts.append(_sgm.match_ragged(*own, options, _workspace(), mutual)[0][inner])
        return cuda.joined(parts)


def _match(
    left: np.ndarray,
    right: np.ndarray,
    shift: int,
    disparities: int,
    tuning: TsgmTuning,
    use: np.ndarray | None,
    kernels: _Native | cuda.Matcher,
) -> np.ndarray:
    levels = _levels(disparities, tuning)
    aligned = -(-shift >> levels) << levels  # so that every level's shift is whole
    if aligned > shift:
        right = cv2.copyMakeBorder(right, 0, 0, aligned - shift, 0, cv2.BORDER_REPLICATE)
    lefts, rights = [kernels.upload(left)], [kernels.upload(right)]
    uses = [None if use is None else kernels.upload(use)]
    for _ in range(levels):
        lefts.append(kernels.halve(lefts[-1]))
        rights.append(kernels.halve(rights[-1]))
        uses.append(_halved(uses[-1]))
    # The level that is matched over its full range
    low, count = -(aligned >> levels), -(-disparities >> levels)
    height, width = lefts[-1].shape
    strips = _strips(np.full(height, width * count), tuning.strip_overlap_px)  # a byte for each disparity
    found = kernels.match_dense(lefts[-1], rights[-1], (low, count), _options(tuning, _CENSUS), None, strips)
    for level in range(levels - 1, -1, -1):
        rules = _sgm.RangeRules()
        rules.low, rules.count = -(aligned >> level), -(-disparities >> level)
        # A pixel is given the disparities of the coarser level within 3 pixels, and one more on both sides.
        rules.reach, rules.margin = 3, 1
        rules.hole_limit = tuning.full_disparities - 2 * rules.margin
        height, width = lefts[level].shape
        first, blocks = kernels.ranges(found, width, height, rules)
        if (used := uses[level]) is not None:  # one block in the middle of the range
            first = np.where(used, first, first + _BLOCK // 2 * (blocks.astype(np.int16) - 1))
            blocks = np.where(used, blocks, np.uint8(1))
        sums, _ = kernels.row_blocks(blocks)
        _log.debug("%.1f disparities a pixel at %s", _BLOCK * sums.sum() / blocks.size, blocks.shape)
        strips = _strips(_CELL_BYTES * _BLOCK * sums, tuning.strip_overlap_px)
        mutual, options = None, _options(tuning, _CENSUS if level else _BLEND)
        if level == 0:
            mutual = mutual_information(kernels.joint_greys(lefts[1], rights[1], found))
        found = kernels.match_ragged(lefts[level], rights[level], (first, blocks), options, mutual, strips)
    found = found + np.float32(aligned)
    inside = (found > -0.5) & (found < disparities - 0.5)  # whole blocks reach a little over the range
    return kernels.download(np.where(inside, found, np.float32(np.nan)))


def _halved(use: Array | None) -> Array | None:
    """(ceil(h / 2), ceil(w / 2)) bool: any of the 2 x 2 pixels is in use."""
    if use is None:
        return None
    even = np.pad(use, [(0, n % 2) for n in use.shape])
    return even[::2, ::2] | even[1::2, ::2] | even[::2, 1::2] | even[1::2, 1::2]


def _workspace() -> _sgm.Workspace:
    """This thread's memory for cost volumes: fetching it anew for each pair would take a tenth of the time."""
    if not hasattr(_memory, "workspace"):
        _memory.workspace = _sgm.Workspace()
    return _memory.workspace


def _levels(disparities: int, tuning: TsgmTuning) -> int:
    """Halvings until the full range is cheap; at least one unless there are few disparities anyway."""
    levels = 0 if disparities <= 16 else 1
    while disparities >> levels > tuning.full_disparities:
        levels += 1
    return levels


def _options(tuning: TsgmTuning, mode: int) -> _sgm.Options:
    options = _sgm.Options()
    options.radius_x, options.radius_y = tuning.radius_px
    options.small, options.large = tuning.small_jump, tuning.large_jump
    # P2 falls with the grey step between neighbours from 6 grey values on, to a quarter of itself.
    falls = [max(0.25, min(1.0, 6 / (4 * k + 2))) for k in range(16)]
    options.large_by_step = [max(tuning.small_jump, round(tuning.large_jump * share)) for share in falls]
    options.parabola = False  # equiangular lines below the pixel
    options.left_right, options.mode = _LEFT_RIGHT_PX, mode
    options.kernel = "" if tuning.kernel == _CUDA else tuning.kernel
    return options


def _strips(volume: np.ndarray, overlap: int) -> list[tuple[slice, slice]]:
    """Rows matched together, and which of the found ones count, so that the volumes, ``volume`` (h,) bytes in each row,
    stay within _VOLUME_BYTES; they share ``overlap`` rows, and a strip is never less than that."""
    height, limit = len(volume), _VOLUME_BYTES
    before = np.concatenate([[0], np.cumsum(volume)])
    if before[-1] <= limit:
        return [(slice(0, height), slice(0, height))]
    strips, top = [], 0
    while top < height:
        low = max(0, top - overlap)
        high = int(np.searchsorted(before, before[low] + limit, "right")) - 1
        high = min(height, max(high, top + 2 * overlap))
        bottom = height if high == height else high - overlap
        strips.append((slice(low, high), slice(top - low, bottom - low)))
        top = bottom
    return strips


_SMOOTHING_PX = 7  # window of the Gaussian that stands for the Parzen estimate, as in Hirschmueller 2008
_WORST = 62  # the largest cost, that of two census windows of 9 x 7 which differ everywhere


def mutual_information(joint: np.ndarray) -> np.ndarray:
    """Cost (256, 256) u1 of a left and a right grey value, from how often each two lie upon each other (256, 256). 0 =
    the most telling combination, _WORST = the least.
    """
    count = joint.astype(np.float32)
    share = count / max(1, joint.sum())
    entropy = _information(share)
    gain = entropy - _information(share.sum(axis=1))[:, None] - _information(share.sum(axis=0))[None, :]
    # Pairs of grey values at either end do not set the scale
    low, high = np.percentile(gain[count > 0], (1, 99)) if count.any() else (0.0, 1.0)
    scaled = (gain - low) / max(high - low, 1e-6) * (_WORST / 2)  # the span of the others' costs
    return np.clip(np.rint(scaled), 0, _WORST).astype(np.uint8)


def _information(share: np.ndarray) -> np.ndarray:
    """-log of smoothed probabilities, smoothed (Hirschmueller 2008, equations 5 and 6)."""
    window = (_SMOOTHING_PX, _SMOOTHING_PX if share.ndim == 2 else 1)
    smooth = cv2.GaussianBlur(np.atleast_2d(share.astype(np.float32)), window, 0)
    return cv2.GaussianBlur(-np.log(np.maximum(smooth, 1e-9)), window, 0).reshape(share.shape)


def match_sgbm(
    left: np.ndarray,
    right: np.ndarray,
    disparities: int,
    settings: DenseSettings,
    tuning: Tuning,
    use: np.ndarray | None = None,
) -> np.ndarray:
    """As ``match_tsgm``, by OpenCV; all pixels are matched, in ``use`` or not."""
    count = -(-disparities // 16) * 16
    pad = count - disparities
    wide_right = cv2.copyMakeBorder(right, 0, 0, pad, 0, cv2.BORDER_REPLICATE)
    wide_left = cv2.copyMakeBorder(left, 0, 0, count, 0, cv2.BORDER_REPLICATE)
    forward = _run(wide_left, wide_right, count, settings)[:, count:]
    # The other way round: mirrored, the right image is the left one. It needs the left image's continuation.
    mirror_left = np.ascontiguousarray(cv2.copyMakeBorder(wide_right, 0, 0, 0, count, cv2.BORDER_REPLICATE)[:, ::-1])
    mirror_right = np.ascontiguousarray(cv2.copyMakeBorder(wide_left, 0, 0, 0, count, cv2.BORDER_REPLICATE)[:, ::-1])
    backward = _run(mirror_left, mirror_right, count, settings)[:, count:][:, ::-1]
    return without_speckles(_left_right(forward, backward, count))


def _run(left: np.ndarray, right: np.ndarray, count: int, settings: DenseSettings) -> np.ndarray:
    matcher = cv2.StereoSGBM_create(  # type: ignore[attr-defined]
        minDisparity=0,
        numDisparities=count,
        # OpenCV's rule gives 72 and 288 for blocks of 3 x 3, the most exact ones on the Middlebury pairs; larger ones
        # reach further over weak texture.
        blockSize=3,
        P1=120,
        P2=480,
        disp12MaxDiff=-1,
        preFilterCap=63,
        uniquenessRatio=5,
        speckleWindowSize=0,
        mode=_SGBM_MODES[settings.paths],
    )
    fixed = matcher.compute(left, right)
    return np.where(fixed < 0, np.float32(np.nan), fixed.astype(np.float32) / _SUBPIXEL)


def _left_right(forward: np.ndarray, backward: np.ndarray, count: int) -> np.ndarray:
    """Forward disparities (h, w) whose right pixel leads back to nearly the left one; backward is (h, w + count)."""
    known = np.isfinite(forward)
    column = np.arange(forward.shape[1]) + count - np.rint(np.where(known, forward, 0)).astype(np.int64)
    back = np.take_along_axis(backward, np.clip(column, 0, backward.shape[1] - 1), axis=1)
    agrees = np.abs(back - forward) <= _LEFT_RIGHT_PX  # NaN compares false
    return np.where(known & agrees, forward, np.float32(np.nan))


def without_speckles(disparity: np.ndarray) -> np.ndarray:
    """Disparity (h, w) f4 > -16, NaN = none, without patches of fewer than 100 pixels enclosed by jumps above one
    (paper 004, section 5.2.2)."""
    # 16: the sub-pixel part of a disparity of 0 may be negative
    fixed = np.where(np.isfinite(disparity), (disparity + 16) * _SUBPIXEL, 0).astype(np.int16)
    cv2.filterSpeckles(fixed, 0, 100, _SUBPIXEL)
    return np.where(fixed > 0, disparity, np.float32(np.nan))
