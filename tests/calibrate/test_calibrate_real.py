"""OpenCV's own photographs of a checkerboard (Debian's package opencv-doc, or the folder OPENCV_SAMPLES)."""

import os
import shutil
from pathlib import Path

import numpy as np
import pytest

from tiegraph.cli.main import main
from tiegraph.scan.rigfiles.rigfile import read_rig_file
from tiegraph.scan.tuning import Tuning as ScanTuning

SAMPLES = Path(os.environ.get("OPENCV_SAMPLES", "/usr/share/doc/opencv-doc/examples/data"))


@pytest.mark.slow
@pytest.mark.skipif(not (SAMPLES / "left01.jpg").exists(), reason="Debian's opencv-doc is not there (OPENCV_SAMPLES)")
def test_a_real_stereo_head_is_calibrated_to_a_seventh_of_a_pixel(capsys, tmp_path):
    """Its board was trimmed: windows that reach over the edge made it a third of a pixel."""
    for side in ("left", "right"):
        (tmp_path / "images" / side).mkdir(parents=True)
        for file in sorted(SAMPLES.glob(f"{side}[01][0-9].jpg")):
            shutil.copy(file, tmp_path / "images" / side)
    arguments = ["calibrate", str(tmp_path / "images"), "--board", "checker:9x6:0.025"]
    assert main([*arguments, "-o", str(tmp_path / "rig.toml"), "--pool", "serial"]) == 0
    assert "left and right are 0.083" in " ".join(capsys.readouterr().err.split())
    (rig,) = read_rig_file(tmp_path / "rig.toml", ScanTuning().rig)
    left, right = rig.sensors
    assert left.params is not None and right.body_from_sensor is not None
    assert abs(left.params[0] - 535.9) < 3.0  # OpenCV's own left_intrinsics.yml, fewer images and another lens model
    assert 0.0829 < np.linalg.norm(right.body_from_sensor[:3, 3]) < 0.0835
    rows = [r.split("|") for r in (tmp_path / "rig_calibration/summary.md").read_text().splitlines()]
    fits = [[float(v) for v in r[4:6]] for r in rows if len(r) > 6 and r[1].strip() in ("left", "right")][:2]
    assert len(fits) == 2 and all(0.1 < rms <= held_out < 0.16 for rms, held_out in fits)
