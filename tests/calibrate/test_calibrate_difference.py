"""Two calibrations side by side."""

import numpy as np
import pycolmap
import pytest
from scipy.spatial.transform import Rotation

from tiegraph.calibrate.difference import Calibration, differences
from tiegraph.errors import InputError
from tiegraph.geometry import transforms


def camera(focal: float = 1000.0, cx: float = 480.0, k1: float = -0.1, size: tuple[int, int] = (960, 720)):
    params = [focal, focal, cx, size[1] / 2, k1, 0.0, 0.0, 0.0]
    return pycolmap.Camera(model="OPENCV", width=size[0], height=size[1], params=params)


def pose(yaw_deg: float, place: tuple[float, float, float]) -> np.ndarray:
    rotation = Rotation.from_euler("y", yaw_deg, degrees=True).as_matrix()
    return transforms.rigid(rotation, -rotation @ np.array(place))


def test_what_differs_is_told_in_its_unit_and_in_sigmas():
    first = [
        Calibration("a", camera(), np.eye(4), focal_sigma_px=0.3),
        Calibration("b", camera(), pose(30.0, (0.2, 0, 0)), 0.3, 0.01, 0.0005),
    ]
    second = [
        Calibration("b", camera(1002.0), pose(30.05, (0.203, 0, 0)), 0.4, 0.01, 0.0005),
        Calibration("a", camera(), np.eye(4)),
    ]
    same, other = differences(first, second)
    assert (same.name, same.focal, same.focal_sigmas) == ("a", 0.0, 0.0) and same.lens_px < 1e-6
    assert np.isnan(same.turn_deg) and same.worst_sigmas() == 0
    assert other.focal == pytest.approx(0.002) and other.focal_sigmas == pytest.approx(4.0)
    assert 0.3 < other.lens_px < 1.0  # 2 px of focal length at the edge, 0.96 at most
    assert other.turn_deg == pytest.approx(0.05) and other.place_m == pytest.approx(0.003)
    assert other.turn_sigmas == pytest.approx(0.05 / np.sqrt(6) / 0.01)
    assert other.place_sigmas == pytest.approx(3 / np.sqrt(6) / 0.5) and other.worst_sigmas() == other.focal_sigmas


def test_the_lens_is_compared_beyond_what_a_turn_explains():
    (shifted,) = differences([Calibration("a", camera())], [Calibration("c", camera(cx=490.0))])
    (bent,) = differences([Calibration("a", camera())], [Calibration("c", camera(k1=-0.12))])
    assert 0.2 < shifted.lens_px < 3 and np.isnan(shifted.focal_sigmas)  # ten pixels of a centre are mostly a turn
    assert 0.5 < bent.lens_px < 5


def test_sizes_are_brought_together_or_refused():
    (row,) = differences([Calibration("a", camera())], [Calibration("a", camera(500.0, 240.0, size=(480, 360)))])
    assert abs(row.focal) < 1e-9 and row.lens_px < 1.0
    with pytest.raises(InputError, match="another shape"):
        differences([Calibration("a", camera())], [Calibration("a", camera(size=(720, 960)))])
    with pytest.raises(InputError, match="no camera is in both"):
        differences([Calibration(n, camera()) for n in "ab"], [Calibration(n, camera()) for n in "cd"])
