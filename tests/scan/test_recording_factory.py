"""Insta360's factory calibration: three forms of one camera's, which is public, tell the same lens."""

from __future__ import annotations

import numpy as np
import pycolmap
import pytest

from tiegraph.scan.recording.insta360 import factory_lenses

# An X5's (Insta360Develop/Desktop-CameraSDK-Cpp, issue 85).
OLD = "2_2657.621_2684.250_2687.750_-0.259_-0.011_89.729_2651.033_8066.330_2692.030_0.247_-0.221_89.754_10752_5376_1137"
SPHERE = (
    "2_2.000000_4291.910_4291.470_2684.250_2687.750_-0.259_-0.011_89.729_0.000000_0.000000_0.000000_0.18322477_"
    "2.08857179_-3.36655450_0.00089921_0.00038060_10752_5376_113_2.000000_4278.090_4278.390_8066.330_2692.030_0.247_"
    "-0.221_89.754_0.000792_0.000132_-0.031986_0.18963484_2.04539418_-3.23319674_0.00101338_0.00195932_10752_5376_113_"
    "197632"
)
RADIUS = 2657.621, 2651.033  # at 100 degrees, as the old form states it
POLYNOMIAL = (  # form 2: the same radius, and its polynomial of the angle
    (2663.416, (1.0, -0.18974844, 0.27346808, -0.09002038)),
    (2658.524, (1.0, -0.18765773, 0.27116153, -0.08905181)),
)


@pytest.mark.parametrize("number", [0, 1])
def test_the_sphere_is_the_lens_that_the_other_forms_describe(number: int) -> None:
    found = factory_lenses(f"{OLD} {SPHERE}")
    assert found is not None
    lens = found[number]
    assert 1e-4 < abs(float(lens.radius_px(np.radians(100.0))) / RADIUS[number] - 1) < 2e-3
    stated, coefficients = POLYNOMIAL[number]
    angle = np.radians(np.arange(20, 101, 5.0))
    curve = sum(c * angle ** (n + 1) for n, c in enumerate(coefficients))
    assert 1e-4 < np.max(np.abs(lens.radius_px(angle) / (stated * curve / curve[-1]) - 1)) < 4e-3


@pytest.mark.parametrize("number, width", [(0, 5376), (1, 2880)])
def test_colmaps_lens_is_the_sphere_to_a_tenth_of_a_pixel(number: int, width: int) -> None:
    found = factory_lenses(SPHERE)
    assert found is not None
    params = found[number].opencv_fisheye(number, width)
    camera = pycolmap.Camera(model="OPENCV_FISHEYE", width=width, height=width, params=params)
    angle = np.radians(np.arange(1.0, 88.0))
    at = np.asarray(camera.img_from_cam(np.column_stack([np.sin(angle), 0 * angle, np.cos(angle)])))
    scale = width / 5376
    centre = scale * (np.array([2684.25, 2687.75]) if number == 0 else np.array([8066.33 - 5376, 2692.03]))
    assert np.allclose(at[:, 1], centre[1])
    assert np.max(np.abs(at[:, 0] - centre[0] - scale * found[number].radius_px(angle))) < 0.1


def test_the_newest_form_that_can_be_read_is_taken() -> None:
    old, both = factory_lenses(OLD), factory_lenses(f"{OLD} {SPHERE}")
    assert old is not None and both is not None
    assert [lens.roll_deg for lens in old] == [lens.roll_deg for lens in both] == [89.729, 89.754]
    assert not old[0].sphere and both[0].sphere and old[0].centre_px == both[0].centre_px
    assert factory_lenses(f"{SPHERE.removesuffix('197632')}132096 {OLD}") == old  # its last number says another form
    assert factory_lenses(f"{OLD} {SPHERE.replace('2_2.0', '1_2.0', 1)}") == old


@pytest.mark.parametrize("text", ["", "2_1", OLD.replace("10752", "0"), OLD.replace("5376", "4000"),
                                  SPHERE.replace("10752", "9" * 400), SPHERE.replace("10752", "10000", 1)])  # fmt: skip
def test_words_that_are_no_lenses(text: str) -> None:
    assert factory_lenses(text) is None


def test_numbers_of_no_lens_give_no_camera() -> None:
    found = factory_lenses(SPHERE.replace("4291.910", "0").replace("4291.470", "0"))
    assert found is not None and found[0].opencv_fisheye(0, 1000) == ()
