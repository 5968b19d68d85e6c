"""toy-vo (PyPI): stereo odometry by optical flow and a window of keyframes. Its poses of the left camera."""

from __future__ import annotations

import numpy as np
from toy_vo import StereoEstimator

from benchmarks.competitors.odometry_job import Job, main


def run(job: Job) -> list[np.ndarray | None]:
    """world_from_left (4, 4) of each frame."""
    parts: list = []
    for k, size, pose in zip(job.matrices, job.sizes, job.sensor_from_rig):
        if not np.allclose(pose[:3, :3], np.eye(3)):
            raise SystemExit("only rectified pairs are given to it")
        parts += [k, np.zeros(5), "OpenCVModel5", *size]
    estimator = StereoEstimator(*parts, np.zeros(3), job.sensor_from_rig[1][:3, 3].copy())
    return [np.array(estimator.process_frame(*images)["T_w_cam0"]) for images in job.images()]


if __name__ == "__main__":
    main(run)
