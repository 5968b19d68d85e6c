"""Seeds of sky, water and static scene in single images, from which their looks and places are learnt."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from tiegraph.masks.above import Edges, edges_of
from tiegraph.masks.appearance import BINS, bins
from tiegraph.masks.classes import EGO, SKY, USE, WATER
from tiegraph.masks.evidence import Evidence
from tiegraph.masks.frames import grey, read_small
from tiegraph.masks.lookup import LOOK_PX, Learnt, classify, sought
from tiegraph.masks.morphology import dilated, scaled
from tiegraph.masks.proof import NONE, Ties, ties_in
from tiegraph.masks.settings import MasksSettings
from tiegraph.masks.skyline import border_sky, calm_sky

PLACES = (12, 16)
"""Rows and columns of the map of places."""
_STATIC_PX = 5  # around a matched feature all is static scene
_MATCHED_SKY = 0.25  # matched features on it, as a share of those on an equal area of the image
_LOW_SHARE = 0.02  # of a row that must be sky for sky to reach down to it
_PALE_PERCENT = 5.0  # of the sky is darker than what may belong to it
_LOWER, _ON_GROUND = 0.15, 0.05  # of the height below all known sky; share of a piece there from which it is no cloud
_WIDE = 0.12  # of the image's width: narrower pieces of sky are no seeds


@dataclass(frozen=True)
class SeedJob:
    """An image to take seeds from, and what is known of it."""

    camera: int
    image: Path
    evidence: Evidence | None
    zone: np.ndarray | None  # where nothing ever matches: water
    ego: np.ndarray | None
    upward: bool


@dataclass(frozen=True)
class Seeds:
    """Of one image: ``looks`` (BINS,) counts and ``places`` (12, 16) f4 shares of its seed pixels by class; ``low``:
    share of the height above which its sky lies, narrow pieces included; ``ties``: what of its matches lies where;
    ``edges`` of its sky, none of an image that looks up."""

    looks: dict[int, np.ndarray]
    places: dict[int, np.ndarray]
    low: float
    ties: Ties = NONE
    edges: Edges = Edges()


def first_seeds(job: SeedJob) -> Seeds:
    """What is certain before anything is learnt: matched features, the zone of water, sky above a border."""
    image = read_small(job.image, LOOK_PX)
    shape = image.shape[:2]
    static = _matched(job.evidence, shape)
    water = np.zeros(shape, bool) if job.zone is None else scaled(job.zone, shape)
    sky = calm_sky(image, static) if job.upward else border_sky(image, job.ego)
    if sky is None or not job.upward and not _unmatched(sky, job.evidence):
        sky = np.zeros(shape, bool)
    else:  # what is well off the sky is scene or water
        pale = _like_sky(image, sky, job.evidence)  # where the horizon is, is not known yet
        static = (static | ~dilated(sky, 9)) & ~pale
    free = np.ones(shape, bool) if job.ego is None else ~scaled(job.ego, shape)
    rows = np.flatnonzero((sky & free & ~water & ~static).mean(axis=1) > _LOW_SHARE)
    low = float(rows[-1] + 1) / shape[0] if len(rows) else 0.0
    sky = (sky if job.upward else _wide(sky)) & ~static
    return _seeds(image, {USE: static & free & ~water, WATER: water & free, SKY: sky & free & ~water}, low)


def second_seeds(job: tuple[SeedJob, Learnt, MasksSettings]) -> Seeds:
    """What the first try calls water, sky and scene: it covers the images, the first seeds do not."""
    seed, learnt, settings = job
    image = read_small(seed.image, LOOK_PX)
    labels = classify(image, learnt, settings)
    static = _matched(seed.evidence, labels.shape)
    free = np.ones(labels.shape, bool) if learnt.ego is None else ~scaled(learnt.ego, labels.shape)
    masks = {label: (labels == label) & free & ~static for label in (SKY, WATER)}
    doubtful = np.arange(len(image))[:, None] > learnt.sky_rows * len(image)  # at the horizon clouds pale
    masks[SKY] = masks[SKY] & ~doubtful
    pale = _like_sky(image, labels == SKY, seed.evidence, learnt.sky_rows)
    classes = np.where(free, labels, EGO).astype(np.uint8)
    seeds = _seeds(image, {USE: ((labels == USE) | static) & ~pale & free, **masks})
    told = free & (labels != WATER) & sought(labels.shape, learnt)
    edges = Edges() if seed.upward else edges_of(labels == SKY, told)
    return replace(seeds, ties=ties_in(classes, classes == SKY, seed.evidence), edges=edges)


def ties_of(job: tuple[SeedJob, Learnt, MasksSettings]) -> Ties:
    """Where the matches of an image lie in what ``learnt`` makes of it."""
    seed, learnt, settings = job
    if seed.evidence is None:
        return NONE
    labels = classify(read_small(seed.image, LOOK_PX), learnt, settings)
    if learnt.ego is not None:
        labels[scaled(learnt.ego, labels.shape)] = EGO
    return ties_in(labels, labels == SKY, seed.evidence)


def _like_sky(image: np.ndarray, sky: np.ndarray, evidence: Evidence | None, lowest: float = -1.0) -> np.ndarray:
    """What is as bright as the sky, hangs together with it, and hardly matches or ends above the horizon.

    Pale clouds straight ahead match from frame to frame as a wall does, as neither has a parallax; but a wall stands on
    the ground, and no cloud hangs below ``lowest``, the share of the height down to which sky is seen.
    """
    if not sky.any():
        return np.zeros(sky.shape, bool)
    light = grey(image)
    bright = light >= np.percentile(light[sky], _PALE_PERCENT)
    _, joined = cv2.connectedComponents((bright | sky).astype(np.uint8), connectivity=4)
    touching = np.isin(joined, np.unique(joined[sky])) & ~sky & bright
    count, pieces, stats, _ = cv2.connectedComponentsWithStats(touching.astype(np.uint8), connectivity=4)
    area = stats[:, cv2.CC_STAT_AREA]
    row = int(np.clip(round((lowest + _LOWER) * len(sky)), 0, len(sky)))
    pale = np.bincount(pieces[row:].ravel(), minlength=count) <= _ON_GROUND * area
    if evidence is not None:
        place = (evidence.xy[evidence.matched] * np.array(sky.shape[::-1], np.float32)).astype(int)
        at = pieces[place[:, 1].clip(0, sky.shape[0] - 1), place[:, 0].clip(0, sky.shape[1] - 1)]
        pale |= np.bincount(at, minlength=count) * pieces.size < _MATCHED_SKY * len(place) * area
    pale[0] = False
    return pale[pieces]


def _seeds(image: np.ndarray, masks: Mapping[int, np.ndarray], low: float = 0.0) -> Seeds:
    found = bins(image)
    looks = {label: np.bincount(found[mask], minlength=BINS) for label, mask in masks.items()}
    places = {
        label: cv2.resize(mask.astype(np.float32), PLACES[::-1], interpolation=cv2.INTER_AREA)
        for label, mask in masks.items()
    }
    return Seeds(looks, places, low)


def _unmatched(sky: np.ndarray, evidence: Evidence | None) -> bool:
    """Whether hardly a feature in what looks like sky matches: a bright wall has as many as other walls."""
    if evidence is None:
        return False
    place = (evidence.xy[evidence.matched] * np.array(sky.shape[::-1], np.float32)).astype(int)
    inner = cv2.erode(sky.astype(np.uint8), np.ones((5, 5), np.uint8)) > 0
    inside = inner[place[:, 1].clip(0, sky.shape[0] - 1), place[:, 0].clip(0, sky.shape[1] - 1)]
    return float(inside.mean()) < _MATCHED_SKY * float(inner.mean())


def _wide(sky: np.ndarray) -> np.ndarray:
    """The sky without what is narrow: where a border runs down a pale wall, it does so in a few columns only."""
    across = np.ones((1, max(1, round(_WIDE * sky.shape[1]))), np.uint8)
    return cv2.morphologyEx(sky.astype(np.uint8), cv2.MORPH_OPEN, across) > 0


def _matched(evidence: Evidence | None, shape: tuple[int, ...]) -> np.ndarray:
    static = np.zeros(shape, np.uint8)
    if evidence is not None:
        for x, y in evidence.xy[evidence.matched] * np.array(shape[::-1], np.float32):
            cv2.circle(static, (int(x), int(y)), _STATIC_PX, 1, -1)
    return static > 0
