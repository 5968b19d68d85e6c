"""Classification of an image by the learnt table: sky, water, platform and burnt-out areas.

The appearance of sky, water and the static scene in this survey is one table over colour, brightness and texture,
learnt from seeds of the survey itself (Achar et al. 2011: self-supervised segmentation of river scenes), so it needs no
labels and no weights, and the lookup of a pixel costs nothing.
"""

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.ndimage import gaussian_filter

from tiegraph.masks import EGO, OVEREXPOSED, SKY, USE, WATER
from tiegraph.masks.frames import dilated, eroded, full_size, grey, opened, read_small, small_shape
from tiegraph.masks.settings import MasksSettings
from tiegraph.masks.tuning import Tuning
from tiegraph.masks.waterline import below_waterline

Table = dict[int, np.ndarray]
"""Log probability (bins,) f4 of each bin for some classes."""


def bins(image: np.ndarray, tuning: Tuning) -> np.ndarray:
    """Bin (h, w) i4 of each pixel of an image (h, w, 3) u1 BGR."""
    count, textures = tuning.sky.bins, len(tuning.sky.texture_edges_grey) + 1
    levels = np.arange(256)
    # Grey levels of a and b a bin
    steps = np.clip((levels - 128) / 5.0 + count / 2, 0, count - 1).astype(np.int32) * textures
    of_light = (levels * count // 256 * count * count * textures).astype(np.int32)
    edges = np.array(tuning.sky.texture_edges_grey, np.float32)
    light, a, b = cv2.split(cv2.cvtColor(image, cv2.COLOR_BGR2Lab))
    fine = light.astype(np.float32)
    around = (tuning.window_px, tuning.window_px)
    mean = cv2.blur(fine, around)
    variance = cv2.blur(fine * fine, around) - mean * mean
    texture = sum(variance > edge for edge in edges * edges)
    return of_light[light] + steps[a] * count + steps[b] + texture


def bin_count(tuning: Tuning) -> int:
    """Bins of the whole table, over L, a, b and texture."""
    return tuning.sky.bins**3 * (len(tuning.sky.texture_edges_grey) + 1)


def learn_appearance(counts: dict[int, np.ndarray], tuning: Tuning, shared: dict[int, np.ndarray]) -> Table:
    """From counts (bins,) of seed pixels by class, of a camera and of all (``shared``); classes without seeds are left
    out."""
    table = {}
    for label in counts:
        own, every = _share(counts[label], tuning), _share(shared[label], tuning)
        if own is None:
            own = every
        elif every is not None:
            # Seeds of all cameras weigh as much as about one image of its own
            weight = counts[label].sum() / (counts[label].sum() + 50_000)
            own = weight * own + (1 - weight) * every
        if own is not None:
            table[label] = np.log((1 - tuning.sky.unseen) * own + tuning.sky.unseen / len(own)).astype(np.float32)
    return table


def log_ratio(table: Table, found: np.ndarray, label: int) -> np.ndarray:
    """Log of P(bin | label) / P(bin | scene) for bins of any shape; 0 if either was not learnt."""
    if label not in table or USE not in table:
        return np.zeros(found.shape, np.float32)
    return (table[label] - table[USE])[found]


def _share(count: np.ndarray, tuning: Tuning) -> np.ndarray | None:
    if count.sum() == 0:
        return None
    # Bins of L, a, b and texture
    smooth = gaussian_filter(count.reshape(*[tuning.sky.bins] * 3, -1).astype(np.float64), (0.8, 0.7, 0.7, 0.6))
    return smooth.ravel() / smooth.sum()


@dataclass(frozen=True)
class Classifier:
    """The common data of one camera's images; ``note`` describes them in words."""

    platform: np.ndarray | None  # (h, w) bool at reduced size, True = platform
    table: Table
    water: np.ndarray | None  # (r, c) f4 prior of water in its images, log ratio; None = no water seen
    sky: np.ndarray | None  # (r, c) f4 prior of sky in its images, log ratio; None = it looks up
    sky_rows: float  # share of the height below which no sky was seen in any image
    note: str
    no_sky: str = ""
    """Why the apparent sky is none; "" if nothing refutes it."""
    white_matches: bool = False
    """Whether overexposed areas of the survey tie: then they are used."""


def classify(image: np.ndarray, learnt: Classifier, settings: MasksSettings, tuning: Tuning) -> np.ndarray:
    """Classes (h, w) u1 of an image (h, w, 3) u1 BGR at ``look_px``, without the platform: see ``classes_of``."""
    shape, light, found = image.shape[:2], grey(image), bins(image, tuning)
    sky_ratio = cv2.blur(log_ratio(learnt.table, found, SKY), (tuning.window_px, tuning.window_px))
    sky_ratio = sky_ratio + pooled(sky_ratio, textureless_regions(light, tuning), tuning)
    if learnt.sky is not None:
        sky_ratio += cv2.resize(learnt.sky, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR)
    white = light >= settings.overexposed
    sky = _cleaned((sky_ratio > tuning.sky.credit) & sought(shape, learnt, tuning), tuning)
    sky = _with_white(_grown(sky, light, tuning), white, tuning)
    labels = np.full(shape, USE, np.uint8)
    if not learnt.white_matches:
        labels[_cleaned(white, tuning)] = OVEREXPOSED
    labels[sky] = SKY
    if learnt.water is not None:
        prior = cv2.resize(learnt.water, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR)
        ratio = log_ratio(learnt.table, found, WATER) + prior
        ratio = np.where(sky_ratio > tuning.sky.credit, np.minimum(ratio, -0.5), ratio)
        ego = None if learnt.platform is None else full_size(learnt.platform, shape)
        labels[below_waterline(ratio, ego, tuning)] = WATER
    return labels


def sought(shape: tuple[int, ...], learnt: Classifier, tuning: Tuning) -> np.ndarray:
    """The rows (h, 1) bool of an image of ``shape`` in which sky is searched."""
    return np.arange(shape[0])[:, None] < (learnt.sky_rows + tuning.sky.horizon) * shape[0]


def classes_of(
    path: Path, learnt: Classifier, settings: MasksSettings, shape: tuple[int, int], tuning: Tuning
) -> np.ndarray:
    """Classes (h, w) u1 of an image at ``shape``, the reduced size of its mask."""
    image = read_small(path, max(shape))
    small = small_shape(shape, tuning.look_px)
    labels = classify(cv2.resize(image, small[::-1], interpolation=cv2.INTER_AREA), learnt, settings, tuning)
    labels = cv2.resize(labels, (shape[1], shape[0]), interpolation=cv2.INTER_NEAREST)
    if max(shape) > tuning.look_px:
        labels = _snapped(labels, grey(image), tuning)
    if learnt.platform is not None:
        labels[full_size(learnt.platform, shape)] = EGO
    return labels


def _snapped(labels: np.ndarray, light: np.ndarray, tuning: Tuning) -> np.ndarray:
    """Classes with the edge of the sky refined by brightness: a guided filter (He et al. 2013), near the edge.

    Its lines are fitted at half the size (He and Sun 2015).
    """
    sky = (labels == SKY).astype(np.uint8)
    band = dilated(sky, tuning.band_px) & ~eroded(sky, tuning.band_px)
    rows = np.flatnonzero(band.any(axis=1))
    if not len(rows):
        return labels
    part = slice(max(0, rows[0] - tuning.band_px), rows[-1] + tuning.band_px)
    guide, size = light[part].astype(np.float32), (labels.shape[1], len(labels[part]))
    half = (max(1, size[0] // 2), max(1, size[1] // 2))
    small, share = (cv2.resize(x, half, interpolation=cv2.INTER_AREA) for x in (guide, sky[part].astype(np.float32)))
    # The line that gives the share of sky from the brightness round each pixel
    around = (tuning.band_px, tuning.band_px)
    mean, mean_share = cv2.blur(small, around), cv2.blur(share, around)
    spread = cv2.blur(small * small, around) - mean * mean
    # Brightness of sky and scene differ by more, or the edge hardly moves
    slope = (cv2.blur(small * share, around) - mean * mean_share) / (spread + 8.0**2)
    slope, shift = cv2.blur(slope, around), cv2.blur(mean_share - slope * mean, around)
    like = cv2.resize(slope, size) * guide + cv2.resize(shift, size) > 0.5
    told = band[part] & ((labels[part] == SKY) | (labels[part] == USE))
    found = labels.copy()
    found[part] = np.where(told, np.where(like, SKY, USE), labels[part])
    return found


def _grown(sky: np.ndarray, brightness: np.ndarray, tuning: Tuning) -> np.ndarray:
    """The sky up to its very edge, where texture separated it from the sky: neighbours of the sky's own brightness."""
    light, inside = brightness.astype(np.float32), sky.astype(np.float32)
    around = (tuning.band_px, tuning.band_px)
    mean = cv2.blur(light * inside, around) / np.maximum(cv2.blur(inside, around), 1e-6)
    return sky | (dilated(sky, 7) & (np.abs(light - mean) < tuning.faint_grey))


def _with_white(sky: np.ndarray, white: np.ndarray, tuning: Tuning) -> np.ndarray:
    """The sky with the sun and burnt-out clouds: white areas with sky round them."""
    if not white.any() or not sky.any():
        return sky
    count, labels = cv2.connectedComponents(white.astype(np.uint8), connectivity=4)
    square = np.ones((tuning.window_px, tuning.window_px), np.uint8)
    ring = cv2.dilate(labels.astype(np.float32), square).astype(np.int32)
    ring[white] = 0
    around = np.bincount(ring.ravel(), minlength=count)
    held = np.bincount(ring[sky], minlength=count)
    belongs = held > 0.5 * around
    belongs[0] = False
    return sky | belongs[labels]


def _cleaned(mask: np.ndarray, tuning: Tuning) -> np.ndarray:
    mask = opened(mask, tuning.fine_px).astype(np.uint8)
    for _ in range(2):  # small pieces go, then small holes
        _, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=4)
        small = stats[:, cv2.CC_STAT_AREA] < tuning.small * mask.size
        small[0] = False
        mask = 1 - np.where(small[labels], 0, mask).astype(np.uint8)
    return mask > 0


def textureless_regions(brightness: np.ndarray, tuning: Tuning) -> np.ndarray:
    """Regions (h, w) i4 of a grey image (h, w) u1 that no edge crosses, from 1; 0 = edges and small pieces."""
    fine = cv2.GaussianBlur(brightness.astype(np.float32), (0, 0), tuning.smooth_sigma_px)
    x, y = cv2.Sobel(fine, cv2.CV_32F, 1, 0, ksize=3), cv2.Sobel(fine, cv2.CV_32F, 0, 1, ksize=3)
    calm = (x * x + y * y < (8 * tuning.sky.edge_grey) ** 2).astype(np.uint8)  # 8: gain of the Sobel kernel
    _, labels, stats, _ = cv2.connectedComponentsWithStats(calm, connectivity=4)
    kept = stats[:, cv2.CC_STAT_AREA] >= tuning.small * calm.size
    kept[0] = False
    return np.where(kept, np.cumsum(kept), 0).astype(np.int32)[labels]


def pooled(ratio: np.ndarray, regions: np.ndarray, tuning: Tuning) -> np.ndarray:
    """The mean (h, w) of log ratios (h, w) over the region of each pixel; 0 outside of regions."""
    clipped = np.clip(ratio, -tuning.most_says, tuning.most_says).ravel()
    count = np.bincount(regions.ravel())
    mean = np.bincount(regions.ravel(), clipped) / np.maximum(count, 1)
    mean[0] = 0
    return mean[regions]
