"""Masks learnt from the survey itself: platform, sky, water and overexposure, without weights and without labels.

Sky lies above the rest: its edges face down, those of a pale road seen from the air face every way. Matches cannot
distinguish a sky from a smooth surface seen straight from above: neither has any. Over all images of a survey their
edges can.
"""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from tiegraph.masks import EGO, SKY, USE, WATER
from tiegraph.masks.classification import Classifier, Table, bin_count, bins, classify, learn_appearance, sought
from tiegraph.masks.frames import dilated, eroded, full_size, grey, read_small
from tiegraph.masks.matchability import (
    Matchability,
    MatchCounts,
    choose_pairs,
    matches_in,
    moves,
    pair_matchability,
    white_ties,
    without_sky,
)
from tiegraph.masks.platform import learn_platform, spread
from tiegraph.masks.settings import MasksSettings
from tiegraph.masks.skyline import border_sky, textureless_sky
from tiegraph.masks.tuning import Tuning
from tiegraph.masks.waterline import never_matching, water_priors

_NEAR, _NOT_ABOVE = "what matches in it is as near as the scene", "what looks like it does not lie above the rest"

Map = Callable[[Callable, Sequence], Iterable]


def edges_of(sky: np.ndarray, told: np.ndarray, tuning: Tuning) -> tuple[float, float]:
    """Edges of a sky (h, w) bool where it is separated from the scene, ``told`` (h, w) bool: not at the platform, nor
    at the row below which no sky is searched. The part of their length that faces down less that which faces up, and
    their length, pixels."""
    # Twigs and the steps of a border are no edges of their own
    down, right = np.gradient(-cv2.GaussianBlur(sky.astype(np.float32), (0, 0), 5.0))
    inner = eroded(told, tuning.reach_px)
    return float(down[inner].sum()), float(np.hypot(down, right)[inner].sum())


def not_above(edges: Mapping[int, Sequence[tuple[float, float]]], tuning: Tuning) -> set[int]:
    """The cameras whose sky is none, as it does not lie above the rest: those of all level cameras are judged together.

    ``edges``: of the images of each level camera (``edges_of``), whose tops are up to within some 45 degrees; a camera
    that looks up sees sky anywhere.
    """
    down, length = (sum(e[n] for own in edges.values() for e in own) for n in (0, 1))
    return set(edges) if down < tuning.sky.min_down * length else set()


@dataclass(frozen=True)
class LabelJob:
    """An image for seeds, and its known classes."""

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
    share of the height above which its sky lies, narrow pieces included; ``ties``: its matches by class;
    ``edges`` of its sky, none of an image that looks up."""

    looks: dict[int, np.ndarray]
    places: dict[int, np.ndarray]
    low: float
    matches: MatchCounts = MatchCounts()
    edges: tuple[float, float] = (0.0, 0.0)


def first_labels(job: LabelJob) -> Labels:
    """Certain areas before anything is learnt: matched features, the zone of water, sky above a border."""
    tuning = job.tuning
    image = read_small(job.image, tuning.look_px)
    shape = image.shape[:2]
    static = _matched(job.matchability, shape)
    water = np.zeros(shape, bool) if job.zone is None else full_size(job.zone, shape)
    sky = textureless_sky(image, static, tuning) if job.upward else border_sky(image, tuning, job.platform)
    wall = sky is not None and not job.upward  # until its matches say that it is sky
    if wall and job.matchability is not None:  # a bright wall has as many as other walls
        inner = eroded(sky, tuning.window_px)
        wall = not inner[job.matchability.pixels(shape)].mean() < tuning.dense * float(inner.mean())
    if sky is None or wall:
        sky = np.zeros(shape, bool)
    else:  # areas well off the sky are scene or water
        pale = _like_sky(image, sky, job.matchability, tuning)  # where the horizon is, is not known yet
        static = (static | ~dilated(sky, 9)) & ~pale
    free = np.ones(shape, bool) if job.platform is None else ~full_size(job.platform, shape)
    rows = np.flatnonzero((sky & free & ~water & ~static).mean(axis=1) > 0.02)  # share of a row that must be sky
    low = float(rows[-1] + 1) / shape[0] if len(rows) else 0.0
    sky = (sky if job.upward else _wide(sky, tuning)) & ~static
    return _seeds(image, {USE: static & free & ~water, WATER: water & free, SKY: sky & free & ~water}, tuning, low)


def second_labels(job: tuple[LabelJob, Classifier], settings: MasksSettings) -> Labels:
    """Water, sky and scene of an image by the first try, learnt of its camera: unlike the first seeds, it covers the
    images."""
    seed, learnt = job
    tuning = seed.tuning
    image = read_small(seed.image, tuning.look_px)
    labels = classify(image, learnt, settings, tuning)
    static = _matched(seed.matchability, labels.shape)
    free = np.ones(labels.shape, bool) if learnt.platform is None else ~full_size(learnt.platform, labels.shape)
    masks = {label: (labels == label) & free & ~static for label in (SKY, WATER)}
    doubtful = np.arange(len(image))[:, None] > learnt.sky_rows * len(image)  # at the horizon clouds pale
    masks[SKY] = masks[SKY] & ~doubtful
    pale = _like_sky(image, labels == SKY, seed.matchability, tuning, learnt.sky_rows)
    classes = np.where(free, labels, EGO).astype(np.uint8)
    seeds = _seeds(image, {USE: ((labels == USE) | static) & ~pale & free, **masks}, tuning)
    told = free & (labels != WATER) & sought(labels.shape, learnt, tuning)
    edges = (0.0, 0.0) if seed.upward else edges_of(labels == SKY, told, tuning)
    matches = MatchCounts()
    if seed.matchability is not None:
        matches = matches_in(classes, classes == SKY, seed.matchability, tuning)
    return replace(seeds, matches=matches, edges=edges)


def _like_sky(
    image: np.ndarray, sky: np.ndarray, matchability: Matchability | None, tuning: Tuning, lowest: float = -1.0
) -> np.ndarray:
    """Areas as bright as the sky and connected to it that hardly match or end above the horizon.

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
    row = int(np.clip(round((lowest + tuning.sky.horizon) * len(sky)), 0, len(sky)))
    pale = np.bincount(pieces[row:].ravel(), minlength=count) <= 0.05 * area
    if matchability is not None:
        at = pieces[matchability.pixels(sky.shape)]
        pale |= np.bincount(at, minlength=count) * pieces.size < tuning.dense * len(at) * area
    pale[0] = False
    return pale[pieces]


def _seeds(image: np.ndarray, masks: Mapping[int, np.ndarray], tuning: Tuning, low: float = 0.0) -> Labels:
    found, size = bins(image, tuning), tuning.sky.places[::-1]
    looks = {label: np.bincount(found[mask], minlength=bin_count(tuning)) for label, mask in masks.items()}
    places = {
        label: cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_AREA) for label, mask in masks.items()
    }
    return Labels(looks, places, low)


def _wide(sky: np.ndarray, tuning: Tuning) -> np.ndarray:
    """The sky without narrow parts: where a border runs down a pale wall, it does so in a few columns only."""
    across = np.ones((1, max(1, round(tuning.sky.wide * sky.shape[1]))), np.uint8)
    return cv2.morphologyEx(sky.astype(np.uint8), cv2.MORPH_OPEN, across) > 0


def _matched(matchability: Matchability | None, shape: tuple[int, ...]) -> np.ndarray:
    static = np.zeros(shape, np.uint8)
    if matchability is not None:
        for row, column in zip(*matchability.pixels(shape)):
            cv2.circle(static, (int(column), int(row)), 5, 1, -1)
    return static > 0


def learn(
    cameras: Mapping[int, Sequence[Path]],
    settings: MasksSettings,
    tuning: Tuning,
    upward: Iterable[int] = (),
    apply: Map = map,
) -> dict[int, Classifier]:
    """The classes learnt from the images (paths, in order) of all cameras; ``apply`` maps a function over items.

    ``upward``: cameras that look up and have no water in view.
    """
    upward, keys = set(upward), list(cameras)
    # The images of each camera between which the scene moves, the platform by them, and what matches in them
    learnt = list(apply(partial(learn_platform, tuning=tuning), [cameras[k] for k in keys]))
    platforms, notes = ({k: own[n] for k, own in zip(keys, learnt)} for n in (1, 2))
    pairs = choose_pairs([own[0] for own in learnt], tuning)
    found = list(apply(partial(pair_matchability, tuning=tuning), [pair for own in pairs for pair in own]))
    each = iter(found)
    seen = {k: [e for _ in own for e in next(each)] for k, own in zip(keys, pairs)}
    if not moves(found, tuning):
        still = "no platform learnt (no frames show that the camera moves)"
        notes = {k: notes[k] if platforms[k] is None else still for k in keys}
        platforms = dict.fromkeys(keys)
    # Where nothing ever matches, and the prior of water by place, of the cameras that show water
    level = [k for k in keys if k not in upward]
    zones = {k: never_matching(seen[k], platforms[k], tuning) for k in level}
    water = {} if settings.water == "off" else water_priors(zones, settings.water == "on", tuning)
    jobs = [
        LabelJob(
            camera=k, image=image, matchability=matched.get(image), zone=zones[k].mask if k in water else None,
            platform=platforms[k], upward=k in upward, tuning=tuning,
        )
        for k, images in cameras.items()
        for matched in [{e.image: e for e in seen[k]}]
        for image in dict.fromkeys([*matched, *spread(images, tuning.each(len(cameras)))])
    ]  # fmt: skip
    # The first time: appearances, and the lowest row in which sky is searched
    labels = list(apply(first_labels, jobs))
    known = _appearances(jobs, labels, upward, tuning)
    lowest = lowest_agreed([s.low for job, s in zip(jobs, labels) if not job.upward], tuning)
    first = {
        k: Classifier(
            platform=platforms[k], table=known[k], water=water.get(k), sky=None,
            sky_rows=1.0 if k in upward else lowest, note="",
        )
        for k in keys
    }  # fmt: skip
    # Once more, with water, sky and scene of the first try as seeds: they cover the images, the first did not.
    again = list(apply(partial(second_labels, settings=settings), [(job, first[job.camera]) for job in jobs]))
    made = _proven(first, jobs, again, settings.water == "on", tuning)
    told = {k: f", no sky: {m.no_sky}" if m.no_sky else "" for k, m in made.items()}
    wet = {k: ", no water seen" if m.water is None else ", water" for k, m in made.items()}
    return {k: replace(m, note=notes[k] + told[k] + wet[k]) for k, m in made.items()}


def _proven(
    first: Mapping[int, Classifier], jobs: Sequence[LabelJob], seeds: Sequence[Labels], asked: bool, tuning: Tuning
) -> dict[int, Classifier]:
    """The second learning, without refuted skies; without any sky, water must be ``asked`` for."""
    upward = {job.camera for job in jobs if job.upward}
    known, places = _appearances(jobs, seeds, upward, tuning), _places(jobs, seeds, tuning)
    ties = {k: sum(_of(k, jobs, [s.matches for s in seeds]), MatchCounts()) for k in first}
    anywhere = not_above({k: _of(k, jobs, [s.edges for s in seeds]) for k in set(first) - upward}, tuning)
    refuted = dict.fromkeys(anywhere, _NOT_ABOVE) | dict.fromkeys(without_sky(ties, tuning), _NEAR)
    white = white_ties((s.matches for s in seeds), tuning)
    dry = not asked and set(refuted) >= set(first) - upward
    made = {}
    for k, learnt in first.items():
        table = {c: t for c, t in known[k].items() if c != SKY or k not in refuted}
        sky = None if k in refuted else places.get(k)
        water = None if dry else learnt.water
        made[k] = replace(learnt, table=table, sky=sky, water=water, no_sky=refuted.get(k, ""), white_matches=white)
    return made


def _of(camera: int, jobs: Sequence[LabelJob], items: Sequence) -> list:
    return [item for job, item in zip(jobs, items) if job.camera == camera]


def lowest_agreed(rows: Sequence[float], tuning: Tuning) -> float:
    """The largest of ``rows`` (shares of the height, 0 = no sky) that enough others come close to; 0 if there is none.

    A border found in a wall or on a road lies anywhere; the horizon is in the same place in many images.
    """
    known = np.array([r for r in rows if r > 0])
    near = [int(((known <= r) & (known > r - tuning.sky.horizon)).sum()) for r in known]
    enough = max(2, 0.1 * len(known))
    agreed = known[np.array(near) >= enough] if len(known) else known
    return float(agreed.max()) if len(agreed) else float(known.max(initial=0))


def _appearances(
    jobs: Sequence[LabelJob], seeds: Sequence[Labels], upward: set[int], tuning: Tuning
) -> dict[int, Table]:
    """The appearance for each camera: by its own seeds, and by those of all cameras that look level, or up, as it does.

    A pale wall looks like a cloud of another camera's sky; classes that a camera never sees come from the others.
    """
    shared = {up: _looks([s for job, s in zip(jobs, seeds) if job.upward == up]) for up in (False, True)}
    own = {key: _looks(_of(key, jobs, seeds)) for key in {job.camera for job in jobs}}
    return {key: learn_appearance(looks, tuning, shared[key in upward]) for key, looks in own.items()}


def _looks(seeds: Sequence[Labels]) -> dict[int, np.ndarray]:
    return {label: np.sum([s.looks[label] for s in seeds], axis=0) for label in (USE, SKY, WATER)}


def _places(jobs: Sequence[LabelJob], seeds: Sequence[Labels], tuning: Tuning) -> dict[int, np.ndarray]:
    """Log of P(place | sky) / P(place | scene), (r, c) f4, for each level camera that shows sky at all."""
    found = {}
    for camera in {job.camera for job in jobs if not job.upward}:
        own = [s.places for s in _of(camera, jobs, seeds) if s.places[SKY].any()]
        if own:
            sky, scene = (cv2.GaussianBlur(np.sum([p[c] for p in own], axis=0), (0, 0), 0.7) for c in (SKY, USE))
            ratio = np.log((sky + 0.5) / (scene + 0.5))  # half an image for either, as Jeffreys has it
            found[camera] = np.clip(ratio, -tuning.most_says / 3, tuning.most_says / 3).astype(np.float32)
    return found
