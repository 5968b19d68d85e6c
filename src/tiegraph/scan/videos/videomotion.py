"""How the picture of a video moves from frame to frame: what cameras of one rig have in common, whatever they see."""

from collections.abc import Iterable
from dataclasses import dataclass

import cv2
import numpy as np

from tiegraph.scan.tuning import MotionTuning

CHANNELS = 4


@dataclass(frozen=True)
class MotionCurve:
    """Motion of the whole picture, summed up since the first frame.

    Shift right and down, growth and turn about the middle, in pixels of the reduced picture at half its width from
    the middle. A rigid rig's curves are linear in each other as far as its rotation makes them, which is most of it.
    """

    stamp_s: np.ndarray  # (N,) of the frames, increasing
    moved_px: np.ndarray  # (N, CHANNELS)

    def step_s(self) -> float:
        """Median time between two frames."""
        return float(np.median(np.diff(self.stamp_s)))


def motion_curve(frames: Iterable[tuple[float, np.ndarray]], tuning: MotionTuning) -> MotionCurve:
    """The motion of (stamp in s, BGR picture), over the first ``most_s`` seconds; dense flow and a robust fit to it."""
    flow = cv2.DISOpticalFlow.create(cv2.DISOPTICAL_FLOW_PRESET_FAST)
    stamps: list[float] = []
    moved: list[np.ndarray] = []
    before: np.ndarray | None = None
    for stamp, picture in frames:
        if stamps and stamp - stamps[0] > tuning.most_s:
            break
        grey = _reduced(picture, tuning.width_px)
        step = np.zeros(CHANNELS)
        if before is not None:
            step = _global_motion(flow.calc(before, grey, np.zeros(0, np.float32))[2::4, 2::4], tuning)
        stamps.append(stamp)
        moved.append(step)
        before = grey
    return MotionCurve(np.array(stamps, float), np.cumsum(np.reshape(moved, (-1, CHANNELS)), axis=0))


def _reduced(picture: np.ndarray, width_px: int) -> np.ndarray:
    scale = min(1.0, width_px / picture.shape[1])
    small = cv2.resize(picture, None, fx=scale, fy=scale, interpolation=cv2.INTER_AREA)
    return small if small.ndim == 2 else cv2.cvtColor(small, cv2.COLOR_BGR2GRAY)


def _global_motion(flow_px: np.ndarray, tuning: MotionTuning) -> np.ndarray:
    """(4,) similarity that fits a flow field (h, w, 2) best, by reweighted least squares (Cauchy weights)."""
    height, width = flow_px.shape[:2]
    y, x = (np.ravel(v) for v in np.mgrid[0:height, 0:width])
    x, y = (x - (width - 1) / 2) / (width / 2), (y - (height - 1) / 2) / (width / 2)
    one, none = np.ones(len(x)), np.zeros(len(x))
    design = np.vstack([np.stack([one, none, x, -y], axis=1), np.stack([none, one, y, x], axis=1)])
    measured = np.concatenate([flow_px[..., 0].ravel(), flow_px[..., 1].ravel()])
    weight = np.ones(len(measured))
    for _ in range(tuning.rounds):
        normal = design.T @ (weight[:, None] * design)
        motion = np.linalg.solve(normal, design.T @ (weight * measured))
        residual = np.abs(measured - design @ motion)
        scale = max(1.4826 * float(np.median(residual)), tuning.noise_px)
        weight = 1 / (1 + (residual / scale) ** 2)
    return motion
