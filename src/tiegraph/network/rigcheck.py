"""Do the nominal axes of a rig agree with the images? The images of one frame show it, without any motion between them.

A preset may be reversed (mirrored), or its images may be turned on their side (rolled). Each of these hypotheses
predicts the direction in which an object moves in the picture from one camera to the next; the previews of same-frame
pairs vote, and a hypothesis is accepted if chance would be that good only once in 1000 surveys (Student's t, best of
all hypotheses). A rig file may also list its cameras in a wrong order: then cameras share a view that should not,
according to its axes; this test needs no focal length. All pairs of cameras are sampled, because wrong axes exclude
the very pairs that would show it.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from itertools import combinations, permutations

import numpy as np
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms
from tiegraph.network.axes import allowed_within, predicted_shift
from tiegraph.network.passes import Context, Pass
from tiegraph.network.synchronisation import frame_notes, lag_notes
from tiegraph.network.tuning import VerdictTuning
from tiegraph.scene.evidence import mostly_more
from tiegraph.scene.rig import Rig
from tiegraph.scene.scene import Scene
from tiegraph.scene.sorting import evenly


@dataclass(frozen=True)
class Order:
    """Sensor ``k`` seems to have the pose of sensor ``place[k]``; correlations of this and of the nominal order."""

    place: tuple[int, ...]
    fit: float
    nominal_fit: float


def orders(rig: Rig, evidence: np.ndarray, tuning: VerdictTuning) -> list[Order]:
    """Orders of the side cameras that explain evidence (2, S, S), one for each half of the frames, better than the
    rig does.

    Of equal fits those that move fewest cameras come first; empty = the rig's own order is as good as any. Evidence
    is how often two cameras match, NaN = unknown; only its ranking relative to the cosine of the axes counts.
    """
    side = np.array([k for k, s in enumerate(rig.sensors) if s.role != "up"])
    if len(side) < 3:
        return []  # two cameras match in either order
    cosine = np.cos(np.radians(rig.axis_angles_deg()))[np.ix_(side, side)]
    parts = [e[np.ix_(side, side)] for e in evidence]
    whole = _mean(np.stack(parts))
    tried = np.array(list(permutations(range(len(side))))) if len(side) <= 7 else _by_swaps(whole, cosine)
    fit = _fits(whole, cosine, tried)
    nominal = fit[0]
    if fit.max() < max(tuning.agreement, nominal + tuning.better):
        return []
    halves = [_fits(e, cosine, tried) for e in parts]
    good = (fit >= fit.max() - tuning.alike) & np.all([h >= h[0] + tuning.better / 2 for h in halves], axis=0)
    moved = np.sum(tried != np.arange(len(side)), axis=1)
    best = np.flatnonzero(good)[np.argsort(moved[good], kind="stable")]
    place = np.tile(np.arange(len(rig.sensors)), (len(best), 1))
    place[:, side] = side[tried[best]]
    return [Order(tuple(p), float(fit[k]), float(nominal)) for p, k in zip(place.tolist(), best)]


def reordered(rig: Rig, place: tuple[int, ...]) -> tuple[Rig, np.ndarray]:
    """The rig with sensor k at the pose of sensor ``place[k]``, and the (4, 4) transform from its new rig frame to
    the old one."""
    old = [s.sensor_from_rig for s in rig.sensors if s.sensor_from_rig is not None]
    first = old[place[0]]
    back = transforms.invert(first)
    sensors = [replace(sensor, sensor_from_rig=old[k] @ back) for sensor, k in zip(rig.sensors, place)]
    antenna = None if rig.antenna_m is None else transforms.apply(first, np.array([rig.antenna_m]))[0]
    arm = None if antenna is None else (float(antenna[0]), float(antenna[1]), float(antenna[2]))
    return replace(rig, sensors=tuple(sensors), antenna_m=arm), back


def in_words(rig: Rig, order: Order, evidence: np.ndarray) -> str:
    """The cameras that seem exchanged, with the figures."""
    names = [s.name for s in rig.sensors]
    moved = [k for k, p in enumerate(order.place) if p != k]
    if len(moved) == 2:
        said = f"{names[moved[0]]} and {names[moved[1]]} match as if they were swapped"
    else:
        said = "its cameras match as if they were in another order: " + ", ".join(
            f"{names[k]} at the place of {names[order.place[k]]}" for k in moved
        )
    mean = np.nan_to_num(_mean(evidence))
    np.fill_diagonal(mean, 0)
    least = float(np.median(mean.max(axis=1))) / 2  # half the evidence of the typical best partner
    found = [(c, d) for c, d in combinations(range(len(names)), 2) if mean[c, d] >= least > 0]
    angle = rig.axis_angles_deg()
    pairs = ", ".join(f"{names[c]}-{names[d]} ({angle[c, d]:.0f} deg by the rig)" for c, d in found)
    fits = f"correlation of matches and axes {order.fit:.2f} instead of {order.nominal_fit:.2f}"
    return f"{said} ({fits}); cameras that share a view: {pairs}"


def _mean(evidence: np.ndarray) -> np.ndarray:
    """(S, S) mean of the known values of (2, S, S)."""
    known = np.isfinite(evidence).sum(axis=0)
    return np.where(known > 0, np.nansum(evidence, axis=0) / np.maximum(known, 1), np.nan)


def _by_swaps(evidence: np.ndarray, cosine: np.ndarray) -> np.ndarray:
    """The nominal order, and the orders found by repeatedly swapping the two cameras that improve most."""
    met = [np.arange(len(evidence))]
    for _ in range(len(evidence)):
        swaps = []
        for c, d in combinations(range(len(evidence)), 2):
            swapped = met[-1].copy()
            swapped[[c, d]] = swapped[[d, c]]
            swaps.append(swapped)
        fit = _fits(evidence, cosine, np.array([met[-1], *swaps]))
        if fit.argmax() == 0:
            break
        met.append(swaps[int(fit.argmax()) - 1])
    return np.array(met)


def _fits(evidence: np.ndarray, cosine: np.ndarray, tried: np.ndarray) -> np.ndarray:
    """(P,) correlation between the evidence (S, S) of camera pairs and the cosines in their orders (P, S)."""
    c, d = np.triu_indices(len(evidence), 1)
    known = np.isfinite(evidence[c, d])
    c, d = c[known], d[known]
    x, y = evidence[c, d], cosine[tried[:, c], tried[:, d]]
    if len(x) < 3 or np.ptp(x) < 1e-9 or np.ptp(y) < 1e-6:
        return np.zeros(len(tried))
    x, y = x - x.mean(), y - y.mean(axis=1, keepdims=True)
    return y @ x / np.maximum(np.linalg.norm(y, axis=1) * np.linalg.norm(x), 1e-12)


@dataclass(frozen=True)
class RigCheck:
    """Outcome for one rig: the rig to use from here on and the note.

    old_from_new (4, 4): the old rig frame from the new one; ordered: False if its cameras seem to be in another order.
    """

    rig: Rig
    note: str
    old_from_new: np.ndarray = field(default_factory=lambda: np.eye(4))
    ordered: bool = True


@dataclass(frozen=True)
class _Votes:
    """K same-frame pairs: sensors a, b, shift (K, 2), rotation angle of the axes in degrees (NaN = unknown).

    evidence (2, S, S): mean matches above ``min_matches`` in units of it, limited, of each half of the frames; NaN =
    not previewed.
    """

    a: np.ndarray
    b: np.ndarray
    shift: np.ndarray
    angle_deg: np.ndarray
    evidence: np.ndarray


def check_rigs(context: Context) -> tuple[Scene, tuple[str, ...]]:
    """The scene with rigs corrected whose order, sense of rotation or roll the images contradict, and notes.

    Notes also name cameras with fewer frames than others and cameras that seem to run late.
    """
    scene, tuning = context.scene, context.tuning.rig
    if not tuning.frames:
        return scene, ()
    rigs, poses = list(scene.rigs), scene.world_from_rig
    notes = list(frame_notes(context.passes, scene.names, tuning))
    for k, rig in enumerate(scene.rigs):
        if len(rig.sensors) < 2 or not rig.known():
            continue
        own = [p for p in context.passes if p.rig_index == k]
        outcome = check_rig(context, rig, own)
        rigs[k] = outcome.rig
        if not np.array_equal(outcome.old_from_new, np.eye(4)):
            turned = (scene.rig == k) & np.isfinite(poses).all(axis=(1, 2))  # a position alone does not change
            poses = np.where(turned[:, None, None], poses @ outcome.old_from_new, poses)
        notes.append(outcome.note)
        if outcome.ordered:
            notes += lag_notes(context, [replace(p, rig=outcome.rig) for p in own])
    if any(a is not b for a, b in zip(rigs, scene.rigs)):
        scene = scene.with_(rigs=tuple(rigs), world_from_rig=poses)
    return scene, tuple(notes)


def check_rig(context: Context, rig: Rig, passes: Sequence[Pass]) -> RigCheck:
    """Vote on other orders, mirrored and rolled versions of a rig with previews; a calibrated rig is never changed."""
    check, limit_deg = context.tuning.verdict, context.settings.axes_deg
    everything = _collect(context, rig, passes)
    found = orders(rig, everything.evidence, check)
    if found:
        return _out_of_order(rig, found, everything, limit_deg, check.alike)
    votes = _facing(everything, rig, limit_deg)
    if len(votes.a) < check.votes:
        text = f"rig {rig.name}: its axes could not be checked against the images: too few matches"
        return RigCheck(rig, f"{text} ({len(votes.a)} of {check.votes} pairs of one frame)")
    variants = _hypotheses(rig)
    score = {name: _agreement(variant, votes) for name, variant in variants.items()}
    # The first of equally good explanations: side cameras of a ring cannot separate "mirrored" from "upside down".
    best = next(name for name, s in score.items() if s >= max(score.values()) - check.alike)
    angles = _angles(rig, votes)
    if score["nominal"] >= check.agreement or best == "nominal":
        how = "agree with" if score["nominal"] >= check.agreement else "neither prove nor contradict"
        return RigCheck(rig, f"rig {rig.name}: the images {how} its sense of rotation{angles}")
    gain = _cosines(variants[best], votes) - _cosines(rig, votes)
    sure = score[best] >= max(check.agreement, score["nominal"] + check.better)
    if not sure or not mostly_more(gain[np.isfinite(gain)], len(variants) - 1):
        return RigCheck(rig, f"rig {rig.name}: the images fit its axes badly; check the rig file{angles}")
    if rig.fixed:
        return RigCheck(
            rig, f"rig {rig.name}: the images show it {best}, but it is calibrated: it was not changed{angles}"
        )
    angles = _angles(variants[best], votes)
    return RigCheck(variants[best], f"rig {rig.name}: the images show it {best}: it was corrected{angles}")


def _out_of_order(rig: Rig, found: Sequence[Order], votes: _Votes, limit_deg: float, alike: float) -> RigCheck:
    """Of orders with the same neighbours the first that has the sense of rotation of the images."""
    tried = [reordered(rig, order.place)[0] for order in found]
    score = [_agreement(r, _facing(votes, r, limit_deg)) for r in tried]
    order = found[next(k for k, s in enumerate(score) if s >= max(score) - alike)]
    text = f"rig {rig.name}: {in_words(rig, order, votes.evidence)}"
    if rig.fixed:
        return RigCheck(rig, f"{text}: it is calibrated and was not changed; check the rig file", ordered=False)
    corrected, old_from_new = reordered(rig, order.place)
    return RigCheck(corrected, f"{text}: it was corrected; check the rig file", old_from_new)


def _hypotheses(rig: Rig) -> dict[str, Rig]:
    """Every camera rotated about its own axis, and the rig reflected left to right as seen by the reference camera."""
    posed = [(s, s.sensor_from_rig) for s in rig.sensors if s.sensor_from_rig is not None]
    out = {}
    for roll in (0, 90, 180, 270):
        turn = Rotation.from_euler("z", roll, degrees=True).as_matrix()
        for mirror in (False, True):
            name = " and ".join(["mirrored"] * mirror + [f"rolled by {roll} deg"] * (roll > 0)) or "nominal"
            change = transforms.rigid(turn @ np.diag([-1.0 if mirror else 1.0, 1.0, 1.0]), np.zeros(3))
            back = np.linalg.inv(change)
            sensors = tuple(replace(s, sensor_from_rig=change @ pose @ back) for s, pose in posed)
            out[name] = replace(rig, sensors=sensors)
    return out


def _collect(context: Context, rig: Rig, passes: Sequence[Pass]) -> _Votes:
    """Previews of every two cameras in sampled frames; if hardly any match, also from a frame to the next one."""
    cache, least, frames = context.cache, context.settings.min_matches, context.tuning.rig.frames
    camera_pairs = np.stack(np.triu_indices(len(rig.sensors), 1), axis=1)
    rows = _sampled(passes, camera_pairs, 0, frames)
    results = cache.results(rows[2], rows[3]) if rows.size else []
    a, b, _, _, half = rows
    inliers = np.array([r.inliers for r in results], float)
    sure = inliers >= context.tuning.counts.sure * least
    enough = [k for k, r in enumerate(results) if sure[k] and r.shift is not None]
    turns = [results[k].rotation for k in enough]
    angle = [np.nan if r is None else np.degrees(np.arccos(np.clip(r[2, 2], -1, 1))) for r in turns]  # of the axes
    shift = np.array([results[k].shift for k in enough]).reshape(-1, 2)
    if sure.sum() < context.tuning.verdict.votes:
        both = np.concatenate([camera_pairs, camera_pairs[:, ::-1]])
        following = _sampled(passes, both, 1, frames)
        inliers = np.append(inliers, cache.measure(following[2], following[3]))
        rows = np.concatenate([rows, following], axis=1)
    first, second, half, sensors = rows[0], rows[1], rows[4], len(rig.sensors)
    total, count = np.zeros((2, 2, sensors, sensors))
    np.add.at(total, (half, first, second), np.clip(inliers / least - 1, 0, 2.0))
    np.add.at(count, (half, first, second), 1)
    total, count = total + total.transpose(0, 2, 1), count + count.transpose(0, 2, 1)
    evidence = np.where(count > 0, total / np.maximum(count, 1), np.nan)
    return _Votes(a=a[enough], b=b[enough], shift=shift, angle_deg=np.array(angle, float), evidence=evidence)


def _facing(votes: _Votes, rig: Rig, limit_deg: float) -> _Votes:
    """Votes of the cameras whose axes permit a match: with repeated walls the others match by chance."""
    use = allowed_within(rig, limit_deg)[votes.a, votes.b]
    return replace(votes, a=votes.a[use], b=votes.b[use], shift=votes.shift[use], angle_deg=votes.angle_deg[use])


def _sampled(passes: Sequence[Pass], camera_pairs: np.ndarray, step: int, frames: int) -> np.ndarray:
    """(5, K) sensors a, b, images i < j at frames k and k + ``step``, and the half of the frames (0, 1)."""
    frames = max(min(frames, frames**2 // max(1, len(camera_pairs))), 4)  # fewer of large rigs
    some = [passes[k] for k in evenly(len(passes), frames)]
    each = max(1, frames // max(1, len(some)))
    out = [np.zeros((5, 0), int)]
    number = 0
    for p in some:
        for k in evenly(max(0, len(p) - step), each):
            a, b = camera_pairs.T
            i, j = p.images[a, k], p.images[b, k + step]
            rows = np.stack([a, b, i, j, np.full(len(a), number % 2)])
            number += 1
            swap = i > j
            rows[:4, swap] = rows[[1, 0, 3, 2]][:, swap]
            out.append(rows[:, (i >= 0) & (j >= 0)])
    return np.concatenate(out, axis=1)


def _agreement(rig: Rig, votes: _Votes) -> float:
    """Mean cosine between predicted and seen motion of shared objects, every camera pair with the same weight."""
    cosine, pair = _cosines(rig, votes), votes.a * len(rig.sensors) + votes.b
    means = [float(np.mean(cosine[pair == p])) for p in np.unique(pair) if np.isfinite(cosine[pair == p]).all()]
    return float(np.mean(means)) if means else 0.0


def _cosines(rig: Rig, votes: _Votes) -> np.ndarray:
    """(K,) of the votes, NaN where no motion is predicted."""
    pairs = list(zip(votes.a.tolist(), votes.b.tolist()))
    known = {p: predicted_shift(rig, *p) for p in set(pairs)}
    predicted = np.array([known[p] for p in pairs]).reshape(-1, 2)
    length, seen = np.linalg.norm(predicted, axis=1), np.linalg.norm(votes.shift, axis=1)
    cosine = np.sum(predicted * votes.shift, axis=1) / np.maximum(length * seen, 1e-9)
    return np.where(length > 1e-9, cosine, np.nan)


def _angles(rig: Rig, votes: _Votes) -> str:
    if any(s.camera is None or not s.camera.has_prior_focal_length for s in rig.sensors):
        return ""  # angles from a guessed focal length mean nothing
    nominal = rig.axis_angles_deg()
    parts = []
    for a, b in sorted(set(zip(votes.a.tolist(), votes.b.tolist()))):
        found = votes.angle_deg[(votes.a == a) & (votes.b == b)]
        found = found[np.isfinite(found)]
        if len(found) >= 3:
            names = f"{rig.sensors[a].name}-{rig.sensors[b].name}"
            parts.append(f"{names} {np.median(found):.0f} ({nominal[a, b]:.0f})")
    return f"; angles between axes found (nominal), deg: {', '.join(parts)}" if parts else ""
