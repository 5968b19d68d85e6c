"""Paper 001: Meguro, Tetsu, Kubo, Shimizu, Nakagawa 2025, Pose correction for SfM-based river mapping using the fixed
baseline and optical axis of an omnidirectional camera as constraints.

Masks (section a) in two stages: what is alike in the first and the last image of a camera by structural similarity,
then sky and overexposure of each image. Network (section b): neighbouring frames of a camera; between cameras a range
of frames around one offset, the one with the most matches (``meguro2024.constant_offsets``); and by the brightness of
the upward camera's pixels the frames below bridges, for which separate lists are made. Mapping: COLMAP, by masks and
lists, each section by itself; positions of GNSS bring them together afterwards. The constants that the paper does not
print are ``masks.tuning.PapersTuning``.
"""

from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tiegraph.masks.frames import (
    block_share,
    from_blocks,
    full_size,
    grey,
    image_size,
    masked_neighbours,
    read_small,
    two_frames,
    without_small,
)
from tiegraph.masks.settings import MasksSettings
from tiegraph.masks.sources import MaskSource, check_shape, each, nothing
from tiegraph.masks.tuning import PapersTuning
from tiegraph.masks.tuning import Tuning as MasksTuning
from tiegraph.network.sections import UpLight, otsu
from tiegraph.papers import colmap_alone
from tiegraph.scene.scene import Scene

_SOBEL_GAIN = 8.0  # response of the 3x3 Sobel kernels to a ramp of one grey level a pixel

# Wang et al. 2004, section III, define it so: window of 11 pixels with sigma 1.5, K1 = 0.01, K2 = 0.03, grey levels
# L = 255.
_WINDOW_PX, _SIGMA_PX = 11, 1.5
_C1, _C2 = (0.01 * 255) ** 2, (0.03 * 255) ** 2

_MANY_NEIGHBOURS = 3  # "three or more adjacent blocks": paper 001 prints it


def ssim(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    """Structural similarity (h, w) f4 in -1..1 of two grey images (h, w) u1. Wang et al. 2004, equation 13."""
    x, y = a.astype(np.float32), b.astype(np.float32)

    def mean(image: np.ndarray) -> np.ndarray:
        return cv2.GaussianBlur(image, (_WINDOW_PX, _WINDOW_PX), _SIGMA_PX, borderType=cv2.BORDER_REFLECT)

    mu_x, mu_y = mean(x), mean(y)
    var_x, var_y, cov = mean(x * x) - mu_x**2, mean(y * y) - mu_y**2, mean(x * y) - mu_x * mu_y
    luminance = (2 * mu_x * mu_y + _C1) / (mu_x**2 + mu_y**2 + _C1)
    return luminance * (2 * cov + _C2) / (var_x + var_y + _C2)


def initial_mask(a: np.ndarray, b: np.ndarray, similarity: float, tuning: PapersTuning) -> np.ndarray:
    """Mask (h, w) bool, True = use, of two grey images (h, w) u1 of one camera. Paper 001, section a, first stage."""
    # "Pixels with high similarity are considered outside the region of interest ... and are masked".
    masked = ssim(a, b) > similarity
    # "Blocks with a ratio of masked pixels below a certain threshold are excluded".
    blocks = block_share(masked, tuning.block_px) >= tuning.min_block
    # "a labeling process removes small isolated regions, such as noise, while retaining larger, contiguous regions".
    blocks = without_small(blocks, tuning.min_area * blocks.size)
    # "If three or more adjacent blocks are marked as "1" (i.e., masked), the central block is also set to "0"": read
    # as COLMAP's 0 (ignore), since "also" says that the block joins its neighbours. Unmasking it instead would hollow
    # out every region the step before retained. Adjacent = sharing a side: counted with corners, straight edges grow.
    blocks = blocks | (masked_neighbours(blocks) >= _MANY_NEIGHBOURS)
    return ~from_blocks(blocks, tuning.block_px, masked.shape)


def prepare_ssim(images: Sequence[Path], settings: MasksSettings, tuning: MasksTuning) -> np.ndarray | None:
    """The initial mask of a camera, (h, w) bool at reduced size; None if there are no two frames to compare."""
    frames = two_frames(images, tuning)
    return None if frames is None else initial_mask(*frames, settings.similarity, tuning.papers)


def edge_sky(brightness: np.ndarray, min_step: float) -> np.ndarray:
    """Sky (h, w) bool of a grey image (h, w) u1: in each column from the top down to the first strong Sobel edge.

    A column without such an edge is sky to the bottom, as in an upward camera under the open sky.
    """
    x = cv2.Sobel(brightness, cv2.CV_32F, 1, 0, ksize=3)
    y = cv2.Sobel(brightness, cv2.CV_32F, 0, 1, ksize=3)
    edge = x * x + y * y >= (_SOBEL_GAIN * min_step) ** 2
    return ~np.logical_or.accumulate(edge, axis=0)


def blue_sky(image: np.ndarray, tuning: PapersTuning) -> np.ndarray:
    """Pixels (h, w) bool of an image (h, w, 3) u1 BGR in the range of sky blue; none in a grey image."""
    return cv2.inRange(cv2.cvtColor(image, cv2.COLOR_BGR2HSV), tuning.blue_low, tuning.blue_high) > 0


def final_mask(
    image: np.ndarray, initial: np.ndarray | None, settings: MasksSettings, tuning: PapersTuning
) -> np.ndarray:
    """Mask (h, w) bool, True = use, of an image (h, w, 3) u1 BGR. Paper 001, section a, final stage, in its order.

    ``initial``: the camera's mask (h, w) bool of the first stage, None = nothing masked yet.
    """
    brightness = grey(image)
    # "Based on the detected edge positions, the top of the image is assumed to be the sky and is masked".
    edges = edge_sky(brightness, settings.sky_edge)
    # "Pixels within the typical range of sky colors ... are extracted as a blue sky mask".
    blue = blue_sky(image, tuning)
    # "the two types of sky masks ... are combined and merged with the initial mask": both as unions. The intersection
    # of the two finds half of CamVid's grey skies only.
    masked = edges | blue
    if initial is not None:
        masked = masked | ~initial
    # "overexposed regions, are identified through grayscale conversion and thresholding. The regions are excluded".
    masked = masked | (brightness >= settings.overexposed)
    # "the image is divided into blocks once more, and a pixel ratio check is performed to smooth the mask".
    blocks = block_share(masked, tuning.block_px) >= tuning.min_block
    return ~from_blocks(blocks, tuning.block_px, masked.shape)


def mask_with_sky(
    image: Path, prepared: np.ndarray | None, settings: MasksSettings, tuning: MasksTuning, name: str
) -> np.ndarray:
    """The mask of an image, (H, W) bool at its size, from that of its camera (None = nothing masked yet)."""
    size = image_size(image)
    check_shape(image, size, prepared, tuning)
    small = read_small(image, tuning.work_px)
    return full_size(final_mask(small, prepared, settings, tuning.papers), size)


MASKS = MaskSource(each(prepare_ssim), mask_with_sky)
SKY = MaskSource(each(nothing), mask_with_sky)
"""The second stage alone."""


def light(scene: Scene, images: Path, apply: Callable[..., list[Any]]) -> UpLight:
    """What the up cameras say of bridge or open sky: the share of bright pixels of each of their images below the
    folder ``images``, and nothing else. ``apply(function, items)`` maps.

    "For images captured by the upward-facing camera, the brightness distribution across pixels is analyzed to identify
    bridge regions." Brightness is the third of the section's "hue, saturation, and brightness": in grey levels a blue
    sky is as dark as the deck of a bridge that an automatic exposure has lightened, and it is the pixels that are
    divided, not the means of images: exposure moves these by as much as a bridge does.
    """
    up = np.flatnonzero(scene.of_role("up"))
    counts = apply(brightness_counts, [images / scene.names[k] for k in up])
    share = np.full(len(scene), np.nan)
    if len(up):
        share[up] = bright_share(np.array(counts))
    return UpLight(np.full(len(scene), np.nan), share, measure="bright share of the pixels")


def brightness_counts(image: Path) -> np.ndarray:
    """(256,) i8 pixels of each brightness, the V of HSV, of an image at reduced size."""
    # Longer side of images whose brightness is counted
    return np.bincount(read_small(image, 640).max(axis=2).ravel(), minlength=256)


def bright_share(counts: np.ndarray) -> np.ndarray:
    """(N,) share of the pixels of each image, counted by brightness (N, 256), that are bright: on the upper side of the
    threshold that divides the pixels of all images best (Otsu 1979)."""
    share = counts / counts.sum(axis=1, keepdims=True)
    levels = np.arange(counts.shape[1])
    # That stand for those of all upward images
    pixels = np.repeat(levels, np.rint(2**16 * share.mean(axis=0)).astype(int))
    return share[:, levels > otsu(pixels).threshold].sum(axis=1)


# The range is our reading, as in ``meguro2024``. Sections of a list of their own are models of their own, which come
# together by "camera positions estimated by SfM and GNSS position data": below a bridge, which is passed in less than a
# minute, by the straight line between the last fix before it and the first behind. What the rig says goes in where
# positions do not tell it: its fixed baselines the scale, if they are calibrated, its optical axes the roll of a
# straight track.
PRESET: dict[str, dict[str, Any]] = {
    "scan": {"max_gap_s": 60.0},
    "masks": {"source": "meguro2025"},
    "candidates": {
        "sources": ("sequence", "offsets"),
        "sequence_frames": 5,
        "offsets": "constant",
        "offset_range": 5,
        "axes_deg": 90.0,
    },
    "network": {"sections": "meguro2025"},
    **colmap_alone(upright=True),
}
