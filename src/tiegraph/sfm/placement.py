"""The place of every frame is tested by its verified matches; doubtful frames are placed again, or left out.

A repeated wall can hold a frame, a block or a whole pass at a wrong place with ties that agree with each other, and a
bad start lets a frame slide along a straight path. The verified matches that the mapper had to reject reveal it: the
points that other frames made of them are not where this frame sees them (``verified``). A frame is in doubt if the
model rejects clearly more of its matches than it explains.

Frames are tested singly and in the groups that their agreeing ties join: each of three wrongly placed frames has most
of its ties with the other two, which agree. The continuity of a pass is no evidence: photographs of a yard are
numbered with jumps. Testing the neighbours on a pass first, asking for two agreeing frames or counting whole pairs by
the share that agrees finds no more (``slid.py`` in ``benchmarks/sfm/README.md``).

The mapper's model and a start are tested too. A wrongly placed part is moved as a whole by one similarity; single
doubtful frames, and frames without a place, are placed by their matches with the others (``run``). Only frames still
in doubt in the end are left out. A coarse model of ``seneca`` (167 photographs from a wing) had some at a wrong place,
which drew others after them: 159 were placed instead of 166. A section that slid, or a model that tore, is right within
itself. Its matches with the rest, whose points exist on both sides, determine how the two fit together. Placing it
frame by frame would lose everything beyond what the rest sees: of 90 frames of a corridor torn in the middle, 18 found
no place.

Where the matches support a second place so strongly that the first does not clearly win, the user must know both, and
the sigma of the frame must cover them.
"""

from collections.abc import Collection, Iterable, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
import pycolmap
from scipy.sparse import coo_array, csr_array, triu

from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import LEAST_PLACES, Similarity, robust_umeyama
from tiegraph.scene.colmapmodel import LEFT_OUT, matrix, rigid3d
from tiegraph.scene.evidence import LIMIT
from tiegraph.scene.graph import strongest_first
from tiegraph.scene.scene import Scene
from tiegraph.sfm.model import Findings
from tiegraph.sfm.ties import Ties, find_ties, fits, tested, together
from tiegraph.sfm.tuning.placement import ConsistencyTuning, PlacementTuning
from tiegraph.sfm.verified import (
    ImageObservations,
    MatchSource,
    VerifiedMatches,
    agreement,
    image_observations,
    pose_after,
    sightings,
    together_seen,
)
from tiegraph.text import some

_LEAST = 5  # frames in a table
_NAMED = 4  # frames named in a remark
_LEAST_M = 0.01  # sigma of a measured position, at least


Votes = tuple[csr_array, csr_array]
"""(F, F) matches between frames that a model explains, and that it contradicts, from the points of the row's frame."""


def consistency_votes(verified: VerifiedMatches, agreed: np.ndarray, scene: Scene) -> Votes:
    """Sum the votes of image pairs (``verified.agreement``) over pairs of frames."""
    first, second = scene.frame[verified.pairs].T
    apart = first != second
    at = np.concatenate([first, second]), np.concatenate([second, first])
    agree, against = (
        coo_array((np.tile(apart, 2) * v, at), (scene.frames, scene.frames)).tocsr()
        for v in (agreed[:, :2].T.ravel(), (agreed[:, 2:] - agreed[:, :2]).T.ravel())
    )
    return agree, against


def contradiction(
    frames: Collection[int], believed: np.ndarray, votes: Votes, least: float, ratio: float
) -> tuple[float, str]:
    """The excess of contradicting over agreeing matches between frames and trusted others (F,) bool, and the reason
    why that speaks against their place; "" if they are fewer than ``least`` or ``ratio`` times the agreeing ones."""
    others, own = believed.astype(float), list(frames)
    others[own] = 0
    agree, against = (float((table[own] @ others).sum()) for table in votes)
    doubtful = against >= least and against > ratio * agree
    why = f"most of its matches contradict its place in the model ({against:.0f} to {agree:.0f})" if doubtful else ""
    return against - agree, why


def suspect_frames(placed: Collection[int], votes: Votes, least: float, ratio: float) -> dict[tuple[int, ...], str]:
    """Placed frames whose matches contradict their place, with the reason: singly, or together with the frames they
    are tied to most. Frames with the most contradictions come first, because a pass at a wrong place makes every
    other frame contradict too. Never the larger half."""
    believed = np.zeros(votes[0].shape[0], bool)
    believed[list(placed)] = True
    half = max(1, len(placed) // 2)
    out: dict[tuple[int, ...], str] = {}
    asked = [[frame] for frame in sorted(placed)] + list(_groups(votes, believed, half))
    told = [(*contradiction(frames, believed, votes, least, ratio), frames) for frames in asked]
    for _, why, frames in sorted(told, key=lambda one: -one[0]):
        own = [f for f in frames if believed[f]]
        if not why or not 0 < len(own) <= max(1, int(believed.sum()) // 2):
            continue
        if why := contradiction(own, believed, votes, least, ratio)[1]:
            together = f", tested together with the {len(own) - 1} frames it is tied to most" if len(own) > 1 else ""
            out[tuple(own)] = why + together
            believed[own] = False
    return out


def _groups(votes: Votes, placed: np.ndarray, most: int) -> Iterator[list[int]]:
    """Groups of frames that agreeing ties join, up to this size."""
    strength = triu(votes[0] + votes[0].T, 1, format="coo")
    strength.eliminate_zeros()
    for group in strongest_first(strength.row, strength.col, strength.data, len(placed)):
        own = group[placed[group]].tolist()
        if 1 < len(own) <= most:
            yield own


@dataclass(frozen=True)
class Explained:
    """Which verified matches a model explains, by pair of images (``agreement``), and why frames are in doubt: single
    frames, and ``parts`` that are wrong together."""

    scene: Scene
    verified: VerifiedMatches
    seen: ImageObservations
    agreed: np.ndarray
    votes: Votes
    parts: Mapping[tuple[int, ...], str]
    tuning: ConsistencyTuning

    @property
    def doubts(self) -> dict[int, str]:
        """Reasons by frame."""
        return {f: why for frames, why in self.parts.items() for f in frames}

    def in_doubt(self, ratio: float) -> "Explained":
        """With the parts that so many times as many matches contradict as agree with."""
        placed = {int(self.scene.frame[k]) for k in self.seen.cameras}
        return replace(self, parts=suspect_frames(placed, self.votes, self.tuning.min_votes, ratio))

    def percent(self) -> float:
        """Percentage of the matches with a verdict that the model explains."""
        return float(50 * self.agreed[:, :2].sum() / max(self.agreed[:, 2].sum(), 1.0))

    def of_frames(self) -> np.ndarray:
        """(F, 2): explained matches of each frame with others, and all of them."""
        agree, against = (np.asarray(table.sum(axis=1)) for table in self.votes)
        return np.column_stack([agree, agree + against])

    def table(self) -> dict:
        """Table of the frames whose matches with others the model explains least."""
        matches = self.of_frames()
        share = matches[:, 0] / np.maximum(matches[:, 1], 1)
        least = [f for f in np.argsort(share, kind="stable").tolist() if matches[f, 1] > 0][:_LEAST]
        rows = [[self.scene.frame_names[f], int(matches[f, 1]), round(100 * float(share[f]), 1)] for f in least]
        return {"columns": ["frame", "matches", "explained %"], "rows": rows}


def explained(
    model: pycolmap.Reconstruction, scene: Scene, verified: VerifiedMatches, tuning: PlacementTuning
) -> Explained:
    """Test a model against all its verified matches."""
    seen = image_observations(model, scene, tuning.agreement)
    agreed = agreement(verified, seen)
    votes = consistency_votes(verified, agreed, scene)
    found = Explained(
        scene=scene, verified=verified, seen=seen, agreed=agreed, votes=votes, parts={}, tuning=tuning.consistency
    )
    return found.in_doubt(tuning.consistency.loses)


def leave_out_doubtful(
    model: pycolmap.Reconstruction, scene: Scene, source: MatchSource, tuning: PlacementTuning
) -> Findings:
    """Test the place of every frame and remove the doubtful ones from ``model``: none of them if they are more than
    ``tuning.max_left_out`` of all, because the model fell apart then. A contradiction tells if it may be torn."""
    found = explained(model, scene, source.read(scene), tuning)
    confirmed = confirmed_places(part_places(found, tuning), scene)[1]
    why = {f: reason for f, reason in sorted(found.doubts.items()) if f not in confirmed}
    if not why:
        return Findings()
    said = f"{len(why)} of {scene.frames} frames"
    if len(why) > tuning.max_left_out * scene.frames:
        many = f"{said} are at doubtful places; because they are so many, none is left out ({named(why, scene)})"
        return Findings([many])
    out = Findings([f"{said} were at a doubtful place and are left out; see the table of placement"])
    rows: list[list[str]] = []
    for frame, reason in why.items():
        names = [scene.names[k] for k in np.flatnonzero(scene.frame == frame)]
        for frame_id in frame_ids(model, scene, frame):
            model.deregister_frame(frame_id)
        rows.append([names[0], reason])
        out.dropped += [(name, f"{LEFT_OUT}{reason}") for name in names]
    out.contradictions += torn_told(found, why)
    out.tables["placement"] = {"columns": ["frame", "left out because"], "rows": rows}
    return out


def torn_told(found: Explained, left_out: Collection[int]) -> list[str]:
    """A sentence if some of the frames (scene indices) may be right, and frames that they agree with wrong."""
    undecided = set(left_out) - found.in_doubt(1 / found.tuning.agrees).doubts.keys()
    said = (
        f"{len(undecided)} of the frames left out ({named(undecided, found.scene)}) agree with one part of the model "
        "nearly as much as they contradict the rest: the model may be torn between the two, and its errors much "
        "larger than stated; compare it with measured positions or control points"
    )
    return [said] if undecided else []


def frame_ids(model: pycolmap.Reconstruction, scene: Scene, frame: int) -> list[int]:
    """The frames of COLMAP in the model that belong to a frame of the scene: without a rig one for each image."""
    names = [scene.names[k] for k in np.flatnonzero(scene.frame == frame)]
    there = [image for name in names if (image := model.find_image_with_name(name)) is not None]
    return sorted({image.frame_id for image in there if image.has_pose})


def named(frames: Iterable[int], scene: Scene) -> str:
    """The names of the first of some frames."""
    return some([scene.frame_names[f] for f in sorted(frames)], _NAMED)


@dataclass(frozen=True)
class Rival:
    """Another possible place of a frame: the ``step`` (3,) to it, model units, and the observations that agree here
    and there."""

    step: np.ndarray
    here: int
    there: int


def rivals(found: Explained) -> dict[int, Rival]:
    """By frame (scene index), places that matches support nearly as much as the present one, or more."""
    out, least = {}, found.tuning.agrees
    agree, all_ = found.of_frames().T
    for frame in np.flatnonzero(all_ - agree > least * agree).tolist():
        rival = _rival(found, frame)
        if rival is not None and rival.there > least * rival.here:
            out[frame] = rival
    return out


def rivals_told(found: Mapping[int, Rival], scene: Scene) -> list[str]:
    """A sentence on these frames, if there are any."""
    each = [
        f"{scene.frame_names[f]}: {r.here} matches agree with its place, {r.there} with a place "
        f"{np.linalg.norm(r.step):.3g} model units away"
        for f, r in found.items()
    ]
    said = f"the matches of {len(found)} frames support a second place too; their sigmas cover both places"
    return [f"{said} ({some(each, _NAMED)})"] if each else []


def _rival(found: Explained, frame: int) -> Rival | None:
    told, seen = sightings(found.verified, found.seen, frame), found.seen
    off = ~told.there
    images = sorted(set(told.image[off].tolist()))
    if off.sum() < found.tuning.min_votes:
        return None
    poses = [seen.cam_from_world[k] for k in images]
    cameras = [seen.cameras[k] for k in images]
    focal = float(np.median([c.mean_focal_length() for c in cameras]))
    options = pycolmap.RANSACOptions(random_seed=0, max_error=seen.tuning.tolerance_rad * focal)
    made = pycolmap.estimate_generalized_absolute_pose(
        told.xy[off], told.xyz[off], np.searchsorted(images, told.image[off]).tolist(),
        [rigid3d(p @ transforms.invert(poses[0])) for p in poses], cameras, options,
    )  # fmt: skip
    if made is None or made["num_inliers"] < found.tuning.min_votes:
        return None
    step = transforms.centre(matrix(made["rig_from_world"])) - transforms.centre(poses[0])
    return Rival(step, int(told.there.sum()), int(made["num_inliers"]))


@dataclass(frozen=True)
class PartPlace:
    """Another place of ``frames`` that are in doubt together: the similarity to it (``move``), the matches with the
    rest that agree with the present place (``here``) and with the other one (``there``), and for which of them the
    measured positions speak: 1 the other one, -1 the present one, 0 neither."""

    frames: tuple[int, ...]
    move: Similarity
    here: float
    there: float
    positions: int

    @property
    def wins(self) -> bool:
        """Whether the frames belong there."""
        return self.positions > 0 or (self.positions == 0 and self.there > self.here)


def placed_anew(
    model: pycolmap.Reconstruction, scene: Scene, verified: VerifiedMatches, tuning: PlacementTuning
) -> tuple[dict[int, pycolmap.Rigid3d], list[int]]:
    """For the frames in doubt, by COLMAP's ids: new poses of those that move, and frames to be removed because no
    place is found. None is removed if these are the larger half (a wrong rig), because the rest would be no
    reference."""
    found = explained(model, scene, verified, tuning)
    places = part_places(found, tuning)
    poses = {
        k: rigid3d(pose_after(matrix(pose), place.move))
        for place in places
        if place.wins
        for f in place.frames
        for k in frame_ids(model, scene, f)
        if (pose := model.frame(k).rig_from_world) is not None
    }
    left = found.doubts.keys() - {f for place in places if place.wins or place.positions for f in place.frames}
    few = 2 * len(left) <= len({int(scene.frame[k]) for k in found.seen.cameras})
    return poses, [k for f in sorted(left) for k in frame_ids(model, scene, f)] if few else []


def part_places(found: Explained, tuning: PlacementTuning) -> list[PartPlace]:
    """Of the parts in doubt those with another place that their matches to the rest support: the part with the most
    matches first, then others onto it. Of several places the one that measured positions confirm, else the one with
    most matches."""
    placed = {int(found.scene.frame[k]) for k in found.seen.cameras}
    parts = [tuple(placed - found.doubts.keys()), *(part for part in found.parts if len(part) > 1)]
    seen, done, out = [found.seen.alone(part) for part in parts], {0: Similarity()}, []
    ties: dict[int, list[Ties]] = {k: [] for k in range(1, len(parts))}
    best: dict[int, PartPlace] = {}
    latest = 0
    while True:
        rest = together_seen([seen[n].moved(place) for n, place in done.items()])
        for k, own in ties.items():
            if not len(new := find_ties(seen[latest], seen[k], found.verified, tuning)):
                continue
            own.append(new.moved(done[latest]))
            all_ = together(own)
            places = [
                _place(found, parts[k], rest, seen[k], fit.first_from_second)
                for fit in fits(all_, tuning)
                if tested(all_, fit, tuning).holds(tuning)
            ]
            if places:
                best[k] = max(places, key=lambda one: (one.positions > 0, one.positions < 0, one.there))
        if not best:
            return out
        latest = max(best, key=lambda k: best[k].there)
        out.append(best.pop(latest))
        done[latest] = out[-1].move if out[-1].wins else Similarity()
        del ties[latest]


def steps_of_parts(found: Explained, places: Iterable[PartPlace]) -> list[dict[int, np.ndarray]]:
    """For each part with another place that is not clearly worse, by frame (scene index) the offset (3,) to it, model
    units."""
    centre, least = _centres(found), found.tuning.agrees
    open_ = [p for p in places if p.positions > 0 or (not p.positions and p.there > least * p.here)]
    return [{f: place.move(centre[f][None])[0] - centre[f] for f in place.frames} for place in open_]


def confirmed_places(places: Iterable[PartPlace], scene: Scene) -> tuple[list[str], set[int]]:
    """Frames (scene indices) that matches support another place for, but measured positions confirm; a remark."""
    sure = {f for place in places if place.positions < 0 for f in place.frames}
    said = (
        f"the matches of {len(sure)} frames support a second place too; the measured positions confirm the one they "
        f"have ({named(sure, scene)})"
    )
    return [said] if sure else [], sure


def _place(
    found: Explained, frames: tuple[int, ...], rest: ImageObservations, part: ImageObservations, move: Similarity
) -> PartPlace:
    inside = np.isin(found.scene.frame[found.verified.pairs], frames)
    between = found.verified.where(inside[:, 0] != inside[:, 1])
    here, there = (
        float(agreement(between, together_seen([rest, part.moved(place)]))[:, :2].sum() / 2)
        for place in (Similarity(), move)
    )
    positions = _by_positions(found, frames, move)
    return PartPlace(frames=frames, move=move, here=here, there=there, positions=positions)


def _by_positions(found: Explained, frames: Collection[int], move: Similarity) -> int:
    """Whether the measured positions of a part fit clearly better to another place than to the present one (1), the
    other way round (-1), or do not decide (0): by the median error in sigmas, with the whole fitted to them."""
    scene, centre = found.scene.measured(), _centres(found)
    position, sigma = scene.world_from_rig[:, :3, 3], np.nanmax(scene.position_sigma_m, axis=1, initial=_LEAST_M)
    known = np.isfinite(centre[:, 0]) & np.isfinite(position[:, 0])
    part = np.isin(np.arange(len(known)), list(frames))[known]
    if min(part.sum(), (~part).sum()) < LEAST_PLACES:
        return 0
    off = []
    for place in (Similarity(), move):
        there = np.where(part[:, None], place(centre[known]), centre[known])
        fit = robust_umeyama(there, position[known], sigma[known])[0]
        off.append(float(np.median((np.linalg.norm(fit(there) - position[known], axis=1) / sigma[known])[part])))
    here, other = (max(z, 1.0) for z in off)
    return int(here > LIMIT * other) - int(other > LIMIT * here)


def _centres(found: Explained) -> np.ndarray:
    """(F, 3) position of each frame, of its first camera; NaN = none."""
    out = np.full((found.scene.frames, 3), np.nan)
    for k in sorted(found.seen.cameras, key=lambda k: -int(found.scene.sensor[k])):
        out[found.scene.frame[k]] = transforms.centre(found.seen.cam_from_world[k])
    return out
