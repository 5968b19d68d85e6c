"""ORB-SLAM3 by pyorbslam3 (PyPI): stereo or one camera; loop closing as it has it.

Its vocabulary of 139 MB is in no package. One of the same form is made of the sequence's own descriptors (``_words``):
it serves the search for known places and speeds matching up, and has no part in a pose.
"""

from __future__ import annotations

import tempfile
import time
from pathlib import Path

import cv2
import numpy as np
from pyorbslam3 import Sensor, Slam

from benchmarks.competitors.odometry_job import Job, main

_BRANCHES, _LEVELS, _SEED = 10, 4, 0
_RATE = 10.0  # frames a second that it is told


def run(job: Job) -> list[np.ndarray | None]:
    """world_from_left (4, 4) of each frame, as it was when the frame came."""
    with tempfile.TemporaryDirectory() as folder:
        words, settings = Path(folder) / "words.txt", Path(folder) / "settings.yaml"
        words.write_text(_words(job))
        settings.write_text(_settings(job))
        stereo = len(job.matrices) == 2
        slam = Slam(words, settings, Sensor.STEREO if stereo else Sensor.MONOCULAR)
        job.started = time.perf_counter()
        out: list[np.ndarray | None] = []
        for number, images in enumerate(job.images()):
            track = slam.track_stereo if stereo else slam.track_monocular
            found = track(*images, number / _RATE)
            out.append(np.array(found.pose_wc, float) if found.pose_valid else None)
        job.stopped = time.perf_counter()
        slam.shutdown()
    return out


def _settings(job: Job) -> str:
    k, (width, height) = job.matrices[0], job.sizes[0]
    names = {"fx": k[0, 0], "fy": k[1, 1], "cx": k[0, 2], "cy": k[1, 2], "k1": 0, "k2": 0, "p1": 0, "p2": 0}
    lines = ["%YAML:1.0", 'Camera.type: "PinHole"', f"Camera.width: {width}", f"Camera.height: {height}"]
    lines += [f"Camera.{name}: {float(value)!r}" for name, value in names.items()]
    lines += [f"Camera.fps: {_RATE!r}", "Camera.RGB: 1"]
    if len(job.matrices) == 2:
        base_m = float(np.linalg.norm(job.sensor_from_rig[1][:3, 3]))
        lines += [f"Camera.bf: {base_m * float(k[0, 0])!r}", "ThDepth: 40.0"]
    lines += ["ORBextractor.nFeatures: 2000", "ORBextractor.scaleFactor: 1.2", "ORBextractor.nLevels: 8"]
    lines += ["ORBextractor.iniThFAST: 20", "ORBextractor.minThFAST: 7"]
    viewer = ("KeyFrameSize", "KeyFrameLineWidth", "GraphLineWidth", "PointSize", "CameraSize", "CameraLineWidth")
    lines += [f"Viewer.{name}: 1.0" for name in (*viewer, "ViewpointX", "ViewpointY", "ViewpointZ", "ViewpointF")]
    return "\n".join(lines) + "\n"


def _words(job: Job) -> str:
    """A tree of ORB descriptors in DBoW2's text form: of each node's descriptors some are drawn as its branches."""
    orb, rng = cv2.ORB_create(800), np.random.default_rng(_SEED)
    found = [orb.detectAndCompute(images[0], None)[1] for images in job.images(every=5)]
    rows = [f"{_BRANCHES} {_LEVELS} 0 0"]

    def divide(parent: int, own: np.ndarray, level: int) -> None:
        centres = own[rng.choice(len(own), min(_BRANCHES, len(own)), replace=False)]
        far = np.bitwise_count(own[:, None] ^ centres[None]).sum(axis=2)
        nearest = far.argmin(axis=1)
        for k, centre in enumerate(centres):
            inside = own[nearest == k]
            leaf = level == _LEVELS or len(inside) < 2
            rows.append(" ".join([str(parent), str(int(leaf)), *map(str, centre.tolist()), "1.0" if leaf else "0"]))
            if not leaf:
                divide(len(rows) - 1, inside, level + 1)

    divide(0, np.concatenate([d for d in found if d is not None]), 1)
    return "\n".join(rows) + "\n"


if __name__ == "__main__":
    main(run)
