"""Seeds of sky, water and static scene in single images, from which their looks and places are learnt.

Sky lies above what is not sky: its edges face down, those of a pale road seen from the air face every way. Matches
cannot tell a sky from a smooth surface seen straight from above: neither has any. Over all images of a survey their
edges can.
"""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from tiegraph.masks import EGO, SKY, USE, WATER
from tiegraph.masks.appearance import bins
from tiegraph.masks.classification import Classifier, classify, sought
from tiegraph.masks.frames import grey, read_small
from tiegraph.masks.matchability import Matchability
from tiegraph.masks.morphology import dilated, eroded, scaled
from tiegraph.masks.proof import NONE, MatchCounts, matches_in
from tiegraph.masks.settings import MasksSettings
from tiegraph.masks.skyline import border_sky, textureless_sky
from tiegraph.masks.tuning import Tuning
from tiegraph.masks.tuning_learnt import LabelTuning


@dataclass(frozen=True)
class Edges:
    """Edges of a sky in some images: their ``length`` in pixels, and ``down``, the part of it that faces down less that
    which faces up."""

    down: float = 0.0
    length: float = 0.0

    def __add__(self, other: "Edges") -> "Edges":
        return Edges(self.down + other.down, self.length + other.length)


def edges_of(sky: np.ndarray, told: np.ndarray, tuning: LabelTuning) -> Edges:
    """Edges of a sky (h, w) bool where it is ``told`` from the scene, (h, w) bool: not at the platform, nor at the row
    below which no sky is sought."""
    # Twigs and the steps of a border are no edges of their own
    down, right = np.gradient(-cv2.GaussianBlur(sky.astype(np.float32), (0, 0), 5.0))
    inner = eroded(told, tuning.reach_px)
    return Edges(float(down[inner].sum()), float(np.hypot(down, right)[inner].sum()))


def not_above(edges: Mapping[int, Iterable[Edges]], tuning: LabelTuning) -> set[int]:
    """The cameras whose sky is none, as it does not lie above the rest: those of all level cameras are judged together.

    ``edges``: of the images of each level camera, whose tops are up to within some 45 degrees; a camera that looks up
    sees sky anywhere.
    """
    every = sum((e for own in edges.values() for e in own), Edges())
    return set(edges) if every.down < tuning.min_down * every.length else set()


@dataclass(frozen=True)
class LabelJob:
    """An image to take seeds from, and what is known of it."""

    camera: int
    image: Path
    matchability: Matchability | None
    zone: np.ndarray | None  # where nothing ever matches: water
    platform: np.ndarray | None
    upward: bool
    tuning: Tuning


@dataclass(frozen=True)
class Labels:
    """Of one image: ``looks`` (bins,) counts and ``places`` (r, c) f4 shares of its seed pixels by class; ``low``:
    share of the height above which its sky lies, narrow pieces included; ``ties``: what of its matches lies where;
    ``edges`` of its sky, none of an image that looks up."""

    looks: dict[int, np.ndarray]
    places: dict[int, np.ndarray]
    low: float
    matches: MatchCounts = NONE
    edges: Edges = Edges()


def first_labels(job: LabelJob) -> Labels:
    """What is certain before anything is learnt: matched features, the zone of water, sky above a border."""
    tuning, own = job.tuning, job.tuning.labels
    image = read_small(job.image, tuning.frames.look_px)
    shape = image.shape[:2]
    static = _matched(job.matchability, shape)
    water = np.zeros(shape, bool) if job.zone is None else scaled(job.zone, shape)
    sky = (
        textureless_sky(image, static, tuning.skyline)
        if job.upward
        else border_sky(image, tuning.skyline, job.platform)
    )
    if sky is None or not job.upward and not _unmatched(sky, job.matchability, own):
        sky = np.zeros(shape, bool)
    else:  # what is well off the sky is scene or water
        pale = _like_sky(image, sky, job.matchability, own)  # where the horizon is, is not known yet
        static = (static | ~dilated(sky, 9)) & ~pale
    free = np.ones(shape, bool) if job.platform is None else ~scaled(job.platform, shape)
    rows = np.flatnonzero((sky & free & ~water & ~static).mean(axis=1) > 0.02)  # share of a row that must be sky
    low = float(rows[-1] + 1) / shape[0] if len(rows) else 0.0
    sky = (sky if job.upward else _wide(sky, own)) & ~static
    return _seeds(image, {USE: static & free & ~water, WATER: water & free, SKY: sky & free & ~water}, tuning, low)


@dataclass(frozen=True)
class TriedJob:
    """An image with what was learnt of its camera, to be looked at again."""

    seed: LabelJob
    learnt: Classifier
    settings: MasksSettings


def second_labels(job: TriedJob) -> Labels:
    """What the first try calls water, sky and scene: it covers the images, the first seeds do not."""
    seed, learnt, settings = job.seed, job.learnt, job.settings
    tuning = seed.tuning
    image = read_small(seed.image, tuning.frames.look_px)
    labels = classify(image, learnt, settings, tuning)
    static = _matched(seed.matchability, labels.shape)
    free = np.ones(labels.shape, bool) if learnt.platform is None else ~scaled(learnt.platform, labels.shape)
    masks = {label: (labels == label) & free & ~static for label in (SKY, WATER)}
    doubtful = np.arange(len(image))[:, None] > learnt.sky_rows * len(image)  # at the horizon clouds pale
    masks[SKY] = masks[SKY] & ~doubtful
    pale = _like_sky(image, labels == SKY, seed.matchability, tuning.labels, learnt.sky_rows)
    classes = np.where(free, labels, EGO).astype(np.uint8)
    seeds = _seeds(image, {USE: ((labels == USE) | static) & ~pale & free, **masks}, tuning)
    told = free & (labels != WATER) & sought(labels.shape, learnt, tuning.classification)
    edges = Edges() if seed.upward else edges_of(labels == SKY, told, tuning.labels)
    return replace(seeds, matches=matches_in(classes, classes == SKY, seed.matchability, tuning.proof), edges=edges)


def _like_sky(
    image: np.ndarray, sky: np.ndarray, matchability: Matchability | None, tuning: LabelTuning, lowest: float = -1.0
) -> np.ndarray:
    """What is as bright as the sky, hangs together with it, and hardly matches or ends above the horizon.

    Pale clouds straight ahead match from frame to frame as a wall does, as neither has a parallax; but a wall stands on
    the ground, and no cloud hangs below ``lowest``, the share of the height down to which sky is seen.
    """
    if not sky.any():
        return np.zeros(sky.shape, bool)
    light = grey(image)
    bright = light >= np.percentile(light[sky], 5.0)
    _, joined = cv2.connectedComponents((bright | sky).astype(np.uint8), connectivity=4)
    touching = np.isin(joined, np.unique(joined[sky])) & ~sky & bright
    count, pieces, stats, _ = cv2.connectedComponentsWithStats(touching.astype(np.uint8), connectivity=4)
    area = stats[:, cv2.CC_STAT_AREA]
    row = int(np.clip(round((lowest + tuning.lower) * len(sky)), 0, len(sky)))
    pale = np.bincount(pieces[row:].ravel(), minlength=count) <= 0.05 * area
    if matchability is not None:
        place = (matchability.xy[matchability.matched] * np.array(sky.shape[::-1], np.float32)).astype(int)
        at = pieces[place[:, 1].clip(0, sky.shape[0] - 1), place[:, 0].clip(0, sky.shape[1] - 1)]
        pale |= np.bincount(at, minlength=count) * pieces.size < tuning.matched_sky * len(place) * area
    pale[0] = False
    return pale[pieces]


def _seeds(image: np.ndarray, masks: Mapping[int, np.ndarray], tuning: Tuning, low: float = 0.0) -> Labels:
    found, size = bins(image, tuning.appearance), tuning.labels.places[::-1]
    looks = {label: np.bincount(found[mask], minlength=tuning.appearance.bins) for label, mask in masks.items()}
    places = {
        label: cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_AREA) for label, mask in masks.items()
    }
    return Labels(looks, places, low)


def _unmatched(sky: np.ndarray, matchability: Matchability | None, tuning: LabelTuning) -> bool:
    """Whether hardly a feature in what looks like sky matches: a bright wall has as many as other walls."""
    if matchability is None:
        return False
    place = (matchability.xy[matchability.matched] * np.array(sky.shape[::-1], np.float32)).astype(int)
    inner = eroded(sky, tuning.rim_px)
    inside = inner[place[:, 1].clip(0, sky.shape[0] - 1), place[:, 0].clip(0, sky.shape[1] - 1)]
    return float(inside.mean()) < tuning.matched_sky * float(inner.mean())


def _wide(sky: np.ndarray, tuning: LabelTuning) -> np.ndarray:
    """The sky without what is narrow: where a border runs down a pale wall, it does so in a few columns only."""
    across = np.ones((1, max(1, round(tuning.wide * sky.shape[1]))), np.uint8)
    return cv2.morphologyEx(sky.astype(np.uint8), cv2.MORPH_OPEN, across) > 0


def _matched(matchability: Matchability | None, shape: tuple[int, ...]) -> np.ndarray:
    static = np.zeros(shape, np.uint8)
    if matchability is not None:
        for x, y in matchability.xy[matchability.matched] * np.array(shape[::-1], np.float32):
            cv2.circle(static, (int(x), int(y)), 5, 1, -1)
    return static > 0
