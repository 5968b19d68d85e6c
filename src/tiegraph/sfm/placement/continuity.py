"""Does a model move as its passes do? Steps between neighbouring frames against the usual, and the pieces they cut."""

from dataclasses import dataclass

import numpy as np

from tiegraph.scene.scene import Scene
from tiegraph.sfm.tuning.placement import ConsistencyTuning

Segment = tuple[int, tuple[int, ...]]
"""A pass, and frames of it that follow one another without a jump."""


@dataclass(frozen=True)
class MotionContinuity:
    """The usual step of each pass (model units) and how far two of its frames should be apart."""

    usual: dict[int, float]
    clock: np.ndarray  # (F,) time or step
    interval: dict[int, float]  # usual difference of clock between neighbours
    preview: np.ndarray  # (F, 3) positions of a rough model that is believed, NaN = none
    scale: float  # model units of a unit of the preview
    tuning: ConsistencyTuning

    def expected(self, a: int, b: int, sequence: int) -> float:
        """Length of the way between two frames of a pass; by the preview where it has both."""
        apart = float(np.linalg.norm(self.preview[a] - self.preview[b])) * self.scale
        if np.isfinite(apart):
            return apart
        return self.usual[sequence] * abs(self.clock[b] - self.clock[a]) / self.interval[sequence]

    def jumps(self, a: int, b: int, positions: np.ndarray, sequence: int) -> bool:
        """Whether two frames are farther apart than the way between them allows."""
        length = float(np.linalg.norm(positions[a] - positions[b]))
        expected = self.expected(a, b, sequence)
        return length > self.tuning.expected_times * expected + self.tuning.jump_steps * self.usual[sequence]


def motion_continuity(
    positions: np.ndarray, scene: Scene, preview: np.ndarray | None, tuning: ConsistencyTuning
) -> MotionContinuity:
    """Usual steps from positions (F, 3), NaN = not registered; ``preview`` (F, 3) in units of its own."""
    timed = scene.frames > 0 and bool(np.isfinite(scene.time_s).all()) and float(np.ptp(scene.time_s)) > 0
    clock = scene.time_s if timed else scene.sequence_index.astype(float)
    usual, interval, ratios = {}, {}, []
    rough = np.full((scene.frames, 3), np.nan) if preview is None else preview
    for sequence in np.unique(scene.sequence[scene.sequence >= 0]):
        order = in_order(scene, positions, int(sequence))
        if len(order) < tuning.least_frames:
            continue
        steps = np.linalg.norm(np.diff(positions[order], axis=0), axis=1)
        gaps = np.diff(clock[order])
        interval[int(sequence)] = max(float(np.median(gaps)), 1e-9)
        usual[int(sequence)] = float(np.percentile(steps, tuning.brisk_percent))
        seen = np.linalg.norm(np.diff(rough[order], axis=0), axis=1)
        ratios += (steps[seen > 0] / seen[seen > 0]).tolist()
    return MotionContinuity(
        usual=usual,
        clock=clock,
        interval=interval,
        preview=rough,
        scale=float(np.median(ratios)) if ratios else np.nan,
        tuning=tuning,
    )


def in_order(scene: Scene, positions: np.ndarray, sequence: int) -> np.ndarray:
    """Registered frames of a pass in the order of its steps."""
    return scene.in_order((scene.sequence == sequence) & np.isfinite(positions).all(axis=1))


def segments(positions: np.ndarray, scene: Scene, continuity: MotionContinuity) -> list[Segment]:
    """The passes cut at jumps; a frame that jumps out and back is a piece of its own, and the rest stays together."""
    out: list[Segment] = []
    for sequence in continuity.usual:
        groups: list[list[int]] = []
        for frame in in_order(scene, positions, sequence).tolist():
            fits = [g for g in groups if not continuity.jumps(g[-1], frame, positions, sequence)]
            if fits:
                max(fits, key=lambda g: (continuity.clock[g[-1]], len(g))).append(frame)
            else:
                groups.append([frame])
        out += [(sequence, tuple(g)) for g in groups]
    return out
