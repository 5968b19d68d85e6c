"""Check of a prior: a sample of pairs that it proposes and refuses is previewed, so that a wrong prior (other axes,
inverted poses, mirrored, shifted in time) is detected and loses no pair silently.

Of each kind of pairs (near in sequence, same pass, other pass, loose) proposed and refused ones are previewed. A prior
whose refused pairs tie about as often as the proposed ones is rejected: it then refuses nothing, and previews and order
find the pairs. If only the pairs of different passes fail, each trajectory is correct by itself but not its place among
the others: it is then used within its own pass only, as odometry is.

A prior is also rejected if another reading of it (other axes, inverted, mirrored, some frames early or late) predicts
the same previews better, by the rank correlation of predicted overlap and matches and by the area under the ROC curve:
for cameras that look along the path the correlation alone is best for anything that falls with the distance (KITTI:
0.85 for wrong axes, 0.39 for the right ones). The note names the reading, its remedy, and whether it may be chance
(Student's t). The assumed range matters: at a tenth of it any reading that compresses the path is better.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tiegraph.geometry import transforms
from tiegraph.network.coarse.visible import pair_share
from tiegraph.network.passes import Context, Pass
from tiegraph.network.poses import PoseResult, pose_pairs, prior_views, view_cameras, with_headings
from tiegraph.scene.evidence import ENOUGH, LIMIT, RARELY, mostly_more
from tiegraph.scene.pairs import Pairs, pair_key
from tiegraph.scene.scene import Scene
from tiegraph.scene.sorting import Columns

KINDS = ("near in sequence", "same pass", "other pass", "loose photographs")
OTHER_PASS = 2
# Axes that the trajectory may use instead of the camera's x right, y down, z forward: rig axes (columns) in these,
# and their name in a rig file
_AXES = {
    "its axes are x forward, y left, z up (vehicle, ROS)": (np.array([[0.0, 0, 1], [-1, 0, 0], [0, -1, 0]]), "flu"),
    "its axes are x forward, y right, z down (NED)": (np.array([[0.0, 0, 1], [1, 0, 0], [0, 1, 0]]), "frd"),
    "its axes are x right, y up, z backward (OpenGL)": (np.diag([1.0, -1, -1]), ""),
}


@dataclass(frozen=True)
class PriorCheck:
    """The quality of a prior according to previews: ``good``; if not, ``apart`` says that it is good within each pass.

    ``fit`` = rank correlation of predicted overlap and preview matches (NaN = unknown); ``better``: the reading that
    fits better, "" = none.
    """

    good: bool
    apart: bool
    fit: float
    better: str
    notes: tuple[str, ...]


def checked_pose_pairs(context: Context) -> PoseResult:
    """``pose_pairs``, checked. A bad prior refuses nothing: all its frames count as without prior (``world``), its
    proposals are kept, and so are all sampled pairs that tie. A prior that is bad only between passes is not used
    there."""
    scene = context.scene
    result = pose_pairs(scene, context.passes, context.settings, context.tuning)
    if not len(result.pairs):
        return result
    check = check_prior(context, result)
    if check.good:
        return replace(result, notes=(*result.notes, *check.notes))
    pairs, sequence = result.pairs, scene.sequence[scene.frame]
    tied = context.cache.known(pairs.i, pairs.j) >= context.tuning.counts.sure * context.settings.min_matches
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


def check_prior(context: Context, result: PoseResult) -> PriorCheck:
    """Preview a sample of the pairs that a prior proposes and refuses, and compare with other readings of the same
    prior."""
    scene, tuning = context.scene, context.tuning
    sure = context.tuning.counts.sure * context.settings.min_matches
    sample = _sample(context, result.pairs, sure)
    # By kind: pairs proposed, number that tie, pairs refused, number that tie
    sides = (sample.proposed, sample.proposed & sample.tied, ~sample.proposed, ~sample.proposed & sample.tied)
    table = np.stack([np.bincount(sample.kind[side], minlength=len(KINDS)) for side in sides], axis=1)
    there = np.flatnonzero(table.any(axis=1))
    bad = [k for k in there if not _tells(table[k], table.sum(axis=0) - table[k], tuning.verdict.tells_nothing)]
    fit, better = _readings(context, sample, result.range_m)
    apart = bad == [OTHER_PASS] and not better.names and bool((scene.sequence >= 0).all())
    notes = _notes(table[there], [KINDS[k] for k in there], [KINDS[k] for k in bad], fit, better)
    if apart:
        names = ", ".join(scene.sequences[k] for k in np.unique(scene.sequence))
        said = (
            f"the poses of the passes ({names}) are not in one world: images of different passes tie although they "
            "share nothing according to their poses. The poses are used within each pass only, as those of separate "
            "odometry; previews find the pairs between the passes"
        )
        notes = (notes[0], said)
    good = not bad and not better.names
    return PriorCheck(good=good, apart=apart, fit=fit, better=" or ".join(better.names), notes=notes)


@dataclass(frozen=True)
class _Sample(Columns):
    """Previewed pairs i, j (K,): whether the prior proposes them, their kind, preview matches, and whether they tie."""

    i: np.ndarray
    j: np.ndarray
    proposed: np.ndarray
    kind: np.ndarray
    count: np.ndarray
    tied: np.ndarray


def _sample(context: Context, pairs: Pairs, sure: float) -> _Sample:
    """Some pairs of each kind; refused ones also from those too far apart to be listed."""
    scene, most = context.scene, context.tuning.verdict.sample
    rng = np.random.default_rng(0)
    world = scene.pose_world()[scene.frame]
    placed = np.flatnonzero(world >= 0)
    a, b = rng.choice(placed, (2, len(pairs)))  # as many as are listed
    i, j = np.concatenate([pairs.i, np.minimum(a, b)]), np.concatenate([pairs.j, np.maximum(a, b)])
    offered = np.concatenate([pairs.dropped == 0, np.zeros(len(a), bool)])
    _, first = np.unique(pair_key(i, j), return_index=True)
    first = first[(scene.frame[i[first]] != scene.frame[j[first]]) & (world[i[first]] == world[j[first]])]
    i, j, offered = i[first], j[first], offered[first]
    sequence, step = scene.sequence[scene.frame], scene.sequence_index[scene.frame]
    same = (sequence[i] == sequence[j]) & (sequence[i] >= 0)
    near = same & (np.abs(step[i] - step[j]) <= context.tuning.coarse.near_steps)
    loose = (sequence[i] < 0) & (sequence[j] < 0)
    kind = np.where(near, 0, np.where(same, 1, np.where(loose, 3, OTHER_PASS)))
    groups = [np.flatnonzero((kind == k) & (offered == side)) for k in range(len(KINDS)) for side in (True, False)]
    take = np.sort(np.concatenate([rng.choice(g, min(most, len(g)), replace=False) for g in groups]))
    i, j = i[take], j[take]
    count = context.cache.measure(i, j) if len(i) else np.zeros(0)
    return _Sample(i=i, j=j, proposed=offered[take], kind=kind[take], count=count, tied=count >= sure)


def _tells(counts: np.ndarray, others: np.ndarray, most: float) -> bool:
    """Whether refused pairs of a kind tie much more rarely than proposed ones, or if hardly any is proposed, not more
    often than refused ones of the ``others``; yes with too few pairs or ties. Both (4,) as in the table."""
    proposed, tied, refused, lost = counts.tolist()
    if refused < ENOUGH or tied + lost < ENOUGH:
        return True
    if proposed < ENOUGH:
        more = _significance((lost, refused), (others[3], others[2]))
        return others[2] < ENOUGH or more < LIMIT
    significant = _significance((tied, proposed), (lost, refused)) > LIMIT
    return significant and lost / refused < most * tied / proposed


def _significance(first: tuple[int, int], second: tuple[int, int]) -> float:
    """Difference of the shares of ties, (ties, pairs), first minus second, in standard deviations."""
    (a, of_a), (b, of_b) = first, second
    mean = (a + b) / max(of_a + of_b, 1)
    error = np.sqrt(mean * (1 - mean) * (1 / of_a + 1 / max(of_b, 1)))
    return float((a / of_a - b / max(of_b, 1)) / max(error, 1e-12))


# --- other readings ---------------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class _Better:
    """Readings of a prior that fit the previews better; ``sure``: chance is unlikely."""

    names: tuple[str, ...] = ()
    fit: float = float("nan")
    sure: bool = False


def _readings(context: Context, sample: _Sample, range_m: float) -> tuple[float, _Better]:
    """The agreement of the prior as given with the previews, and the reading with a better one."""
    scene, passes, prior = context.scene, context.passes, context.tuning.verdict
    given = _share(context, scene.world_from_rig, sample, range_m)
    before = _parts(given, sample)
    if not before:
        return float("nan"), _Better()
    fit, tells = _fit(before), _area(given, sample)
    fits, gains, tried = {}, {}, 0
    for name, poses in _possible(scene, passes, prior.shifts_frames):
        tried += 1
        share = _share(context, poses, sample, range_m)
        share = np.where(np.isfinite(given), np.nan_to_num(share), np.nan)
        if not _area(share, sample) < tells + prior.alike:
            after = _parts(share, sample)
            fits[name], gains[name] = _fit(after), np.concatenate(after) - np.concatenate(before)
    best = max(fits.values(), default=fit)
    if not best > fit + prior.alike or best < prior.agreement:
        return fit, _Better()
    alike = tuple(n for n, f in fits.items() if f > best - prior.alike)[:2]
    return fit, _Better(alike, best, all(mostly_more(gains[n], tried) for n in alike))


def _possible(scene: Scene, passes: Sequence[Pass], shifts: Sequence[int]) -> Iterator[tuple[str, np.ndarray]]:
    """The likely mistakes: their description, and the poses (F, 4, 4) without them."""
    poses, oriented = np.array(scene.world_from_rig), scene.has_orientations()
    if oriented:
        known = np.asarray(np.isfinite(poses[:, :3]).all(axis=(1, 2)))
        inverted = np.where(known[:, None, None], transforms.invert(poses), np.nan)
        yield "it holds world-to-camera poses (expected: camera-to-world)", inverted
        for name, (axes, _) in _AXES.items():
            turned = poses.copy()
            turned[:, :3, :3] = poses[:, :3, :3] @ axes
            yield name, turned
    for k, letter in enumerate("xyz" if oriented else "xy"):
        mirrored = poses.copy()
        mirrored[:, k, 3] *= -1  # positions only: if rotations are mirrored too, the same pairs overlap
        yield f"its positions are mirrored in {letter}", mirrored
    for step in shifts:
        name = f"it is {abs(step)} frames too {'early' if step < 0 else 'late'}"
        yield name, _shifted(poses, [p.frames for p in passes if len(p) > 1], step)


def _shifted(poses: np.ndarray, passes: Sequence[np.ndarray], step: int) -> np.ndarray:
    """Each frame takes the pose ``step`` frames later; beyond the ends of a pass the last motion continues."""
    out = poses.copy()
    for frames in passes:
        at, own = np.arange(len(frames)) + step, poses[frames]
        inside = np.clip(at, 0, len(frames) - 1)
        way = np.where((at < 0)[:, None], own[1, :3, 3] - own[0, :3, 3], own[-1, :3, 3] - own[-2, :3, 3])
        out[frames] = own[inside]
        out[frames, :3, 3] += (at - inside)[:, None] * way
    return out


def _share(context: Context, poses: np.ndarray, sample: _Sample, range_m: float) -> np.ndarray:
    """(K,) predicted overlap of pairs by a reading of the prior."""
    passes, tuning, read = context.passes, context.tuning, context.scene.with_(world_from_rig=poses)
    full, headings = with_headings(read, passes)
    cam_from_world = transforms.invert(prior_views(read, full, headings, passes).pose)
    cameras = view_cameras(read, tuning.coarse.visible)
    return pair_share(cam_from_world, cameras, sample.i, sample.j, range_m, tuning.coarse)


def _parts(share: np.ndarray, sample: _Sample) -> list[np.ndarray]:
    """The part of each pair in the rank correlation of predicted overlap and matches, kind by kind."""
    from scipy.stats import rankdata  # a second to load

    def ranks(values: np.ndarray) -> np.ndarray:
        rank = rankdata(values) - (len(values) + 1) / 2
        return np.asarray(rank / max(float(np.std(rank)), 1e-12))

    there = [(sample.kind == k) & np.isfinite(share) for k in range(len(KINDS))]
    there = [rows for rows in there if rows.sum() >= 2 * ENOUGH and np.ptp(sample.count[rows]) > 0]
    return [ranks(share[rows]) * ranks(sample.count[rows]) for rows in there]


def _fit(parts: list[np.ndarray]) -> float:
    """Rank correlation, mean over the kinds."""
    return float(np.mean([np.mean(p) for p in parts]))


def _area(share: np.ndarray, sample: _Sample) -> float:
    """Probability that a pair that ties has more predicted overlap than one that does not, mean over the kinds (area
    under the ROC curve); NaN = too few pairs."""
    from scipy.stats import mannwhitneyu  # a second to load

    found = []
    for k in range(len(KINDS)):
        there = (sample.kind == k) & np.isfinite(share)
        yes, no = share[there & sample.tied], share[there & ~sample.tied]
        if min(len(yes), len(no)) >= ENOUGH:
            found.append(float(mannwhitneyu(yes, no).statistic) / (len(yes) * len(no)))
    return float(np.mean(found)) if found else float("nan")


def _notes(table: np.ndarray, kinds: list[str], bad: list[str], fit: float, better: _Better) -> tuple[str, ...]:
    """The notes; ``table`` (K, 4) of the ``kinds`` present."""
    if not len(table):
        return ()
    rows = "; ".join(f"{name}: {pt} of {p} and {rt} of {r}" for name, (p, pt, r, rt) in zip(kinds, table.tolist()))
    notes = [f"prior checked by previews, ties among pairs it proposes and among pairs it refuses: {rows}"]
    if better.names:
        doubt, chance = ("looks", RARELY) if better.sure else ("may be", "which may be chance")
        notes.append(
            f"the prior {doubt} wrong: {' or '.join(better.names)}. With that reading its predicted overlap and the "
            f"preview matches have a correlation of {better.fit:.2f}, as given of {fit:.2f}, {chance}. "
            f"{_remedy(better.names)}"
        )
    if bad or better.names:
        where = f" ({', '.join(bad)}: the pairs it refuses tie about as often as those it proposes)" if bad else ""
        notes.append(f"the prior is not used{where}: it refuses no pair, previews and order find the pairs")
    return tuple(notes)


def _remedy(names: Sequence[str]) -> str:
    """The remedy for readings that fit better."""
    code = next((_AXES[n][1] for n in names if n in _AXES and _AXES[n][1]), "")
    if not code:
        return "Check the trajectory"
    return (
        "The trajectory seems to follow a vehicle, the rig stands in the axes of its first camera. Say so in a "
        f'rig.toml (`tiegraph init` writes one to edit): axes = "{code}", every yaw_pitch_roll_deg counted from the '
        "vehicle's forward direction, every position_m in its axes; or turn the poses into the camera's axes (x right, "
        "y down, z forward)"
    )
