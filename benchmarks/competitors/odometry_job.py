"""What the odometry's competitors share: which images they are given, and how they say what they made.

    PYTHONPATH=. python -m benchmarks.competitors.odometry_toyvo JOB.json RESULT.json

They run with a Python of their own, for their packages are not among the project's.
"""

from __future__ import annotations

import json
import sys
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np


@dataclass
class Job:
    """A sequence: files[f][c] of frame f and camera c, pinhole matrices (3, 3), sizes (width, height), sensor_from_rig
    (C, 4, 4). ``started`` and ``stopped``: when the frames were worked on, s."""

    files: list[list[str]]
    matrices: list[np.ndarray]
    sizes: list[tuple[int, int]]
    sensor_from_rig: list[np.ndarray]
    started: float = 0.0
    stopped: float = 0.0

    def images(self, every: int = 1) -> Iterator[list[np.ndarray]]:
        """Grey images of the frames."""
        for files in self.files[::every]:
            yield [cv2.imread(f, cv2.IMREAD_GRAYSCALE) for f in files]


def main(run: Callable[[Job], list[np.ndarray | None]]) -> None:
    """Read the job, run, write poses (null = none), frames a second and CPU seconds a frame."""
    data = json.loads(Path(sys.argv[1]).read_text())
    arrays = {n: [np.array(v, float) for v in data[n]] for n in ("matrices", "sensor_from_rig")}
    job = Job(files=data["files"], sizes=[(w, h) for w, h in data["sizes"]], **arrays)
    job.started, cpu = time.perf_counter(), time.process_time()
    poses = run(job)
    seconds = (job.stopped or time.perf_counter()) - job.started
    figures = {"frames_per_s": len(poses) / seconds, "cpu_s_per_frame": (time.process_time() - cpu) / len(poses)}
    Path(sys.argv[2]).write_text(json.dumps({"poses": [None if p is None else p.tolist() for p in poses], **figures}))
