"""Hierarchical semi-global matching of a rectified pair, tSGM (paper 004, section 5.2; kernels in the native module).

A pyramid level is matched over the full range where that is cheap; below it each pixel keeps the disparities its
neighbourhood had on the level above. The costs are census, on the last level blended with mutual information. Where
there is a GPU (``cuda``) the same steps run on it, with the same bits.
"""

import logging
import threading
from dataclasses import dataclass
from typing import TYPE_CHECKING, Any

import cv2
import numpy as np

from tiegraph.dense import cuda
from tiegraph.dense.settings import DenseSettings
from tiegraph.dense.sgbm import LEFT_RIGHT_PX, without_speckles
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
_MODES = {"census": 0, "blend": 1, "mutual": 2}
_CUDA = "cuda"  # the kernel's name

Array = Any  # of NumPy, or of the device


def available() -> bool:
    """Whether the native module is installed."""
    return _sgm is not None


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
        each = count if level == levels else min(count + _BLOCK, tuning.hole_disparities + 2 * _BLOCK)
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
    """Disparity (h, w) f4 px of each left pixel, NaN = none: the ``PairMatcher`` contract of ``dense.engine``.

    left (h, w) u1; right (h, w + disparities) u1, whose column ``disparities`` lies under the left's column 0: left
    (x, y) shows what right (x + disparities - d, y) shows, 0 <= d < disparities; use (h, w) bool: where the disparity
    matters. Raises EngineMissing where the native module was not built.
    """
    found = match(left, right, disparities, disparities, tuning.tsgm, use)
    return without_speckles(found)


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
    platform have no answer on the coarser level, and would be searched as holes, over ``hole_disparities``.
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
        """First disparities and blocks of each pixel."""
        first, blocks, _ = _sgm.ranges(coarse, width, height, rules)
        return first, blocks

    def row_blocks(self, blocks: Array) -> tuple[np.ndarray, np.ndarray]:
        """(h,) blocks of each row, and of its pixel that has most."""
        return blocks.sum(axis=1, dtype=np.int64), blocks.max(axis=1)

    def match_dense(
        self,
        left: Array,
        right: Array,
        span: tuple[int, int],
        options: _sgm.Options,
        mutual: Array | None,
        strips: cuda.Strips,
    ) -> Array:
        """One range for all pixels, (lowest, number); the rows that count."""

        def match(rows: slice) -> Array:
            return _sgm.match_dense(left[rows], right[rows], *span, options, _workspace(), mutual)[0]

        return cuda.joined([match(outer)[inner] for outer, inner in strips])

    def match_ragged(
        self,
        left: Array,
        right: Array,
        ranges: tuple[Array, Array],
        options: _sgm.Options,
        mutual: Array | None,
        strips: cuda.Strips,
    ) -> Array:
        """A range for each pixel, (first disparities, blocks of 16); the rows that count."""

        def match(rows: slice) -> Array:
            images, own = (left[rows], right[rows]), (ranges[0][rows], ranges[1][rows])
            return _sgm.match_ragged(*images, *own, options, _workspace(), mutual)[0]

        return cuda.joined([match(outer)[inner] for outer, inner in strips])


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
    found = None
    coarser = levels
    for level in (levels, 0) if tuning.everywhere else range(levels, -1, -1):
        rules = _sgm.RangeRules()
        rules.low, rules.count = -(aligned >> level), -(-disparities >> level)
        # A pixel is given the disparities of the coarser level within 3 pixels, and one more on both sides.
        rules.reach, rules.margin, rules.hole_limit = 3, 1, tuning.hole_disparities
        options = _options(tuning, level == 0 and levels > 0)
        pair = _Level(
            left=lefts[level],
            right=rights[level],
            rules=rules,
            options=options,
            kernels=kernels,
            overlap=tuning.strip_overlap_px,
        )
        if found is None:
            found = pair.full()
        else:
            above = (lefts[coarser], rights[coarser], found)
            blended = level == 0 and tuning.cost != "census"
            mutual = mutual_information(kernels.joint_greys(*above)) if blended else None
            found = pair.full(mutual) if tuning.everywhere else pair.within(found, mutual, uses[level])
        coarser = level
    assert found is not None
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
    """Halvings until the full range is cheap; at least one unless there are few disparities anyway. A match over the
    full range at full size has one of a quarter of it, which tells what grey values belong together."""
    if tuning.everywhere:
        return 2
    levels = 0 if disparities <= 16 else 1
    while disparities >> levels > tuning.full_disparities:
        levels += 1
    return levels


def _options(tuning: TsgmTuning, last: bool) -> _sgm.Options:
    options = _sgm.Options()
    options.radius_x, options.radius_y = tuning.radius_px
    options.small, options.large = tuning.small_jump, tuning.large_jump
    # P2 falls with the grey step between neighbours from 6 grey values on, to a quarter of itself.
    falls = [max(0.25, min(1.0, 6 / (4 * k + 2))) for k in range(16)]
    options.large_by_step = [max(tuning.small_jump, round(tuning.large_jump * share)) for share in falls]
    options.parabola = False  # equiangular lines below the pixel
    options.left_right = LEFT_RIGHT_PX
    options.mode = _MODES[tuning.cost] if last else 0
    options.kernel = "" if tuning.kernel == _CUDA else tuning.kernel
    return options


@dataclass(frozen=True, eq=False)
class _Level:
    """One level of the pyramid: images, the disparities there, options, rows that strips share."""

    left: Array
    right: Array
    rules: _sgm.RangeRules
    options: _sgm.Options
    kernels: _Native | cuda.Matcher
    overlap: int

    def full(self, mutual: np.ndarray | None = None) -> Array:
        """Every disparity at every pixel."""
        height, width = self.left.shape
        span = self.rules.low, self.rules.count
        strips = _strips(np.full(height, width * span[1]), self.overlap)  # bytes
        return self.kernels.match_dense(self.left, self.right, span, self.options, mutual, strips)

    def within(self, coarse: Array, mutual: np.ndarray | None, use: Array | None) -> Array:
        """The disparities that the coarser level leaves."""
        height, width = self.left.shape
        first, blocks = self.kernels.ranges(coarse, width, height, self.rules)
        if use is not None:  # one block in the middle of the range
            first = np.where(use, first, first + _BLOCK // 2 * (blocks.astype(np.int16) - 1))
            blocks = np.where(use, blocks, np.uint8(1))
        sums, _ = self.kernels.row_blocks(blocks)
        _log.debug("%.1f disparities a pixel at %s", _BLOCK * sums.sum() / self.left.size, self.left.shape)
        strips = _strips(_CELL_BYTES * _BLOCK * sums, self.overlap)
        return self.kernels.match_ragged(self.left, self.right, (first, blocks), self.options, mutual, strips)


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


# --- matching cost of mutual information -----------------------------------------------------------------------------


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
    flat = share.astype(np.float32) if share.ndim == 2 else share.astype(np.float32)[None, :]
    smooth = cv2.GaussianBlur(flat, window if share.ndim == 2 else (_SMOOTHING_PX, 1), 0)
    result = cv2.GaussianBlur(-np.log(np.maximum(smooth, 1e-9)), window, 0)
    return result if share.ndim == 2 else result[0]
