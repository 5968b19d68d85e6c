"""Are the cameras of a rig synchronised? Missing frames of a camera, and cameras whose images are some frames late.

Cameras of a rig that were triggered together are at one place: their pictures match best in the same frame, and the
shift of objects from one to the other follows from the angle between their axes, at any distance. A lag needs both as
evidence.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tiegraph.network.axes import predicted_shift
from tiegraph.network.passes import Context, Pass
from tiegraph.network.tuning import RigTuning, Tuning
from tiegraph.scene.rig import Rig
from tiegraph.scene.sorting import evenly

NAMED = 8  # passes listed singly


def frame_notes(passes: Sequence[Pass], names: Sequence[str], tuning: RigTuning) -> tuple[str, ...]:
    """One note for each pass whose cameras have different frames: how many each has, and where they are missing; and
    one on passes that are much shorter than the others, because later steps do not notice a pass that ended early."""
    out = [text for p in passes if (text := _lacking(p, names))]
    if len(out) > NAMED:
        out = [*out[:NAMED], f"in {len(out) - NAMED} more passes some cameras lack frames too"]
    length, short = np.array([len(p) for p in passes]), []
    for k, p in enumerate(passes):
        usual = float(np.median(np.delete(length, k))) if len(length) > 1 else 0.0
        if 0 < len(p) < tuning.short * usual:
            last = p.images[:, -1]
            short.append(f"{p.name} has {len(p)} frames, the others {usual:g} (last: {names[last[last >= 0][0]]})")
    if short:
        more = f"; and {len(short) - NAMED} more" if len(short) > NAMED else ""
        out.append(
            f"short passes: {'; '.join(short[:NAMED])}{more}. Did they end early? A pass without a note on its "
            "relation to the others is too short to determine it"
        )
    return tuple(out)


def _lacking(p: Pass, names: Sequence[str]) -> str:
    there = p.images >= 0
    if len(there) < 2 or there.all():
        return ""
    parts = []
    for row, (sensor, own) in enumerate(zip(p.rig.sensors, there)):
        if own.all():
            continue
        have = np.flatnonzero(own)
        if not len(have):
            parts.append(f"{sensor.name} has none of {len(own)} frames")
            continue
        first, last = int(have[0]), int(have[-1])
        where = []
        if first > 0:
            where.append(f"before frame {first + 1} ({names[p.images[row, first]]})")
        if last < len(own) - 1:
            where.append(f"after frame {last + 1} ({names[p.images[row, last]]})")
        gaps = last - first + 1 - len(have)
        where += [f"{gaps} in between"] if gaps else []
        parts.append(f"{sensor.name} has {len(have)} of {len(own)} frames, missing: {', '.join(where)}")
    return f"pass {p.name}: {'; '.join(parts)}"


# ---------------------------------------------------------------- lag


@dataclass(frozen=True)
class _Steps:
    """The overlap of K camera pairs (K, 2) at offsets -L .. L: sensor c of frame m + offset with sensor d of frame m.

    evidence (K, 2L+1), matches above min_matches in units of it; shift (K, 2L+1, 2) median motion in the picture from
    c to d as a share of the image size, NaN = not seen; expected (K, 2) the same up to one factor; matches (K, 2L+1)
    mean number of matches.
    """

    pairs: np.ndarray
    evidence: np.ndarray
    shift: np.ndarray
    expected: np.ndarray
    matches: np.ndarray

    @property
    def longest(self) -> int:
        """L."""
        return self.evidence.shape[1] // 2

    def off(self, among: np.ndarray) -> np.ndarray:
        """(K, 2L+1) distance between the seen and the expected shift, whose factor is estimated from the camera pairs
        of a mask (K,) at offset 0; NaN = not seen or unknown."""
        seen, expected = self.shift[among, self.longest], self.expected[among]
        length = np.sum(expected**2, axis=1)
        ratio = np.sum(seen * expected, axis=1) / np.where(length > 1e-4, length, np.nan)
        known = ratio[np.isfinite(ratio)]
        factor = float(np.median(known)) if len(known) else np.nan
        return np.asarray(np.linalg.norm(self.shift - factor * self.expected[:, None], axis=2))


def lag_notes(context: Context, passes: Sequence[Pass]) -> list[str]:
    """Cameras whose images are some frames late or early relative to the others, one note for each camera and lag.

    In most surveys only the same frames are previewed; other offsets if those look odd, and for a stereo rig.
    """
    tuning = context.tuning
    found: dict[tuple[int, int], list[tuple[str, str]]] = {}
    for p in (passes[k] for k in evenly(len(passes), 4)):
        camera_pairs = _neighbours(p.rig)
        longest = min(6, (len(p) - 1) // 3)
        if not len(camera_pairs) or longest < 1 or p.rig.stitched():
            continue
        several = len(camera_pairs) > 1  # parallel axes of a stereo rig have no wrong shift to show
        if several and not _odd(_measured(context, p, camera_pairs, 0), p, tuning):
            continue
        steps = _measured(context, p, camera_pairs, longest)
        lags = _lags(steps, len(p.rig.sensors), tuning)
        for c in np.flatnonzero(lags):
            found.setdefault((int(c), int(lags[c])), []).append((p.name, _figures(p.rig, steps, int(c), lags)))
    return [_late(passes[0].rig, camera, lag, seen) for (camera, lag), seen in found.items()]


def _neighbours(rig: Rig) -> np.ndarray:
    """(K, 2) pairs of side cameras c < d, each with those whose axes are nearest to its own, within 15 degrees."""
    side = [k for k, s in enumerate(rig.sensors) if s.role != "up"]
    angle = rig.axis_angles_deg()
    near = set()
    for c in side:
        others = [d for d in side if d != c]
        least = min((angle[c, d] for d in others), default=np.nan)
        near |= {(min(c, d), max(c, d)) for d in others if angle[c, d] <= least + 15.0}
    return np.array(sorted(near), int).reshape(-1, 2)


def _measured(context: Context, p: Pass, camera_pairs: np.ndarray, longest: int) -> _Steps:
    """The previews of four frames of a pass."""
    least = context.settings.min_matches
    frames = np.unique(np.linspace(longest, len(p) - 1 - longest, 4).round().astype(int))
    shape = len(camera_pairs), 2 * longest + 1
    k, at, m = (x.ravel() for x in np.meshgrid(np.arange(shape[0]), np.arange(shape[1]), frames, indexing="ij"))
    i, j = p.images[camera_pairs[k, 0], m + at - longest], p.images[camera_pairs[k, 1], m]
    there = (i >= 0) & (j >= 0)
    cell, i, j = (k * shape[1] + at)[there], i[there], j[there]
    results = context.cache.results(np.minimum(i, j), np.maximum(i, j)) if len(i) else []
    count = np.array([r.inliers for r in results], float)
    number = np.maximum(np.bincount(cell, minlength=shape[0] * shape[1]), 1)
    above = np.clip(count / least - 1, 0, None)
    evidence, matches = (np.bincount(cell, w, len(number)) / number for w in (above, count))
    shift = np.full((len(number), 2), np.nan)
    enough = count >= context.tuning.counts.sure * least
    sure = [n for n in np.flatnonzero(enough) if results[n].shift is not None]
    for own in np.unique(cell[sure]):
        seen = [np.asarray(results[n].shift) * (1 if i[n] < j[n] else -1) for n in sure if cell[n] == own]
        shift[own] = np.median(seen, axis=0)
    expected = []
    for c, d in camera_pairs.tolist():  # with the rows scaled like the columns
        camera = p.rig.sensors[c].camera
        ratio = 1.0 if camera is None else camera.width / camera.height
        expected.append(predicted_shift(p.rig, c, d) * (1.0, ratio))
    return _Steps(
        pairs=camera_pairs,
        evidence=evidence.reshape(shape),
        shift=shift.reshape(*shape, 2),
        expected=np.array(expected),
        matches=matches.reshape(shape),
    )


def _odd(now: _Steps, p: Pass, tuning: Tuning) -> bool:
    """Whether the same frames give reason to preview others: counts, shifts, a camera that ties to none."""
    counts = {int(n) for s, n in zip(p.rig.sensors, (p.images >= 0).sum(axis=1)) if s.role != "up"}
    faint = now.evidence[:, 0] < tuning.counts.sure - 1
    alone = [faint[(now.pairs == c).any(axis=1)].all() for c in np.unique(now.pairs)]
    off = now.off(np.ones(len(faint), bool))[:, 0] > tuning.rig.off
    return bool(len(counts) > 1 or off.any() or any(alone))


def _lags(steps: _Steps, sensors: int, tuning: Tuning) -> np.ndarray:
    """(S,) frames by which each camera is late; 0 unless evidence and shifts both show it. Greedy, one by one."""
    lags = np.zeros(sensors, int)
    for _ in range(sensors // 2):  # the time of most cameras is the rig's
        best, change = 0.0, None
        for c in np.unique(steps.pairs)[::-1]:  # the reference camera last: it keeps its time if possible
            for lag in range(-steps.longest, steps.longest + 1):
                gain = _gain(steps, lags, int(c), lag, tuning)
                if lag != lags[c] and gain > best:
                    best, change = gain, (int(c), lag)
        if change is None:
            break
        lags[change[0]] = change[1]
    return lags


def _gain(steps: _Steps, lags: np.ndarray, sensor: int, lag: int, tuning: Tuning) -> float:
    """Evidence gained by moving one camera to a lag; 0 unless all of its pairs agree."""
    moved = lags.copy()
    moved[sensor] = lag
    before, after = (steps.longest + v[steps.pairs[:, 0]] - v[steps.pairs[:, 1]] for v in (lags, moved))
    if after.min() < 0 or after.max() > 2 * steps.longest:
        return 0.0
    rows = np.arange(len(before))
    own = (steps.pairs == sensor).any(axis=1)
    least = tuning.counts.sure - 1  # of the evidence: one preview that ties
    votes = own & (steps.evidence.max(axis=1) >= least)
    if not votes.any():
        return 0.0
    scale = np.maximum(steps.evidence.max(axis=1), least)
    old, new = steps.evidence[rows, before] / scale, steps.evidence[rows, after] / scale
    weaker = np.any(new[votes] < 0.9 * old[votes])
    if weaker or new[votes].sum() < tuning.rig.gain * old[votes].sum():
        return 0.0
    residual = steps.off(~own)
    old_off, new_off = residual[rows, before][votes], residual[rows, after][votes]
    known = np.isfinite(new_off)
    if np.isfinite(residual).any() and (not known.any() or np.any(new_off[known] > tuning.rig.off)):
        return 0.0
    if np.any(known & (new_off > old_off + 0.01)):
        return 0.0
    return float(new[votes].sum() - old[votes].sum())


def _figures(rig: Rig, steps: _Steps, sensor: int, lags: np.ndarray) -> str:
    """Partners of a camera, and mean matches with them at its lag and in the same frame."""
    own = np.flatnonzero((steps.pairs == sensor).any(axis=1))
    other = [rig.sensors[d if c == sensor else c].name for c, d in steps.pairs[own]]
    at = steps.longest + lags[steps.pairs[own, 0]] - lags[steps.pairs[own, 1]]
    there, here = steps.matches[own, at].mean(), steps.matches[own, steps.longest].mean()
    return f"{there:.0f} matches with {' and '.join(other)} there, {here:.0f} in the same frame"


def _late(rig: Rig, sensor: int, lag: int, seen: list[tuple[str, str]]) -> str:
    where = f"pass{'es' if len(seen) > 1 else ''} {' and '.join(name for name, _ in seen)}"
    frames = f"{abs(lag)} frame{'s' if abs(lag) > 1 else ''}"
    late, before = ("late", "before") if lag > 0 else ("early", "after")
    return (
        f"{where}: {rig.sensors[sensor].name} seems to run {frames} {late}: its images match best those of the "
        f"others taken {frames} {before} ({'; '.join(figures for _, figures in seen)}). The rig is used as "
        "synchronised nevertheless: rename the images so that those of one instant share a number"
    )
