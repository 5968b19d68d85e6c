"""Pair sources by name: each proposes pairs with a score and, where it refused one, the reason."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import or_

import numpy as np

from tiegraph.errors import SettingsError
from tiegraph.network.offsets.curves import Proposal
from tiegraph.network.offsets.offsets import estimate_offsets
from tiegraph.network.passes import MatchCache, Pass, loose_images
from tiegraph.network.poses.check import checked_pose_pairs
from tiegraph.network.poses.poses import PoseResult
from tiegraph.network.retrieval.loose import scored_pairs
from tiegraph.network.retrieval.retrieval import retrieve
from tiegraph.network.rig.axes import allowed_within
from tiegraph.network.settings import CandidatesSettings
from tiegraph.network.tuning import Tuning
from tiegraph.scene.pairs import REASONS, Pairs, read_pair_list
from tiegraph.scene.scene import Scene
from tiegraph.scene.sorting import among_best

Descriptors = Callable[[], Sequence[np.ndarray]]  # (K, 128) u1 of every image


@dataclass(frozen=True)
class Context:
    """The input of a source."""

    scene: Scene
    passes: tuple[Pass, ...]
    cache: MatchCache
    settings: CandidatesSettings
    tuning: Tuning
    descriptors: Descriptors | None = None  # of all previews; None = no retrieval


def sequence(context: Context) -> Proposal:
    """Each image with the next frames of its camera; in a rig also with the neighbouring cameras, if so set."""
    settings = context.settings
    out = []
    for p in context.passes:
        for images in p.images:
            there = images[images >= 0]
            for step in range(1, settings.sequence_frames + 1):
                out.append(np.stack([there[:-step], there[step:]]))
        if settings.sequence_cameras:
            out.append(_neighbouring_cameras(p, settings))
    if not context.passes:
        return Proposal(Pairs.empty(), ("sequence: the images have no order",))
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


def offsets(context: Context) -> Proposal:
    """Frame-offset voting within and between passes (papers 000, 001)."""
    return estimate_offsets(context.passes, context.cache, len(context.scene), context.settings, context.tuning)


def poses(context: Context) -> Proposal:
    """Pairs by prior poses (paper 003), checked by a sample of previews. Frames without a prior or with a wrong one,
    and passes with separate odometry, cannot be compared by poses: previews tie them, so that none is lost."""
    found = checked_pose_pairs(context.scene, context.passes, context.cache, context.settings, context.tuning)
    known = Proposal(found.pairs, found.notes, apart=found.apart)
    compared = found.world.min() >= 0 and np.ptp(found.world) == 0
    return known if compared or "auto" in context.settings.sources else known | _not_compared(context, found)


def _not_compared(context: Context, found: PoseResult) -> Proposal:
    """Pairs by previews and order for images that the poses do not compare: of different worlds, or without a pose."""
    scene, world = context.scene, found.world[context.scene.frame]
    worlds = len(np.unique(world[world >= 0]))
    pairs = offsets(context).pairs | sequence(context).pairs
    alone = np.intersect1d(loose_images(scene), np.flatnonzero(world < 0))
    pairs = pairs | scored_pairs(scene, alone, context.cache, context.settings, context.tuning)
    if worlds > 1 and context.descriptors is not None:  # passes may meet at single places
        pairs = pairs | retrieval(context, found.pairs | pairs).pairs
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


def retrieval(context: Context, known: Pairs | None = None) -> Proposal:
    """Look-alikes: loose photographs, and loops of passes away from the ``known`` pairs. Raises SettingsError if the
    caller has no descriptors."""
    if context.descriptors is None:
        raise SettingsError("candidates.sources has 'retrieval', but the descriptors of the previews are not available")
    looked = context.scene, context.passes, context.cache, context.settings, context.tuning
    return retrieve(*looked, context.descriptors, known)


SOURCES: dict[str, Callable[[Context], Proposal]] = {
    "sequence": sequence,
    "exhaustive": exhaustive,
    "file": from_file,
    "offsets": offsets,
    "poses": poses,
    "retrieval": retrieval,
}


def automatic(context: Context) -> Proposal:
    """The sources for the scene: passes by order and offsets, priors if there are any, loose
    photographs by previews."""
    scene = context.scene
    loose = loose_images(scene)
    parts: list[Proposal] = []
    said: list[str] = []
    if len(loose) == len(scene) and len(loose) <= context.tuning.sources.few_photos:
        said.append("exhaustive")
        every = exhaustive(context)  # previewed, none dropped: the design needs their overlap
        score = context.cache.measure(every.pairs.i, every.pairs.j)
        parts.append(replace(every, pairs=every.pairs.with_(score=score)))
    else:
        if context.passes:
            said += ["sequence", "offsets"]
            parts += [sequence(context), offsets(context)]
        # Along a pass previews are better than positions alone.
        if scene.has_orientations() or (len(loose) and scene.has_positions()):
            said.append("poses")
            # Poses along a pass are judged by the coarse model; for loose photographs every pair is previewed.
            parts.append(confirmed(poses(context), context) if len(loose) else poses(context))
        if context.descriptors is not None:
            said.append("retrieval")
            known = reduce(or_, (p.pairs for p in parts), Pairs.empty())
            parts.append(retrieval(context, known))
        elif len(loose):
            said.append("previews of loose photographs")
            parts.append(Proposal(scored_pairs(scene, loose, context.cache, context.settings, context.tuning)))
    merged = Proposal(Pairs.empty(), (f"sources chosen: {', '.join(said)}",))
    for part in parts:
        merged = merged | part
    return merged


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
    near[kept] = among_best(ends, -base, context.tuning.sources.nearest).reshape(2, -1).any(axis=0)
    near &= loose[pairs.i] & loose[pairs.j]
    return replace(proposal, pairs=pairs.with_(score=score).drop(weak & ~near, "weak"))


def axes_count(passes: Sequence[Pass], settings: CandidatesSettings) -> int:
    """How many image pairs of one pass have optical axes that make a match impossible: never tried."""
    count = 0
    for p in passes:
        there = np.sum(p.images >= 0, axis=1)
        apart = np.triu(~allowed_within(p.rig, settings.axes_deg), 1)
        count += int(there @ apart @ there)
    return count


def axes_pairs(passes: Sequence[Pass], settings: CandidatesSettings) -> Pairs:
    """The pairs of ``axes_count``, dropped for their reason: a table that grows with the square of a pass."""
    out = [np.zeros((2, 0), int)]
    for p in passes:
        for c, d in np.argwhere(np.triu(~allowed_within(p.rig, settings.axes_deg), 1)):
            left, right = np.repeat(p.images[c], len(p)), np.tile(p.images[d], len(p))
            out.append(np.stack([left, right])[:, (left >= 0) & (right >= 0)])
    i, j = np.concatenate(out, axis=1)
    return Pairs.make(i, j, "offsets", dropped=np.full(len(i), REASONS.index("axes")))
