"""Whether a prior may be believed: a sample of pairs it proposes and refuses is previewed, so that a wrong prior (other
axes, inverted poses, mirrored, shifted in time) is noticed and loses no pair silently.

Of each kind of pairs (near in sequence, same pass, other pass, loose) 40 that the prior proposes and 40 that it
refuses are previewed. A prior whose refused pairs tie more than 0.6 times as often as the proposed ones, or not
significantly less, is not believed: it then refuses nothing, and previews and order find the pairs as if there were
no prior. What a prior hardly proposes (passes whose trajectories were put far apart) must tie no more often than what
it refuses elsewhere. Where only the pairs of other passes fail, each trajectory is right by itself and only its place
among the others is not: it then counts within its own pass alone, as odometry does, and previews find the pairs
between the passes.

Nor is a prior believed if another reading of it (other axes, inverted, mirrored, some frames early or late) predicts
the same previews better. Two tests must agree for that. The predicted overlap correlates better with the number of
matches (rank correlation, by 0.04, and 0.45 in all). It also separates the pairs that tie from the others better (area
under the ROC curve, by 0.03): for cameras that look along the path the correlation alone is best for whatever falls
with the distance. The reading is named with its remedy, and whether it may be chance (Student's t over the pairs' parts
in the correlations). The assumed range is part of this: at a tenth any reading that compresses the path is better.
"""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, fields, replace

import numpy as np

from tiegraph.geometry import transforms
from tiegraph.network.coarse.pairshare import pair_share
from tiegraph.network.passes import MatchCache, Pass
from tiegraph.network.poses.poses import PoseResult, pose_pairs, prior_views, view_cameras, with_headings
from tiegraph.network.settings import CandidatesSettings
from tiegraph.network.tuning import PriorTuning, Tuning
from tiegraph.scene.evidence import RARELY, mostly_more
from tiegraph.scene.pairs import Pairs, pair_key
from tiegraph.scene.scene import Scene

KINDS = ("near in sequence", "same pass", "other pass", "loose photographs")
OTHER_PASS = 2
# rig axes (columns) in the axes the trajectory may use instead of the camera's x right, y down, z forward
_AXES = {
    "its axes are x forward, y left, z up (vehicle, ROS)": np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]),
    "its axes are x forward, y right, z down (NED)": np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]),
    "its axes are x right, y up, z backward (OpenGL)": np.diag([1.0, -1, -1]),
}
_RIG_AXES = {"(vehicle, ROS)": "flu", "(NED)": "frd"}  # what a rig file calls them

Reading = Callable[[np.ndarray, Sequence[Pass]], np.ndarray]


@dataclass(frozen=True)
class PriorCheck:
    """How good a prior is, by previews: ``good``; where it is not, ``apart`` says that it is good within each pass.

    ``fit`` = rank correlation of predicted overlap and preview matches (NaN = cannot be said); ``better``: the reading
    that fits better, "" = none.
    """

    good: bool
    apart: bool
    fit: float
    better: str
    notes: tuple[str, ...]


def checked_pose_pairs(
    scene: Scene, passes: Sequence[Pass], cache: MatchCache, settings: CandidatesSettings, tuning: Tuning
) -> PoseResult:
    """``pose_pairs``, checked. A bad prior refuses nothing: all its frames count as without prior (``world``), its
    proposals stay, and so do all sampled pairs that tie. One that is bad between passes alone says nothing of them."""
    result = pose_pairs(scene, passes, settings, tuning)
    if not len(result.pairs):
        return result
    check = check_prior(scene, passes, cache, result, settings, tuning)
    if check.good:
        return replace(result, notes=(*result.notes, *check.notes))
    pairs, sequence = result.pairs, scene.sequence[scene.frame]
    tied = cache.known(pairs.i, pairs.j) >= tuning.counts.sure * settings.min_matches
    if check.apart:
        world = np.where(result.world >= 0, scene.sequence, -1)
        bad = sequence[pairs.i] != sequence[pairs.j]
        keep = ~bad | tied
    else:
        world = np.full(scene.frames, -1)
        bad = np.ones(len(pairs), bool)
        keep = (pairs.dropped == 0) | tied
    pairs = pairs.with_(dropped=np.where(bad, 0, pairs.dropped)).where(keep)
    return replace(result, pairs=pairs, world=world, notes=(*result.notes, *check.notes), apart=check.apart)


def check_prior(
    scene: Scene,
    passes: Sequence[Pass],
    cache: MatchCache,
    result: PoseResult,
    settings: CandidatesSettings,
    tuning: Tuning,
) -> PriorCheck:
    """Preview a sample of what a prior proposes and refuses, and compare with other readings of the same prior."""
    drawn = _sample(scene, result.pairs, tuning.poses.prior)
    i, j, kind = drawn.i, drawn.j, drawn.kind
    count = cache.measure(i, j) if len(i) else np.zeros(0)
    tied = count >= tuning.counts.sure * settings.min_matches
    rows = [(k, _counts(drawn.proposed[kind == k], tied[kind == k])) for k in range(len(KINDS)) if np.any(kind == k)]
    fit, better = _readings(scene, passes, (i, j, count, tied, kind), result.range_m, tuning)
    bad = [KINDS[k] for k, counts in rows if not _tells(counts, _others(rows, k), tuning.poses.prior)]
    table = tuple((KINDS[k], c.proposed, c.tied, c.refused, c.lost) for k, c in rows)
    apart = bad == [KINDS[OTHER_PASS]] and not better.name and bool((scene.sequence >= 0).all())
    notes = _apart_notes(scene, table) if apart else _notes(table, bad, fit, better)
    good = not bad and not better.name
    return PriorCheck(good=good, apart=apart, fit=fit, better=better.name, notes=notes)


@dataclass(frozen=True)
class _Better:
    """A reading of a prior ("" = none) that fits the previews better; ``sure``: chance would hardly do that."""

    name: str = ""
    fit: float = float("nan")
    sure: bool = False


@dataclass(frozen=True)
class _Sample:
    """Pairs i, j (K,) to preview, whether the prior proposes them, and their kind."""

    i: np.ndarray
    j: np.ndarray
    proposed: np.ndarray
    kind: np.ndarray


def _sample(scene: Scene, pairs: Pairs, tuning: PriorTuning) -> _Sample:
    """Some pairs of each kind.

    Refused are also pairs too far apart to be listed, drawn from all pairs of images with a prior position.
    """
    rng = np.random.default_rng(0)
    placed = np.flatnonzero(np.isin(scene.frame, np.flatnonzero(scene.pose_world() >= 0)))
    a, b = rng.choice(placed, tuning.drawn), rng.choice(placed, tuning.drawn)
    i, j = np.concatenate([pairs.i, np.minimum(a, b)]), np.concatenate([pairs.j, np.maximum(a, b)])
    offered = np.concatenate([pairs.dropped == 0, np.zeros(len(a), bool)])
    world = scene.pose_world()[scene.frame]
    _, first = np.unique(pair_key(i, j), return_index=True)
    first = first[(scene.frame[i[first]] != scene.frame[j[first]]) & (world[i[first]] == world[j[first]])]
    i, j, offered = i[first], j[first], offered[first]
    kind = _kind(scene, i, j, tuning.near_steps)
    rows = [np.zeros(0, int)]
    for k in range(len(KINDS)):
        for side in (True, False):
            of_kind = np.flatnonzero((kind == k) & (offered == side))
            rows.append(rng.choice(of_kind, min(tuning.sample, len(of_kind)), replace=False))
    take = np.sort(np.concatenate(rows))
    return _Sample(i=i[take], j=j[take], proposed=offered[take], kind=kind[take])


def _kind(scene: Scene, i: np.ndarray, j: np.ndarray, near_steps: int) -> np.ndarray:
    """(K,) index into KINDS."""
    sequence, step = scene.sequence[scene.frame], scene.sequence_index[scene.frame]
    same = (sequence[i] == sequence[j]) & (sequence[i] >= 0)
    near = same & (np.abs(step[i] - step[j]) <= near_steps)
    loose = (sequence[i] < 0) & (sequence[j] < 0)
    return np.where(near, 0, np.where(same, 1, np.where(loose, 3, 2)))


@dataclass(frozen=True)
class _Counts:
    """Pairs that a prior proposes and those of them that tie; pairs that it refuses and those of them that tie."""

    proposed: int
    tied: int
    refused: int
    lost: int


def _counts(proposed: np.ndarray, tied: np.ndarray) -> _Counts:
    return _Counts(
        proposed=int(proposed.sum()),
        tied=int((proposed & tied).sum()),
        refused=int((~proposed).sum()),
        lost=int((~proposed & tied).sum()),
    )


def _others(rows: list[tuple[int, _Counts]], kind: int) -> _Counts:
    """All other kinds together."""
    others = [c for k, c in rows if k != kind]
    return _Counts(*(sum(getattr(c, f.name) for c in others) for f in fields(_Counts)))


def _tells(counts: _Counts, others: _Counts, tuning: PriorTuning) -> bool:
    """Whether a prior knows something of a kind of pairs: what it refuses ties much more rarely than what it proposes;
    where it proposes hardly any, not more often than what it refuses of the ``others``.

    With too few pairs or ties nothing speaks against it.
    """
    proposed, tied, refused, lost = counts.proposed, counts.tied, counts.refused, counts.lost
    if refused < tuning.enough or tied + lost < tuning.few_ties:
        return True
    if proposed < tuning.enough:
        more = _significance((lost, refused), (others.lost, others.refused))
        return others.refused < tuning.enough or more < tuning.lost_sigmas
    significant = _significance((tied, proposed), (lost, refused)) > tuning.sigmas
    return significant and lost / refused < tuning.bad_ratio * tied / proposed


def _significance(first: tuple[int, int], second: tuple[int, int]) -> float:
    """By how many standard deviations the share of ties, (ties, pairs), is larger in the first than in the second."""
    (a, of_a), (b, of_b) = first, second
    mean = (a + b) / (of_a + of_b)
    error = np.sqrt(mean * (1 - mean) * (1 / of_a + 1 / of_b))
    return float((a / of_a - b / of_b) / max(error, 1e-12))


def _readings(
    scene: Scene, passes: Sequence[Pass], sample: tuple[np.ndarray, ...], range_m: float, tuning: Tuning
) -> tuple[float, _Better]:
    """How well the prior as given predicts the previews, and the reading that does it better.

    Cameras that look along the path share nearly all of their pictures with all near frames, right or not: there the
    number of matches falls with the distance alone, and any reading that does so too has the better correlation (KITTI:
    0.85 for axes that are wrong, 0.39). It tells no better which pairs tie, so this is asked too.
    """
    (i, j, count, tied, kind), prior = sample, tuning.poses.prior
    given = _share(scene, passes, scene.world_from_rig, (i, j), range_m, tuning)
    before = _parts(given, count, kind, prior.enough)
    if not before:
        return float("nan"), _Better()
    fit, fits, gains, tells = _fit(before), {}, {}, _area(given, tied, kind, prior.few_ties)
    readings = _possible(scene.has_orientations(), prior.shifts_frames)
    for name, read in readings.items():
        share = _share(scene, passes, read(np.array(scene.world_from_rig), passes), (i, j), range_m, tuning)
        share = np.where(np.isfinite(given), np.nan_to_num(share), np.nan)
        if not _area(share, tied, kind, prior.few_ties) < tells + prior.better_tells:
            after = _parts(share, count, kind, prior.enough)
            fits[name], gains[name] = _fit(after), np.concatenate(after) - np.concatenate(before)
    best = max(fits.values(), default=fit)
    if not best > fit + prior.better or best < prior.sure_fit:
        return fit, _Better()
    alike = [n for n, f in fits.items() if f > best - prior.alike][:2]
    return fit, _Better(" or ".join(alike), best, all(mostly_more(gains[n], len(readings)) for n in alike))


def _possible(oriented: bool, shifts: Sequence[int]) -> dict[str, Reading]:
    """The likely mistakes by what to say about them."""
    out: dict[str, Reading] = {}
    if oriented:
        out["it holds world-to-camera poses (expected: camera-to-world)"] = _inverted
        out.update({name: _turned(axes) for name, axes in _AXES.items()})
    for letter, mirror in zip("xyz", (np.diag([-1.0, 1, 1]), np.diag([1.0, -1, 1]), np.diag([1.0, 1, -1]))):
        if oriented or letter != "z":
            out[f"its positions are mirrored in {letter}"] = _mirrored(mirror)
    for step in shifts:
        out[f"it is {abs(step)} frames too {'early' if step < 0 else 'late'}"] = _shifted(step)
    return out


def _inverted(poses: np.ndarray, passes: Sequence[Pass]) -> np.ndarray:
    return np.where(np.all(np.isfinite(poses[:, :3]), axis=(1, 2))[:, None, None], transforms.invert(poses), np.nan)


def _turned(axes: np.ndarray) -> Reading:
    return lambda poses, passes: _with_rotation(poses, poses[:, :3, :3] @ axes)


def _mirrored(mirror: np.ndarray) -> Reading:
    """Positions alone: where rotations are mirrored too, the same pairs overlap."""

    def read(poses: np.ndarray, passes: Sequence[Pass]) -> np.ndarray:
        out = poses.copy()
        out[:, :3, 3] = poses[:, :3, 3] @ mirror
        return out

    return read


def _with_rotation(poses: np.ndarray, rotation: np.ndarray) -> np.ndarray:
    out = poses.copy()
    out[:, :3, :3] = rotation
    return out


def _shifted(step: int) -> Reading:
    """Each frame takes the pose ``step`` frames later; beyond the ends of a pass it goes on as it did there."""

    def read(poses: np.ndarray, passes: Sequence[Pass]) -> np.ndarray:
        out = poses.copy()
        for p in passes:
            if len(p) < 2:
                continue
            at = np.arange(len(p)) + step
            inside = np.clip(at, 0, len(p) - 1)
            own = poses[p.frames]
            way = np.where((at < 0)[:, None], own[1, :3, 3] - own[0, :3, 3], own[-1, :3, 3] - own[-2, :3, 3])
            out[p.frames] = own[inside]
            out[p.frames, :3, 3] += (at - inside)[:, None] * way
        return out

    return read


def _share(
    scene: Scene,
    passes: Sequence[Pass],
    poses: np.ndarray,
    pairs: tuple[np.ndarray, np.ndarray],
    range_m: float,
    tuning: Tuning,
) -> np.ndarray:
    """(K,) predicted overlap of pairs by a reading of the prior."""
    read = scene.with_(world_from_rig=poses)
    full, headings = with_headings(read, passes, tuning)
    pose = prior_views(read, full, headings, passes).pose
    return pair_share(transforms.invert(pose), view_cameras(scene, tuning.poses), *pairs, range_m, tuning.coarse)


def _parts(share: np.ndarray, count: np.ndarray, kind: np.ndarray, enough: int) -> list[np.ndarray]:
    """What each pair adds to the rank correlation of predicted overlap and preview matches, by kind, with enough."""
    there = [(kind == k) & np.isfinite(share) for k in range(len(KINDS))]
    there = [rows for rows in there if rows.sum() >= 2 * enough and np.ptp(count[rows]) > 0]
    return [_ranks(share[rows]) * _ranks(count[rows]) for rows in there]


def _ranks(values: np.ndarray) -> np.ndarray:
    """(K,) ranks about zero and of unit spread; zeros where all are alike."""
    from scipy.stats import rankdata  # a second to load

    rank = rankdata(values) - (len(values) + 1) / 2
    return np.asarray(rank / max(float(np.std(rank)), 1e-12))


def _fit(parts: list[np.ndarray]) -> float:
    """Rank correlation, mean over the kinds."""
    return float(np.mean([np.mean(p) for p in parts]))


def _area(share: np.ndarray, tied: np.ndarray, kind: np.ndarray, few: int) -> float:
    """Chance that a pair that ties has a larger predicted overlap than one that does not (area under the ROC curve),
    mean over the kinds; NaN = too few to say."""
    from scipy.stats import mannwhitneyu  # a second to load

    found = []
    for k in range(len(KINDS)):
        there = (kind == k) & np.isfinite(share)
        yes, no = share[there & tied], share[there & ~tied]
        if min(len(yes), len(no)) >= few:
            found.append(float(mannwhitneyu(yes, no).statistic) / (len(yes) * len(no)))
    return float(np.mean(found)) if found else float("nan")


def _apart_notes(scene: Scene, table: tuple) -> tuple[str, ...]:
    told = _table_note(table)
    passes = ", ".join(scene.sequences[k] for k in np.unique(scene.sequence))
    return (
        told,
        f"the poses of the passes ({passes}) do not stand in one world: images of different passes tie where their "
        "poses say that they share nothing. They count within each pass only, as odometry that starts anew does; "
        "previews find the pairs between the passes",
    )


def _table_note(table: tuple) -> str:
    parts = "; ".join(f"{name}: {pt} of {p} and {rt} of {r}" for name, p, pt, r, rt in table)
    return f"prior checked by previews, ties among pairs it proposes and among pairs it refuses: {parts}"


def _notes(table: tuple, bad: list[str], fit: float, better: _Better) -> tuple[str, ...]:
    if not table:
        return ()
    notes = [_table_note(table)]
    if better.name:
        doubt, chance = ("looks", RARELY) if better.sure else ("may be", "which may be chance")
        notes.append(
            f"the prior {doubt} wrong: {better.name}. Read so, its predicted overlap and the preview matches correlate "
            f"by {better.fit:.2f}, as given by {fit:.2f}, {chance}. {_remedy(better.name)}"
        )
    if bad or better.name:
        where = f" ({', '.join(bad)}: the pairs it refuses tie about as often as those it proposes)" if bad else ""
        notes.append(f"the prior is not believed{where}: it refuses nothing, previews and order find the pairs")
    return tuple(notes)


def _remedy(better: str) -> str:
    """What a user can do about a reading that fits better."""
    code = next((code for said, code in _RIG_AXES.items() if said in better), "")
    if not code:
        return "Check the trajectory"
    return (
        "The trajectory seems to follow a vehicle, the rig stands in the axes of its first camera. Say so in a "
        f'rig.toml (`tiegraph init` writes one to edit): axes = "{code}", every yaw_pitch_roll_deg counted from the '
        "vehicle's forward direction, every position_m in its axes; or turn the poses into the camera's axes (x right, "
        "y down, z forward)"
    )
