"""Masks learnt from the survey itself: platform, sky, water and overexposure, without weights and without labels."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from tiegraph.masks import SKY, USE, WATER, appearance
from tiegraph.masks.appearance import Appearance
from tiegraph.masks.classification import Classifier
from tiegraph.masks.labels import LabelJob, Labels, TriedJob, first_labels, not_above, second_labels
from tiegraph.masks.matchability import Matchability, choose_pairs, pair_matchability
from tiegraph.masks.platform import PlatformMask, different_frames, learn_platform
from tiegraph.masks.proof import NONE, moves, white_ties, without_sky
from tiegraph.masks.settings import MasksSettings
from tiegraph.masks.tuning import Tuning
from tiegraph.masks.tuning_learnt import LabelTuning, MatchabilityTuning
from tiegraph.masks.water import never_matching, water_priors

_NEAR, _NOT_ABOVE = "what matches in it is as near as the scene", "what looks like it does not lie above the rest"

Map = Callable[[Callable, Sequence], Iterable]


def learn(
    cameras: Mapping[int, Sequence[Path]],
    settings: MasksSettings,
    tuning: Tuning,
    upward: Iterable[int] = (),
    apply: Map = map,
) -> dict[int, Classifier]:
    """What is learnt from the images (paths, in order) of all cameras; ``apply`` maps a function over items.

    ``upward``: cameras that look up and have no water in view.
    """
    upward, keys = set(upward), list(cameras)
    # The images of each camera between which the scene moves, the platform by them, and what matches in them
    different = dict(zip(keys, apply(partial(different_frames, tuning=tuning), [cameras[k] for k in keys])))
    counted = [(different[k], len(cameras[k])) for k in keys]
    platforms = dict(zip(keys, apply(partial(_learn_platform, tuning=tuning), counted)))
    pairs = choose_pairs(list(different.values()), tuning.matchability)
    found = list(apply(partial(_pair, tuning=tuning.matchability), [pair for own in pairs for pair in own]))
    each = iter(found)
    seen = {k: [e for _ in own for e in next(each)] for k, own in zip(keys, pairs)}
    if not moves(found, tuning.proof):
        still = "no platform learnt (no frames show that the camera moves)"
        platforms = {k: p if p.mask is None else PlatformMask(None, p.frames, still) for k, p in platforms.items()}
    # Where nothing ever matches, and the prior of water by place, of the cameras that show water
    level = [k for k in keys if k not in upward]
    zones = {k: never_matching(seen[k], platforms[k].mask, tuning.water) for k in level}
    water = {} if settings.water == "off" else water_priors(zones, settings.water == "on", tuning.water)
    count = max(tuning.labels.least_images, tuning.labels.images // max(1, len(cameras)))
    jobs = [
        LabelJob(
            camera=k, image=image, matchability=matchability, zone=zones[k].mask if k in water else None,
            platform=platforms[k].mask, upward=k in upward, tuning=tuning,
        )
        for k, images in cameras.items()
        for image, matchability in _seed_images(images, seen[k], count)
    ]  # fmt: skip
    # The first time: appearances, and how far down sky is sought
    labels = list(apply(first_labels, jobs))
    known = _appearances(jobs, labels, upward, tuning)
    lowest = lowest_agreed([s.low for job, s in zip(jobs, labels) if not job.upward], tuning.labels)
    first = {
        k: Classifier(
            platform=platforms[k].mask, appearance=known[k], water=water.get(k), sky=None,
            sky_rows=1.0 if k in upward else lowest, note="",
        )
        for k in keys
    }  # fmt: skip
    # Once more, with what the first try calls water, sky and scene as seeds: they cover the images, the first did not.
    again = list(apply(second_labels, [TriedJob(job, first[job.camera], settings) for job in jobs]))
    made = _proven(first, jobs, again, settings.water == "on", tuning)
    told = {k: f", no sky: {m.no_sky}" if m.no_sky else "" for k, m in made.items()}
    wet = {k: ", no water seen" if m.water is None else ", water" for k, m in made.items()}
    return {k: replace(m, note=platforms[k].note + told[k] + wet[k]) for k, m in made.items()}


def _proven(
    first: Mapping[int, Classifier], jobs: Sequence[LabelJob], seeds: Sequence[Labels], asked: bool, tuning: Tuning
) -> dict[int, Classifier]:
    """What is learnt the second time, without the sky that is refuted; without any, water must be ``asked`` for."""
    upward = {job.camera for job in jobs if job.upward}
    known, places = _appearances(jobs, seeds, upward, tuning), _places(jobs, seeds, tuning.labels)
    refuted = _refuted(jobs, seeds, upward, tuning)
    white = white_ties((s.matches for s in seeds), tuning.proof)
    dry = not asked and set(refuted) >= set(first) - upward
    made = {}
    for k, learnt in first.items():
        table = {c: t for c, t in known[k].table.items() if c != SKY or k not in refuted}
        sky = None if k in refuted else places.get(k)
        water = None if dry else learnt.water
        why = refuted.get(k, "")
        made[k] = replace(learnt, appearance=Appearance(table), sky=sky, water=water, no_sky=why, white_matches=white)
    return made


def _refuted(jobs: Sequence[LabelJob], seeds: Sequence[Labels], upward: set[int], tuning: Tuning) -> dict[int, str]:
    """The cameras whose sky is refuted, and by what."""
    cameras = {job.camera for job in jobs}
    near = without_sky({k: sum(_of(k, jobs, [s.matches for s in seeds]), NONE) for k in cameras}, tuning.proof)
    anywhere = not_above({k: _of(k, jobs, [s.edges for s in seeds]) for k in cameras - upward}, tuning.labels)
    return dict.fromkeys(anywhere, _NOT_ABOVE) | dict.fromkeys(near, _NEAR)


def _of(camera: int, jobs: Sequence[LabelJob], items: Sequence) -> list:
    return [item for job, item in zip(jobs, items) if job.camera == camera]


def lowest_agreed(rows: Sequence[float], tuning: LabelTuning) -> float:
    """The largest of ``rows`` (shares of the height, 0 = no sky) that enough others come close to; 0 if there is none.

    A border found in a wall or on a road lies anywhere; the horizon is in the same place in many images.
    """
    known = np.array([r for r in rows if r > 0])
    near = [int(((known <= r) & (known > r - tuning.agreed)).sum()) for r in known]
    enough = max(2, 0.1 * len(known))
    agreed = known[np.array(near) >= enough] if len(known) else known
    return float(agreed.max()) if len(agreed) else float(known.max(initial=0))


def _learn_platform(job: tuple[Sequence[Path], int], tuning: Tuning) -> PlatformMask:
    return learn_platform(*job, tuning)


def _pair(job: tuple[Path, Path], tuning: MatchabilityTuning) -> tuple[Matchability, ...]:
    return pair_matchability(*job, tuning)


def _seed_images(
    images: Sequence[Path], seen: Sequence[Matchability], count: int
) -> list[tuple[Path, Matchability | None]]:  # with evidence first, then others spread over the sequence
    by_image: dict[Path, Matchability | None] = {e.image: e for e in seen}
    spread = [images[k] for k in np.unique(np.linspace(0, len(images) - 1, min(count, len(images))).astype(int))]
    return [(image, by_image.get(image)) for image in dict.fromkeys([*by_image, *spread])]


def _appearances(
    jobs: Sequence[LabelJob], seeds: Sequence[Labels], upward: set[int], tuning: Tuning
) -> dict[int, Appearance]:
    """The appearance for each camera: what it sees itself, and what all do that look level, or up, as it does.

    A pale wall looks like a cloud of another camera's sky; what a camera never sees itself the others tell.
    """

    up = {key: key in upward for key in {job.camera for job in jobs}}
    shared = {
        looks_up: _looks([s for job, s in zip(jobs, seeds) if job.upward == looks_up]) for looks_up in up.values()
    }
    own = {key: _looks([s for job, s in zip(jobs, seeds) if job.camera == key]) for key in up}
    return {key: appearance.learn(own[key], tuning.appearance, shared[up[key]]) for key in up}


def _looks(seeds: Sequence[Labels]) -> dict[int, np.ndarray]:
    return {label: np.sum([s.looks[label] for s in seeds], axis=0) for label in (USE, SKY, WATER)}


def _places(jobs: Sequence[LabelJob], seeds: Sequence[Labels], tuning: LabelTuning) -> dict[int, np.ndarray]:
    """Log of P(place | sky) / P(place | scene), (r, c) f4, for each level camera that shows sky at all."""
    found = {}
    for camera in {job.camera for job in jobs if not job.upward}:
        own = [s.places for job, s in zip(jobs, seeds) if job.camera == camera and s.places[SKY].any()]
        if own:
            sky, scene = (cv2.GaussianBlur(np.sum([p[c] for p in own], axis=0), (0, 0), 0.7) for c in (SKY, USE))
            ratio = np.log((sky + tuning.place_seeds) / (scene + tuning.place_seeds))
            found[camera] = np.clip(ratio, -tuning.place_clip, tuning.place_clip).astype(np.float32)
    return found
