"""Masks learnt from the survey itself: platform, sky, water and overexposure, without weights and without labels."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from tiegraph.masks import appearance
from tiegraph.masks.appearance import Appearance
from tiegraph.masks.classes import EGO, OVEREXPOSED, SKY, USE, WATER
from tiegraph.masks.ego import Ego, different_frames, learn_ego
from tiegraph.masks.evidence import Evidence, choose_pairs, pair_evidence
from tiegraph.masks.frames import grey, read_small
from tiegraph.masks.settings import MasksSettings
from tiegraph.masks.skyline import border_sky, calm_sky
from tiegraph.masks.water import below_waterline, never_matching, water_priors

LOOK_PX = 320
"""Longer side at which appearance is looked up."""
_MOST_PAIRS = 36  # of neighbouring frames, from which it is learnt what matches
_SEED_IMAGES = 40  # from which appearance is learnt
_STATIC_PX = 5  # around a matched feature all is static scene
_SKY_CREDIT = 0.5  # log ratio from which a place is sky
_SKY_AROUND = 0.5  # share of its surroundings that must be sky for a burnt-out area to be sky
_MATCHED_SKY = 0.25  # matched features on it, as a share of those on an equal area of the image
_SKY_MARGIN = 0.03  # of the height, below the lowest sky seen
_SAME_GREY = 14.0  # at its edge the sky goes on as long as the brightness does
_SMALL = 0.002  # of the image: smaller pieces of sky or holes in it are not believed

Map = Callable[[Callable, Sequence], Iterable]


@dataclass(frozen=True)
class Learnt:
    """What one camera's images share; ``note`` says it in words."""

    ego: np.ndarray | None  # (h, w) bool at reduced size, True = platform
    appearance: Appearance
    water: np.ndarray | None  # (r, c) f4 prior of water in its images, log ratio; None = no water seen
    sky_rows: float  # share of the height below which no sky was seen in any image
    note: str


def learn(
    cameras: Mapping[int, Sequence[Path]], settings: MasksSettings, upward: Iterable[int] = (), apply: Map = map
) -> dict[int, Learnt]:
    """What is learnt from the images (paths, in order) of all cameras; ``apply`` maps a function over items.

    ``upward``: cameras that look up and have no water in view.
    """
    keys, upward = list(cameras), set(upward)
    different = dict(zip(keys, apply(different_frames, [cameras[k] for k in keys])))
    platforms = dict(zip(keys, apply(_learn_ego, [(different[k], len(cameras[k])) for k in keys])))
    pairs = choose_pairs([different[k] for k in keys], _MOST_PAIRS)
    found = iter(list(apply(_pair, [pair for own in pairs for pair in own])))
    seen = {k: [e for _ in own for e in next(found)] for k, own in zip(keys, pairs)}
    zones = {k: never_matching([] if k in upward else seen[k], platforms[k].mask) for k in keys}
    level = {k: zones[k] for k in keys if k not in upward}
    water = {} if settings.water == "off" else water_priors(level, settings.water == "on")
    jobs = [
        _SeedJob(k, image, evidence, zones[k].mask if k in water else None, platforms[k].mask, k in upward)
        for k in keys
        for image, evidence in _seed_images(cameras[k], seen[k], max(2, _SEED_IMAGES // len(keys)))
    ]
    seeds = list(apply(_seeds, jobs))
    known = _appearances(jobs, [counts for counts, _ in seeds], upward)
    lowest = max((low for job, (_, low) in zip(jobs, seeds) if not job.upward), default=0.0)
    rows = {k: 1.0 if k in upward else lowest for k in keys}
    first = {k: Learnt(platforms[k].mask, known[k], water.get(k), rows[k], "") for k in keys}
    # Once more, with what the first try calls water, sky and scene as seeds: they cover the images, the first did not.
    refined = _appearances(jobs, list(apply(_reseed, [(job, first[job.camera], settings) for job in jobs])), upward)
    return {k: replace(first[k], appearance=refined[k], note=_note(platforms[k], k in water)) for k in keys}


def _learn_ego(job: tuple[Sequence[Path], int]) -> Ego:
    return learn_ego(*job)


def _pair(job: tuple[Path, Path]) -> tuple[Evidence, ...]:
    return pair_evidence(*job)


def _note(ego: Ego, water: bool) -> str:
    return ego.note + (", water" if water else ", no water seen")


@dataclass(frozen=True)
class _SeedJob:
    camera: int
    image: Path
    evidence: Evidence | None
    zone: np.ndarray | None  # where nothing ever matches: water
    ego: np.ndarray | None
    upward: bool


def _seed_images(
    images: Sequence[Path], seen: Sequence[Evidence], count: int
) -> list[tuple[Path, Evidence | None]]:  # with evidence first, then others spread over the sequence
    by_image: dict[Path, Evidence | None] = {e.image: e for e in seen}
    spread = [images[k] for k in np.unique(np.linspace(0, len(images) - 1, min(count, len(images))).astype(int))]
    return [(image, by_image.get(image)) for image in dict.fromkeys([*by_image, *spread])]


Counts = dict[int, np.ndarray]


def _appearances(jobs: Sequence[_SeedJob], counts: Sequence[Counts], upward: set[int]) -> dict[int, Appearance]:
    """The appearance for each camera: one for all, and one for those that look up, whose sky is another one."""

    def of(chosen: Callable[[_SeedJob], bool]) -> Appearance:
        own = [c for job, c in zip(jobs, counts) if chosen(job)]
        return appearance.learn({label: np.sum([c[label] for c in own], axis=0) for label in (USE, SKY, WATER)})

    level = of(lambda job: not job.upward) if any(not job.upward for job in jobs) else None
    above = of(lambda job: job.upward) if upward else None
    return {job.camera: above if job.upward else level for job in jobs}  # type: ignore[misc]


def _seeds(job: _SeedJob) -> tuple[Counts, float]:
    """Counts (BINS,) by class of the seed pixels of one image, and how far down its sky goes (share of the height)."""
    image = read_small(job.image, LOOK_PX)
    shape = image.shape[:2]
    static = _matched(job.evidence, shape)
    water = np.zeros(shape, bool) if job.zone is None else _scaled(job.zone, shape)
    sky = calm_sky(image, static) if job.upward else border_sky(image)
    if sky is None or not job.upward and not _unmatched(sky, job.evidence):
        sky = np.zeros(shape, bool)
    else:  # what is well off the sky is scene or water
        sky &= ~static
        static = static | ~_dilated(sky, 9)
    free = np.ones(shape, bool) if job.ego is None else ~_scaled(job.ego, shape)
    masks = {USE: static & free & ~water, WATER: water & free, SKY: sky & free & ~water}
    rows = np.flatnonzero(masks[SKY].mean(axis=1) > 0.02)
    return _counted(appearance.bins(image), masks), float(rows[-1] + 1) / shape[0] if len(rows) else 0.0


def _unmatched(sky: np.ndarray, evidence: Evidence | None) -> bool:
    """Whether hardly a feature in what looks like sky matches: a bright wall has as many as other walls."""
    if evidence is None:
        return False
    place = (evidence.xy[evidence.matched] * np.array(sky.shape[::-1], np.float32)).astype(int)
    inner = cv2.erode(sky.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    inside = inner[place[:, 1].clip(0, sky.shape[0] - 1), place[:, 0].clip(0, sky.shape[1] - 1)]
    return float(inside.mean()) < _MATCHED_SKY * float(inner.mean())


def _matched(evidence: Evidence | None, shape: tuple[int, ...]) -> np.ndarray:
    static = np.zeros(shape, np.uint8)
    if evidence is not None:
        for x, y in evidence.xy[evidence.matched] * np.array(shape[::-1], np.float32):
            cv2.circle(static, (int(x), int(y)), _STATIC_PX, 1, -1)
    return static > 0


def _reseed(job: tuple[_SeedJob, Learnt, MasksSettings]) -> Counts:
    seed, learnt, settings = job
    image = read_small(seed.image, LOOK_PX)
    labels = classify(image, learnt, settings)
    static = _matched(seed.evidence, labels.shape)
    free = np.ones(labels.shape, bool) if learnt.ego is None else ~_scaled(learnt.ego, labels.shape)
    masks = {label: (labels == label) & free & ~static for label in (SKY, WATER)}
    return _counted(appearance.bins(image), {USE: ((labels == USE) | static) & free, **masks})


def _counted(found: np.ndarray, masks: Mapping[int, np.ndarray]) -> Counts:
    return {label: np.bincount(found[mask], minlength=appearance.BINS) for label, mask in masks.items()}


def classify(image: np.ndarray, learnt: Learnt, settings: MasksSettings) -> np.ndarray:
    """Classes (h, w) u1 of an image (h, w, 3) u1 BGR at LOOK_PX, without the platform: see ``classes_of``."""
    shape = image.shape[:2]
    found = appearance.bins(image)
    look = learnt.appearance
    sky_ratio = cv2.blur(look.ratio(found, SKY, USE), (5, 5))
    white = grey(image) >= settings.overexposed
    high = np.arange(shape[0])[:, None] < (learnt.sky_rows + _SKY_MARGIN) * shape[0]
    sky = _with_white(_grown(_cleaned((sky_ratio > _SKY_CREDIT) & high), image), white)
    labels = np.full(shape, USE, np.uint8)
    labels[_cleaned(white)] = OVEREXPOSED
    labels[sky] = SKY
    if learnt.water is not None:
        prior = cv2.resize(learnt.water, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR)
        ratio = look.ratio(found, WATER, USE) + prior
        ratio = np.where(sky_ratio > _SKY_CREDIT, np.minimum(ratio, -0.5), ratio)
        ego = None if learnt.ego is None else _scaled(learnt.ego, shape)
        labels[below_waterline(ratio, ego)] = WATER
    return labels


def classes_of(path: Path, learnt: Learnt, settings: MasksSettings, shape: tuple[int, int]) -> np.ndarray:
    """Classes (h, w) u1 of an image at ``shape``, the reduced size of its mask."""
    small = classify(read_small(path, LOOK_PX), learnt, settings)
    labels = cv2.resize(small, (shape[1], shape[0]), interpolation=cv2.INTER_NEAREST)
    if learnt.ego is not None:
        labels[_scaled(learnt.ego, shape)] = EGO
    return labels


def _scaled(mask: np.ndarray, shape: tuple[int, ...]) -> np.ndarray:
    if mask.shape == shape:
        return mask
    return cv2.resize(mask.astype(np.uint8), (shape[1], shape[0]), interpolation=cv2.INTER_NEAREST) > 0


def _dilated(mask: np.ndarray, size_px: int) -> np.ndarray:
    return cv2.dilate(mask.astype(np.uint8), np.ones((size_px, size_px), np.uint8)) > 0


def _grown(sky: np.ndarray, image: np.ndarray) -> np.ndarray:
    """The sky up to its very edge, where texture told it apart from the sky: neighbours of the sky's own brightness."""
    light = grey(image).astype(np.float32)
    inside = sky.astype(np.float32)
    mean = cv2.blur(light * inside, (11, 11)) / np.maximum(cv2.blur(inside, (11, 11)), 1e-6)
    return sky | (_dilated(sky, 7) & (np.abs(light - mean) < _SAME_GREY))


def _with_white(sky: np.ndarray, white: np.ndarray) -> np.ndarray:
    """The sky with the sun and burnt-out clouds: white areas with sky round them."""
    count, labels, _, _ = cv2.connectedComponentsWithStats(white.astype(np.uint8), connectivity=4)
    ring = cv2.dilate(labels.astype(np.float32), np.ones((5, 5), np.uint8)).astype(np.int32)
    ring[white] = 0
    around = np.bincount(ring.ravel(), minlength=count)
    held = np.bincount(ring[sky], minlength=count)
    belongs = held > _SKY_AROUND * around
    belongs[0] = False
    return sky | belongs[labels]


def _cleaned(mask: np.ndarray) -> np.ndarray:
    mask = cv2.morphologyEx(mask.astype(np.uint8), cv2.MORPH_OPEN, np.ones((3, 3), np.uint8))
    for _ in range(2):  # small pieces go, then small holes
        _, labels, stats, _ = cv2.connectedComponentsWithStats(mask, connectivity=4)
        small = stats[:, cv2.CC_STAT_AREA] < _SMALL * mask.size
        small[0] = False
        mask = 1 - np.where(small[labels], 0, mask).astype(np.uint8)
    return mask > 0
