"""Pair sources by name: each proposes pairs with a score and, where it refused one, the reason."""

from __future__ import annotations

import difflib
import logging
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from functools import reduce
from operator import or_
from pathlib import Path

import numpy as np

from tiegraph.errors import InputError, SettingsError
from tiegraph.network.looks.loose import scored_pairs
from tiegraph.network.looks.retrieval import retrieve
from tiegraph.network.offsets.curves import OffsetCurve
from tiegraph.network.offsets.offsets import estimate_offsets
from tiegraph.network.offsets.surface import OffsetSurface
from tiegraph.network.passes import Pass, PreviewBook, loose_images
from tiegraph.network.poses.check import checked_pose_pairs
from tiegraph.network.rig.axes import allowed_within
from tiegraph.network.settings import NetworkSettings
from tiegraph.network.tuning import Tuning
from tiegraph.scene.pairs import REASONS, Pairs
from tiegraph.scene.regular import regular
from tiegraph.scene.scene import Scene
from tiegraph.scene.table import text_lines

Descriptors = Callable[[], Sequence[np.ndarray]]  # (K, 128) u1 of every image

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Context:
    """What a source may use."""

    scene: Scene
    passes: tuple[Pass, ...]
    book: PreviewBook
    settings: NetworkSettings
    tuning: Tuning
    descriptors: Descriptors | None = None  # of all previews; None = there is no looking for look-alikes


@dataclass(frozen=True)
class Proposal:
    """What a source proposes."""

    pairs: Pairs
    notes: tuple[str, ...] = ()
    curves: tuple[OffsetCurve, ...] = ()
    surfaces: tuple[OffsetSurface, ...] = ()

    def __or__(self, other: Proposal) -> Proposal:
        return Proposal(
            self.pairs | other.pairs,
            self.notes + other.notes,
            self.curves + other.curves,
            self.surfaces + other.surfaces,
        )


def sequence(context: Context) -> Proposal:
    """Each image with the next frames of its camera; of a rig also with the neighbouring cameras, if so set."""
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


def _neighbouring_cameras(p: Pass, settings: NetworkSettings) -> np.ndarray:
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
        raise SettingsError("network.sources has 'file', but network.pairs_file names none")
    pairs, notes = read_pair_list(path, context.scene)
    return Proposal(pairs, notes)


def read_pair_list(path: Path, scene: Scene) -> tuple[Pairs, tuple[str, ...]]:
    """Pairs of a COLMAP pair list: two image names a line, ``#`` starts a comment; self pairs and repeats are counted.

    Raises InputError naming file, line and name for an unknown image, a line without exactly two names, an unreadable
    file, or a file without pairs.
    """
    rows: dict[tuple[int, int], int] = {}
    ignored: dict[str, list[int]] = {"self pairs": [], "repeated pairs": []}  # lines of each
    for number, words in pair_lines(path):
        i, j = sorted(_pair_of(words, f"{path}, line {number}", scene))
        if i == j:
            ignored["self pairs"].append(number)
        elif rows.setdefault((i, j), number) != number:
            ignored["repeated pairs"].append(number)
    if not rows:
        lines = ignored["self pairs"]
        raise InputError(
            f"{path}, line {lines[0]}: its {len(lines)} lines pair images with themselves; name two images a line"
        )
    both = np.array(list(rows))
    said = ", ".join(f"{len(v)} {kind} (line {v[0]}{' ...' if len(v) > 1 else ''})" for kind, v in ignored.items() if v)
    note = f"file: {len(rows)} pairs from {path.name}" + (f"; ignored: {said}" if said else "")
    return Pairs.make(both[:, 0], both[:, 1], "file"), (note,)


def pair_lines(path: Path) -> list[tuple[int, list[str]]]:
    """(line number, two image names) of a pair list, without comments.

    Raises InputError naming file and line for what is no text, holds no pairs, or has other than two names in a line.
    """
    try:
        text = regular(path).read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise InputError(f"{path}: cannot be read as a pair list: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: no pair list: not text in UTF-8 (byte {error.start + 1})") from None
    out = [(k, line.split("#", 1)[0].split()) for k, line in enumerate(text_lines(text), start=1)]
    out = [(k, words) for k, words in out if words]
    if not out:
        raise InputError(f"{path}: holds no pairs; expected two image names a line")
    for k, words in out:
        if len(words) != 2 or "\0" in words[0] + words[1]:
            found = f"{len(words)} words: {' '.join(words)!r:.99}"
            raise InputError(f"{path}, line {k}: expected two image names, found {found}")
    return out


def _pair_of(words: list[str], place: str, scene: Scene) -> tuple[int, int]:
    index = []
    for name in words:
        if name not in scene.image_index:
            name = name.replace("\\", "/").removeprefix("./")
        if name not in scene.image_index:
            near = difflib.get_close_matches(name, scene.names, n=1, cutoff=0.3)
            hint = f"; perhaps {near[0]!r}?" if near else ""
            lost = next((d.reason for d in scene.dropped if d.name == name), None)
            why = f" (left out by scan: {lost})" if lost else hint
            raise InputError(f"{place}: the survey has no image {name!r}{why}")
        index.append(scene.image_index[name])
    return index[0], index[1]


def offsets(context: Context) -> Proposal:
    """Frame-offset voting within and between passes (papers 000, 001)."""
    found = estimate_offsets(context.passes, context.book, len(context.scene), context.settings, context.tuning)
    return Proposal(found.pairs, found.notes, found.curves, found.surfaces)


def poses(context: Context) -> Proposal:
    """Pairs by prior poses (paper 003), which a sample of previews checks; frames without prior, or with a wrong one,
    fall back on previews, so that none is lost."""
    found = checked_pose_pairs(context.scene, context.passes, context.book, context.settings, context.tuning)
    notes = list(found.notes)
    pairs = found.pairs
    if len(found.without) and "auto" not in context.settings.sources:
        rest = offsets(context).pairs | sequence(context).pairs
        alone = np.intersect1d(loose_images(context.scene), _images_of(context.scene, found.without))
        rest = rest | scored_pairs(context.scene, alone, context.book, context.settings, context.tuning)
        lost = np.isin(context.scene.frame, found.without)
        rest = rest.where(lost[rest.i] | lost[rest.j])
        notes.append(f"poses: frames without prior are tied by previews and order instead: {len(rest.kept())} pairs")
        pairs = pairs | rest
    return Proposal(pairs, tuple(notes))


def _images_of(scene: Scene, frames: np.ndarray) -> np.ndarray:
    return np.flatnonzero(np.isin(scene.frame, frames))


def retrieval(context: Context, known: Pairs | None = None) -> Proposal:
    """Look-alikes: loose photographs, and loops of passes away from the ``known`` pairs. Raises SettingsError if the
    caller has no descriptors."""
    if context.descriptors is None:
        raise SettingsError("network.sources has 'retrieval', but the previews' descriptors are not at hand")
    looked = context.scene, context.passes, context.book, context.settings, context.tuning
    found = retrieve(*looked, context.descriptors, known)
    return Proposal(found.pairs, found.notes)


SOURCES: dict[str, Callable[[Context], Proposal]] = {
    "sequence": sequence,
    "exhaustive": exhaustive,
    "file": from_file,
    "offsets": offsets,
    "poses": poses,
    "retrieval": retrieval,
}


def automatic(context: Context) -> Proposal:
    """What suits the scene: passes by order and offsets, priors where there are some, loose photographs by previews."""
    scene = context.scene
    loose = loose_images(scene)
    parts: list[Proposal] = []
    said: list[str] = []
    if len(loose) == len(scene) and len(loose) <= context.tuning.sources.few_photos:
        said.append("exhaustive")
        parts.append(_counted(exhaustive(context), context))
    else:
        if context.passes:
            said += ["sequence", "offsets"]
            parts += [sequence(context), offsets(context)]
        # Along a pass previews know more than positions alone.
        if scene.has_orientations() or (len(loose) and scene.has_positions()):
            said.append("poses")
            # Poses along a pass are judged by the preview model; of loose photographs every pair is looked at.
            parts.append(confirmed(poses(context), context) if len(loose) else poses(context))
        if context.descriptors is not None:
            said.append("retrieval")
            known = reduce(or_, (p.pairs for p in parts), Pairs.empty())
            parts.append(retrieval(context, known))
        elif len(loose):
            said.append("previews of loose photographs")
            parts.append(Proposal(scored_pairs(scene, loose, context.book, context.settings, context.tuning)))
    merged = Proposal(Pairs.empty(), (f"sources chosen: {', '.join(said)}",))
    for part in parts:
        merged = merged | part
    return merged


def _counted(proposal: Proposal, context: Context) -> Proposal:
    """A proposal with its pairs previewed and none dropped: the design needs to know what they share."""
    pairs = proposal.pairs
    return replace(proposal, pairs=pairs.with_(score=context.book.measure(pairs.i, pairs.j)))


def confirmed(proposal: Proposal, context: Context) -> Proposal:
    """A proposal with its kept pairs previewed: those that share too little are dropped as ``weak``.

    Of a loose photograph the nearest ones stay whatever the preview says.
    """
    pairs = proposal.pairs
    kept = np.flatnonzero(pairs.dropped == 0)
    score = pairs.score.copy()
    score[kept] = context.book.measure(pairs.i[kept], pairs.j[kept])
    weak = score < context.tuning.counts.sure * context.settings.min_matches
    loose = context.scene.track[context.scene.frame] < 0
    near = _nearest(pairs, len(context.scene), context.tuning.sources.nearest) & loose[pairs.i] & loose[pairs.j]
    return Proposal(pairs.with_(score=score).drop(weak & ~near, "weak"), proposal.notes)


def _nearest(pairs: Pairs, images: int, count: int) -> np.ndarray:
    """(P,) bool: among the ``count`` shortest kept bases of either image."""
    row = np.tile(np.arange(len(pairs)), 2)
    image = np.concatenate([pairs.i, pairs.j])
    base = np.concatenate([pairs.baseline_m, pairs.baseline_m])
    kept = pairs.dropped[row] == 0
    row, image, base = row[kept], image[kept], base[kept]
    order = np.lexsort((base, image))
    start = np.searchsorted(image[order], np.arange(images))
    rank = np.arange(len(order)) - start[image[order]]
    out = np.zeros(len(pairs), bool)
    out[row[order[rank < count]]] = True
    return out


def axes_count(passes: Sequence[Pass], settings: NetworkSettings) -> int:
    """How many image pairs of one pass have optical axes that make a match impossible: never tried."""
    count = 0
    for p in passes:
        there = np.sum(p.images >= 0, axis=1)
        apart = np.triu(~allowed_within(p.rig, settings.axes_deg), 1)
        count += int(there @ apart @ there)
    return count


def axes_pairs(passes: Sequence[Pass], settings: NetworkSettings) -> Pairs:
    """The pairs of ``axes_count``, dropped for their reason: a table that grows with the square of a pass."""
    out = [np.zeros((2, 0), int)]
    for p in passes:
        for c, d in np.argwhere(np.triu(~allowed_within(p.rig, settings.axes_deg), 1)):
            left, right = np.repeat(p.images[c], len(p)), np.tile(p.images[d], len(p))
            out.append(np.stack([left, right])[:, (left >= 0) & (right >= 0)])
    i, j = np.concatenate(out, axis=1)
    return Pairs.make(i, j, "offsets", dropped=np.full(len(i), REASONS.index("axes")))
