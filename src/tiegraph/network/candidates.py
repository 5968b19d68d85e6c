"""The stage candidates: from images and preview matches to candidate pairs, with the order and the rig checked.

Is a pass a sequence? Numbers and regular times of photographs are no evidence of it; their previews are. In a sequence
neighbours have similar views: three quarters of them tie, and by clearly more matches than images half the pass apart.
The number of matches decides and not the ties alone: a few seconds down a street everything still ties (KITTI: 37 of 40
such pairs, by a median of 22 matches where neighbours have 271). Otherwise the images are loose photographs: all of
them, or look-alikes, are compared, and no stage relies on their order. An order stated by the user is not tested.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import reduce
from operator import or_

import numpy as np

from tiegraph.errors import SettingsError
from tiegraph.network.axes import allowed_within
from tiegraph.network.loose import scored_pairs, words_of
from tiegraph.network.offsets import estimate_offsets
from tiegraph.network.passes import (
    Context,
    Descriptors,
    MatchCache,
    Pass,
    Proposal,
    find_passes,
    loose_images,
)
from tiegraph.network.posecheck import checked_pose_pairs
from tiegraph.network.poses import PoseResult
from tiegraph.network.retrieval import retrieve
from tiegraph.network.rigcheck import check_rigs
from tiegraph.network.settings import CandidatesSettings
from tiegraph.network.tuning import Tuning
from tiegraph.plugins import chosen
from tiegraph.scene.evidence import ENOUGH
from tiegraph.scene.pairs import Pairs, PreviewMatches, read_pair_list
from tiegraph.scene.scene import Scene
from tiegraph.scene.sorting import among_best


@dataclass(frozen=True)
class Candidates:
    """Candidate pairs from previews and priors, the scene with its rig and order checked, and notes."""

    pairs: Pairs
    scene: Scene
    notes: tuple[str, ...]
    ties: PreviewMatches  # of everything that was previewed


def find_candidates(
    scene: Scene,
    cache: MatchCache,
    settings: CandidatesSettings,
    tuning: Tuning,
    descriptors: Descriptors,
) -> Candidates:
    """Candidate pairs of a scene from the sources of the settings.

    ``cache`` matches previews, each pair once; ``descriptors`` gives those of all previews, for retrieval. Raises
    SettingsError for an unknown source, InputError for a bad pair list.
    """
    context = Context(scene, find_passes(scene), cache, settings=settings, tuning=tuning, descriptors=descriptors)
    scene, notes = shown_order(context)
    context = replace(context, scene=scene, passes=find_passes(scene))
    if {"auto", "offsets", "poses"} & set(settings.sources) or settings.sequence_cameras:
        scene, rig_notes = check_rigs(context)
        context, notes = replace(context, scene=scene, passes=find_passes(scene)), notes + rig_notes
    table = {"auto": automatic, **SOURCES}
    proposals = (chosen("pairs", name, table)(context) for name in dict.fromkeys(settings.sources))
    found = reduce(or_, proposals, Proposal(Pairs.empty()))
    if found.apart and scene.prior == "trajectory" and not scene.started:
        scene = scene.with_(prior="odometry")
    return Candidates(
        pairs=found.pairs,
        scene=scene,
        notes=notes + found.notes,
        ties=cache.matches(),
    )


def shown_order(context: Context) -> tuple[Scene, tuple[str, ...]]:
    """The scene without passes whose guessed order is not confirmed, and notes.

    The source ``sequence``, if the user asks for it, states that the order is right; sources that use no previews
    test none.
    """
    scene, sources = context.scene, set(context.settings.sources)
    if not scene.guessed or "sequence" in sources:
        return scene.with_(guessed=()), ()
    looks = bool({"auto", "offsets", "poses", "retrieval"} & sources)
    lost, notes = [], []
    for found in (p for p in context.passes if scene.sequences[p.sequence] in scene.guessed):
        shown, why = _shown(context, found) if looks else (False, "no preview was matched")
        if shown:
            notes.append(f"pass {found.name}: a sequence, {why}")
        else:
            lost.append(found.sequence)
            text = f"pass {found.name}: {len(found)} loose photographs and no sequence, although their names or times"
            notes.append(f"{text} are in order: {why}; --scan.layout sequence reads them as a sequence")
    return _without(scene, lost), tuple(notes)


def _shown(context: Context, found: Pass) -> tuple[bool, str]:
    """Whether previews show a pass of one camera to be a sequence, and the figures."""
    tuning, chance = context.tuning, context.settings.min_matches
    images = found.images[0][found.images[0] >= 0]
    count = len(images)
    some = min(count - 1, tuning.verdict.sample)
    near = np.unique(np.linspace(0, count - 2, some).astype(int)) if count > 1 else np.zeros(0, int)
    half = count // 2
    rng = np.random.default_rng(0)
    a, b = np.triu_indices(count, k=max(half, 1))
    far = np.sort(rng.choice(len(a), min(len(a), tuning.verdict.sample), replace=False))
    first, second = np.r_[images[near], images[a[far]]], np.r_[images[near + 1], images[b[far]]]
    counts = context.cache.measure(first, second)
    close, apart = counts[: len(near)], counts[len(near) :]
    if len(close) < ENOUGH:
        return False, f"its {count} images are too few for a test"
    sure = tuning.counts.sure * chance
    said = (
        f"{int(np.sum(close >= sure))} of {len(close)} previews of neighbours tie, and {int(np.sum(apart >= sure))} "
        f"of {len(apart)} previews of images half the pass apart (medians {np.median(close):.0f} and "
        f"{np.median(apart):.0f} matches)"
    )
    least, most = np.percentile(close, 25), np.percentile(apart, 75)
    clearly = most - chance < tuning.verdict.tells_nothing * (least - chance)
    return bool(least >= sure and clearly), said


def _without(scene: Scene, passes: list[int]) -> Scene:
    """The scene with the frames of some passes loose, and the other passes renumbered."""
    if not passes:
        return scene.with_(guessed=())
    kept = [k for k in range(len(scene.sequences)) if k not in passes]
    number = np.full(len(scene.sequences) + 1, -1)  # the last is that of loose frames
    number[kept] = np.arange(len(kept))
    sequence = number[scene.sequence]
    step = np.where(sequence < 0, np.cumsum(sequence < 0) - 1, scene.sequence_index)
    return scene.with_(
        sequence=sequence, sequence_index=step, sequences=tuple(scene.sequences[k] for k in kept), guessed=()
    )


# ---------------------------------------------------------------- sources: pairs, with the reason where one is refused


def sequence(context: Context) -> Proposal:
    """Each image with the next frames of its camera; in a rig also with the neighbouring cameras, if so set."""
    settings = context.settings
    if not context.passes:
        return Proposal(Pairs.empty(), ("sequence: the images have no order",))
    out = []
    for p in context.passes:
        for images in p.images:
            there = images[images >= 0]
            for step in range(1, settings.sequence_frames + 1):
                out.append(np.stack([there[:-step], there[step:]]))
        if settings.sequence_cameras:
            out.append(_neighbouring_cameras(p, settings))
    i, j = np.concatenate([np.zeros((2, 0), int), *out], axis=1)
    return Proposal(Pairs.make(i, j, "sequence"))


def _neighbouring_cameras(p: Pass, settings: CandidatesSettings) -> np.ndarray:
    out = [np.zeros((2, 0), int)]
    for c, d in np.argwhere(allowed_within(p.rig, settings.axes_deg)):
        if c == d:
            continue
        for step in range(0, min(settings.sequence_frames, len(p) - 1) + 1):
            left, right = p.images[c, : len(p) - step], p.images[d, step:]
            there = (left >= 0) & (right >= 0)
            out.append(np.stack([left[there], right[there]]))
    return np.concatenate(out, axis=1)


def exhaustive(context: Context) -> Proposal:
    """Every image with every other one."""
    i, j = np.triu_indices(len(context.scene), k=1)
    return Proposal(Pairs.make(i, j, "exhaustive"))


def from_file(context: Context) -> Proposal:
    """Pairs of a COLMAP pair list. Raises SettingsError without a file, InputError for one that cannot be used."""
    path = context.settings.pairs_file
    if path is None:
        raise SettingsError("candidates.sources has 'file', but candidates.pairs_file names none")
    pairs, notes = read_pair_list(path, context.scene)
    return Proposal(pairs, notes)


def poses(context: Context) -> Proposal:
    """Pairs by prior poses (paper 003), checked by a sample of previews. Frames without a prior or with a wrong one,
    and passes with separate odometry, cannot be compared by poses: previews tie them, so that none is lost."""
    found = checked_pose_pairs(context)
    known = Proposal(found.pairs, found.notes, apart=found.apart)
    compared = found.world.min() >= 0 and np.ptp(found.world) == 0
    return known if compared or "auto" in context.settings.sources else known | _not_compared(context, found)


def _not_compared(context: Context, found: PoseResult) -> Proposal:
    """Pairs by previews and order for images that the poses do not compare: of different worlds, or without a pose."""
    scene, world = context.scene, found.world[context.scene.frame]
    worlds = len(np.unique(world[world >= 0]))
    pairs = estimate_offsets(context).pairs | sequence(context).pairs
    alone = np.intersect1d(loose_images(scene), np.flatnonzero(world < 0))
    if len(alone):
        pairs = pairs | scored_pairs(context, alone, words_of(context))
    if worlds > 1:  # passes may meet at single places
        pairs = pairs | retrieve(context, found.pairs | pairs).pairs
    pairs = pairs.where(np.any(_which(world, pairs), axis=0))
    lost, across = (int(which.sum()) for which in _which(world, pairs.kept()))
    notes = []
    if len(found.without):
        notes.append(f"poses: frames without a prior are tied by previews and order instead: {lost} pairs")
    if worlds > 1:
        none = "" if across else "; nothing ties them, so they can only form separate models"
        notes.append(
            f"poses: {worlds} passes have poses in separate worlds, which cannot be compared, and are tied by "
            f"previews: {across} pairs{none}"
        )
    return Proposal(pairs, tuple(notes))


def _which(world: np.ndarray, pairs: Pairs) -> tuple[np.ndarray, np.ndarray]:
    """(P,) bool: pairs of an image without prior (``world`` (N,) -1), and pairs across two worlds."""
    a, b = world[pairs.i], world[pairs.j]
    lost = (a < 0) | (b < 0)
    return lost, ~lost & (a != b)


SOURCES: dict[str, Callable[[Context], Proposal]] = {
    "sequence": sequence,
    "exhaustive": exhaustive,
    "file": from_file,
    "offsets": estimate_offsets,
    "poses": poses,
    "retrieval": retrieve,
}


def automatic(context: Context) -> Proposal:
    """The sources for the scene: passes by order and offsets, priors if there are any, loose
    photographs by previews."""
    scene = context.scene
    loose = loose_images(scene)
    parts: list[Proposal] = []
    said: list[str] = []
    if len(loose) == len(scene) and len(loose) <= context.tuning.few_photos:
        said.append("exhaustive")
        every = exhaustive(context)  # previewed, none dropped: the design needs their overlap
        score = context.cache.measure(every.pairs.i, every.pairs.j)
        parts.append(replace(every, pairs=every.pairs.with_(score=score)))
    else:
        if context.passes:
            said += ["sequence", "offsets"]
            parts += [sequence(context), estimate_offsets(context)]
        # Along a pass previews are better than positions alone.
        if scene.has_orientations() or (len(loose) and scene.has_positions()):
            said.append("poses")
            # Poses along a pass are judged by the coarse model; for loose photographs every pair is previewed.
            parts.append(confirmed(poses(context), context) if len(loose) else poses(context))
        said.append("retrieval")
        parts.append(retrieve(context, reduce(or_, (p.pairs for p in parts), Pairs.empty())))
    return reduce(or_, parts, Proposal(Pairs.empty(), (f"sources chosen: {', '.join(said)}",)))


def confirmed(proposal: Proposal, context: Context) -> Proposal:
    """A proposal with its kept pairs previewed: those that share too little are dropped as ``weak``.

    The nearest pairs of a loose photograph are kept whatever their previews show.
    """
    pairs = proposal.pairs
    kept = np.flatnonzero(pairs.dropped == 0)
    score = pairs.score.copy()
    score[kept] = context.cache.measure(pairs.i[kept], pairs.j[kept])
    weak = score < context.tuning.counts.sure * context.settings.min_matches
    loose = context.scene.sequence[context.scene.frame] < 0
    ends, base = np.r_[pairs.i[kept], pairs.j[kept]], np.tile(pairs.baseline_m[kept], 2)
    near = np.zeros(len(pairs), bool)
    near[kept] = among_best(ends, -base, context.tuning.best_photos).reshape(2, -1).any(axis=0)
    near &= loose[pairs.i] & loose[pairs.j]
    return replace(proposal, pairs=pairs.with_(score=score).drop(weak & ~near, "weak"))
