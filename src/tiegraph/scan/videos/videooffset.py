"""The time offset between two videos of one rig, by the motion of their pictures.

Two cameras on one body turn together, so the motion of one picture is a linear function of the motion of the other at
the same instant, of unknown coefficients (their axes and lenses differ). The likelihood of an offset is that of the
best linear relation: the mutual information of two Gaussian signals, -1/2 log(det C / (det Cx det Cy)) a sample. The
motion is first whitened by its own first autocorrelation, because otherwise any two slow rotations would fit. Between
frames both curves are interpolated in the same way, by half the change of the offset, on grids of several phases, so
that the smoothing of one does not bias the offset to whole frames.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import PurePosixPath

import cv2
import numpy as np
import scipy

from tiegraph.errors import InputError
from tiegraph.geometry.transforms import robust_sigma
from tiegraph.scan.assign import assign
from tiegraph.scan.prepare import Report, Usable
from tiegraph.scan.settings import ScanSettings, video_offsets
from tiegraph.scan.tuning import Tuning
from tiegraph.scan.views import PRESET
from tiegraph.scene.images import Probe

_WIDTH_PX = 640  # of compared pictures: KITTI's two cameras agree best there (of 320, 640 and 1241)
_MOST_S = 300.0  # from the video's start; clocks of cameras drift by 10 to 50 us a second, 15 ms in this time at most
_LEAST_FRAMES, _LEAST_S = 20, 2.0  # of a video; seconds that two must share at a tried offset
_NOISE_PX = 0.02  # sigma of the measured motion per step
_APART_STEPS = 4.0  # offsets farther apart are different: the motion within a second is similar to itself
# Least ratio of the likelihood of the best offset to that of the best different one, and to noise. Among wrong ones the
# best has up to 1.6 times the next (curves of 20 s); KITTI's 5 s of a straight road have 3.7.
_LEAST_GAIN = 2.5
_SMOOTHING = 0.01  # steps; what interpolation between frames may add to the error (synthetic curves: 0.007)
_MOST_SIGMA = 0.5  # steps; with a larger sigma the offset could be that of the next frame
# Resolution of the search, not decisions:
_PHASES = 4  # grids between two steps
_BLOCKS = 8  # of time, of the jackknife
_ROUNDS, _EXACT_PX = 5, 0.02  # of the reweighted least squares; residual below which flow is as good as exact
CHANNELS = 4


@dataclass(frozen=True)
class Offset:
    """Offset from the stamps of a video to those of another, and its sigma; or ``refused``: why there is none."""

    seconds: float = float("nan")
    sigma_s: float = float("nan")
    shared_s: float = 0.0  # seconds that both videos show
    refused: str = ""


def find_offset(first: MotionCurve, second: MotionCurve) -> Offset:
    """The offset of ``second`` to ``first``.

    Its sigma is that of a jackknife over blocks of the shared time, or half the difference between its two halves, if
    that is more, plus the part of interpolation. Refused if another offset fits nearly as well, or the halves
    contradict each other.
    """
    few = min(len(first.stamp_s), len(second.stamp_s))
    if few < _LEAST_FRAMES:
        return Offset(refused=f"{few} frames are too few")
    step = max(first.step_s(), second.step_s())
    coarse = _Pair(first, second, max(step, 0.1))  # steps of the search over all offsets ...
    fine = _Pair(first, second, step)
    rough, refused = _stands_out(fine, _candidates(coarse), coarse.step_s)
    if refused:
        return Offset(refused=refused)
    peak = _peaks(fine, rough, 1.5 * coarse.step_s)
    every = np.ones(_BLOCKS, bool)
    early = np.arange(_BLOCKS) < _BLOCKS // 2
    best, apart = peak(every), peak(early) - peak(~early)
    left_out = np.array([peak(np.arange(_BLOCKS) != k) for k in range(_BLOCKS)])
    jackknife = float(np.sqrt((_BLOCKS - 1) * np.mean((left_out - left_out.mean()) ** 2)))
    sigma = float(np.hypot(max(jackknife, abs(apart) / 2), _SMOOTHING * step))
    if sigma > _MOST_SIGMA * step:
        return Offset(refused=f"its motion gives {best:+.3f} s, but its halves differ by {abs(apart):.3f} s")
    begin, end = fine.shared(best)
    return Offset(best, sigma, end - begin)


def _candidates(pair: _Pair) -> list[float]:
    """The likeliest offsets, best first, separated from each other, of all with enough common time."""
    offsets = pair.offsets()
    likelihood = np.array([pair.likelihood(o) for o in offsets])
    found: list[float] = []
    for k in np.argsort(-likelihood, kind="stable"):
        if len(found) == 8:  # ... and offsets of it that are tested in steps of a frame
            break
        if all(abs(offsets[k] - f) > _APART_STEPS * pair.step_s for f in found):
            found.append(float(offsets[k]))
    return found


def _stands_out(pair: _Pair, candidates: list[float], reach_s: float) -> tuple[float, str]:
    """The likeliest of some offsets, each refined in quarters of steps about it; and why it is unreliable."""
    if not candidates:
        return 0.0, f"the videos are shorter than the {_LEAST_S:g} s that are compared at least"
    around = pair.step_s / 4 * np.arange(-int(4 * reach_s / pair.step_s), int(4 * reach_s / pair.step_s) + 1)
    tried = [[pair.likelihood(c + o) for o in around] for c in candidates]
    likelihood = np.max(tried, axis=1)
    order = np.argsort(-likelihood, kind="stable")
    offset = [c + around[int(np.argmax(row))] for c, row in zip(candidates, tried)]
    best, second = offset[order[0]], float(likelihood[order[1]]) if len(order) > 1 else 0.0
    if likelihood[order[0]] < _LEAST_GAIN * max(second, CHANNELS**2 / 2):
        also = f"; {offset[order[1]]:+.2f} s fits nearly as well" if len(order) > 1 else ""
        return 0.0, f"no offset stands out ({best:+.2f} s fits best{also})"
    return float(best), ""


def _information(covariance: np.ndarray) -> float:
    """Mutual information a sample (nats) of the two halves of jointly Gaussian signals of zero mean."""
    noisy = covariance + _NOISE_PX**2 * np.eye(len(covariance))
    half = len(covariance) // 2
    parts = np.linalg.slogdet(noisy[:half, :half])[1] + np.linalg.slogdet(noisy[half:, half:])[1]
    return float(0.5 * (parts - np.linalg.slogdet(noisy)[1]))


class _Pair:
    """The whitened motion of two videos in equal steps of time, for any offset between them."""

    def __init__(self, first: MotionCurve, second: MotionCurve, step_s: float) -> None:
        self.step_s = step_s
        self._splines = [scipy.interpolate.CubicSpline(c.stamp_s, c.moved_px) for c in (first, second)]
        self._ends = [(float(c.stamp_s[0]), float(c.stamp_s[-1])) for c in (first, second)]
        colour = [
            _autocorrelation(np.diff(s(np.arange(*e, step_s)), axis=0)) for s, e in zip(self._splines, self._ends)
        ]
        self._colour = float(np.mean(colour))

    def offsets(self) -> np.ndarray:
        """Offsets in half steps at which the videos share enough seconds."""
        (a, b), (c, d) = self._ends
        low, high, half = a - d + _LEAST_S, b - c - _LEAST_S, self.step_s / 2
        return low + half * np.arange(int((high - low) / half) + 1 if high >= low else 0)

    def shared(self, offset_s: float) -> tuple[float, float]:
        """First and last stamp of the first video within the second."""
        (a, b), (c, d) = self._ends
        return max(a, c + offset_s), min(b, d + offset_s)

    def likelihood(self, offset_s: float) -> float:
        """Of an offset, by the whole shared time (nats); 0 if that is too short."""
        begin, end = self.shared(offset_s)
        if end - begin < _LEAST_S:
            return 0.0
        at = begin + self.step_s * np.arange(int((end - begin) / self.step_s + 1e-9) + 1)
        moved = self.moved(at, at - offset_s)
        return len(moved) * _information(moved.T @ moved / len(moved))

    def moved(self, first_s: np.ndarray, second_s: np.ndarray) -> np.ndarray:
        """(n, 2 CHANNELS) motion of both per step, less the prediction from the step before, at stamps (n + 2,) of
        each."""
        both = np.hstack([np.diff(s(t), axis=0) for s, t in zip(self._splines, (first_s, second_s))])
        white = both[1:] - self._colour * both[:-1]
        return white - white.mean(axis=0)


def _autocorrelation(moved: np.ndarray) -> float:
    """Autocorrelation with the next step, mean over the channels that move."""
    centred = moved - moved.mean(axis=0)
    power = np.sum(centred**2, axis=0)
    return float(np.sum(centred[1:] * centred[:-1] / np.where(power > 0, power, np.inf)) / CHANNELS)


def _peaks(pair: _Pair, rough_s: float, reach_s: float) -> Callable[[np.ndarray], float]:
    """A function for the most likely offset near a rough one, by some of the blocks (B,) of time: the vertex of a
    parabola about the best one tried."""
    count = int(np.ceil(12 * reach_s / pair.step_s))
    changes = pair.step_s / 12 * np.arange(-count, count + 1)  # offsets tried between two steps
    near_s = 0.6 * pair.step_s  # about the best offset, where a parabola is fitted to the likelihood
    begin, end = pair.shared(rough_s)
    at = np.arange(begin + reach_s, end - reach_s - pair.step_s, pair.step_s)
    block = np.arange(max(len(at) - 2, 0)) * _BLOCKS // max(len(at) - 2, 1)
    counts = np.bincount(block, minlength=_BLOCKS)
    sums = np.zeros((len(changes), _BLOCKS, 2 * CHANNELS, 2 * CHANNELS))  # second moments of the motion
    for phase in pair.step_s * np.arange(_PHASES) / _PHASES:
        for k, change in enumerate(changes):
            moved = pair.moved(at + phase + change / 2, at + phase - rough_s - change / 2)
            for b in range(_BLOCKS):
                sums[k, b] += moved[block == b].T @ moved[block == b] / _PHASES

    def peak(blocks: np.ndarray) -> float:
        total = counts[blocks].sum()
        likelihood = np.array([_information(s[blocks].sum(axis=0) / total) for s in sums])
        best = changes[int(np.argmax(likelihood))]
        near = np.abs(changes - best) <= near_s
        curved, slope, _ = np.polyfit(changes[near] - best, likelihood[near], 2)
        top = -slope / (2 * curved) if curved < 0 else 0.0
        return float(rough_s + best + np.clip(top, -near_s, near_s))

    return peak


@dataclass(frozen=True)
class Film:
    """A video that can be decoded: the folder of its pictures, and their size."""

    folder: str
    width: int
    height: int


def films_together(
    films: Sequence[Film], rig: str | None, text: str | None, settings: ScanSettings, tuning: Tuning
) -> list[tuple[int, ...]]:
    """Numbers of the films that were recorded together, the rig's first camera first; usually a single one.

    ``rig`` and ``text`` as for ``assign``. Films of panoramas are no cameras of a rig. Raises InputError for a rig that
    does not fit.
    """
    around = 2 * sum(f.width == 2 * f.height for f in films) > len(films)
    if (rig or "").strip().lower() == PRESET or (rig is None and around):
        return [(k,) for k in range(len(films))]
    names = [f"{f.folder}/{PurePosixPath(f.folder).name}_{0:06d}.jpg" for f in films]
    probes = tuple(Probe(f.width, f.height) for f in films)
    usable = Usable(tuple(range(len(films))), tuple(names), probes, video=True)
    survey = assign(rig, usable, settings, Report(), tuning, text)
    groups: dict[tuple[int, str], dict[int, int]] = {}
    for shot in survey.shots:
        if shot.sequence:
            groups.setdefault((shot.rig, shot.sequence), {})[shot.sensor] = shot.image
    together = [tuple(g[s] for s in sorted(g)) for g in groups.values() if len(g) > 1]
    return sorted(together + [(k,) for k in set(range(len(films))).difference(*together)])


def offsets_given(folders: Sequence[str], settings: ScanSettings) -> dict[int, float]:
    """Seconds of ``scan.video_offset`` by the number of the video, named by its folder or the last part of it.

    Raises InputError for a name of no or several videos.
    """
    found = {}
    for name, seconds in video_offsets(settings.video_offset).by_name.items():
        mine = [k for k, f in enumerate(folders) if f == name or (folders.count(name) == 0 and f.endswith(f"/{name}"))]
        if len(mine) != 1:
            word = "no video is" if not mine else "several videos are"
            raise InputError(f"--scan.video-offset {name}={seconds:g}: {word} called so; here are {', '.join(folders)}")
        found[mine[0]] = seconds
    return found


@dataclass(frozen=True)
class MotionCurve:
    """Motion of the whole picture, summed up since the first frame.

    Shift right and down, scaling and rotation about the middle, in pixels of the reduced picture at half its width from
    the middle. A rigid rig's curves are linear in each other for motion by its rotation, which is most of it.
    """

    stamp_s: np.ndarray  # (N,) of the frames, increasing
    moved_px: np.ndarray  # (N, CHANNELS)

    def step_s(self) -> float:
        """Median time between two frames."""
        return float(np.median(np.diff(self.stamp_s)))


def motion_curve(frames: Iterable[tuple[float, np.ndarray]]) -> MotionCurve:
    """The motion of (stamp in s, BGR picture), over the first minutes; dense flow and a robust fit to it."""
    flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_FAST)
    stamps: list[float] = []
    moved: list[np.ndarray] = []
    before: np.ndarray | None = None
    for stamp, picture in frames:
        if stamps and stamp - stamps[0] > _MOST_S:
            break
        scale = min(1.0, _WIDTH_PX / picture.shape[1])
        small = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
        grey = small if small.ndim == 2 else cv2.cvtColor(small, cv2.COLOR_BGR2GRAY)
        step = np.zeros(CHANNELS)
        if before is not None:
            step = _global_motion(flow.calc(before, grey, np.zeros(0, np.float32))[2::4, 2::4])
        stamps.append(stamp)
        moved.append(step)
        before = grey
    return MotionCurve(np.array(stamps, float), np.cumsum(np.reshape(moved, (-1, CHANNELS)), axis=0))


def _global_motion(flow_px: np.ndarray) -> np.ndarray:
    """(4,) similarity that fits a flow field (h, w, 2) best, by reweighted least squares (Cauchy weights)."""
    height, width = flow_px.shape[:2]
    y, x = (np.ravel(v) for v in np.mgrid[0:height, 0:width])
    x, y = (x - (width - 1) / 2) / (width / 2), (y - (height - 1) / 2) / (width / 2)
    one, none = np.ones(len(x)), np.zeros(len(x))
    design = np.vstack([np.stack([one, none, x, -y], axis=1), np.stack([none, one, y, x], axis=1)])
    measured = np.concatenate([flow_px[..., 0].ravel(), flow_px[..., 1].ravel()])
    weight = np.ones(len(measured))
    for _ in range(_ROUNDS):
        normal = design.T @ (weight[:, None] * design)
        motion = np.linalg.solve(normal, design.T @ (weight * measured))
        residual = np.abs(measured - design @ motion)
        scale = max(robust_sigma(residual), _EXACT_PX)
        weight = 1 / (1 + (residual / scale) ** 2)
    return motion
