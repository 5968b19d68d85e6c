"""The closed forms of a station: paper 004's table 1, rays by least squares, motion, advice, what is refused."""

import math

import numpy as np
import pycolmap
import pytest

from said import refused
from tiegraph.plan.accuracy import own_variance
from tiegraph.plan.figures import Lens, Wanted, advice, rays_gain, station
from tiegraph.plan.request import CameraRequest, ImageRequest
from tiegraph.plan.tuning import Tuning

TUNING = Tuning().station
LENS = Lens(8 / 0.00345, (2448, 2048))  # paper 004: 8 mm, 3.45 um, 5 MP


@pytest.mark.parametrize(
    "distance, precision_mm, points, footprint_cm",
    [
        (0.5, 0.431, 21.5, (45, 36)),
        (0.7, 0.845, 11.0, (65, 53)),
        (1.0, 1.725, 5.4, (98, 81)),
        (1.2, 2.484, 3.7, (119, 98)),
    ],
)
def test_table_1_of_paper_004(distance, precision_mm, points, footprint_cm):
    made = station(LENS, distance, Wanted(base_m=0.075, match_px=0.3), TUNING)
    assert round(1000 * made.precision_m[0], 3) == precision_mm
    assert round(made.points_mm2, 1) == points
    # The paper's footprint is what all four cameras of the square see; its 65 cm should be 66.
    common = [100 * (side - 0.075) for side in made.footprint_m]
    assert common == pytest.approx(footprint_cm, abs=1.5)


@pytest.mark.parametrize("rays", [2, 3, 5])
def test_precision_by_rays_is_that_of_least_squares(rays):
    """Rays in a row to a point far away: the normal equations say the same as the closed form."""
    made = station(LENS, 1.0, Wanted(base_m=0.05, match_px=0.3), TUNING)
    model = row_of_cameras(rays, 0.05, 1.0)
    depth = math.sqrt(own_variance(model, np.array([1]))[0, 2]) * 0.3 / math.sqrt(2)  # a disparity is of two images
    assert 0.97 < depth / made.precision_m[rays - 2] < 1.03
    assert made.precision_m[rays - 2] == pytest.approx(made.precision_m[0] * rays_gain(rays))


def row_of_cameras(count: int, base: float, distance: float) -> pycolmap.Reconstruction:
    """Cameras side by side that see one point before their middle."""
    model = pycolmap.Reconstruction()
    params = [LENS.focal_px, LENS.focal_px, 1224, 1024]
    model.add_camera_with_trivial_rig(
        pycolmap.Camera(model="PINHOLE", width=2448, height=2048, params=params, camera_id=1)
    )
    point = np.array([(count - 1) / 2 * base, 0, distance])
    for k in range(count):
        pose = pycolmap.Rigid3d(np.column_stack([np.eye(3), [-k * base, 0, 0]]))
        xy = model.camera(1).img_from_cam(pose * point)
        image = pycolmap.Image(name=str(k), camera_id=1, image_id=k + 1, keypoints=np.atleast_2d(xy))
        model.add_image_with_trivial_frame(image, pose)
    model.add_point3D(point, pycolmap.Track([pycolmap.TrackElement(k + 1, 0) for k in range(count)]))
    return model


def test_the_base_comes_from_what_is_said_first():
    both = {"overlap": 0.8, "speed_m_s": 2.0, "rate_hz": 4.0}
    assert station(LENS, 5.0, Wanted(base_m=0.3, **both), TUNING).base_m == 0.3
    assert station(LENS, 5.0, Wanted(**both), TUNING).base_m == 0.5
    made = station(LENS, 5.0, Wanted(overlap=0.8), TUNING)
    assert made.base_m == pytest.approx(0.2 * 5.0 / LENS.focal_px * 2448)
    assert made.overlap == pytest.approx(0.8)
    upright = station(Lens(LENS.focal_px, LENS.size, along=1), 5.0, Wanted(overlap=0.8), TUNING)
    assert upright.base_m == pytest.approx(0.2 * 5.0 / LENS.focal_px * 2048)


def test_motion_blur_and_the_exposure_that_avoids_it():
    made = station(LENS, 2.0, Wanted(speed_m_s=1.5, rate_hz=10.0, exposure_s=0.002), TUNING)
    assert made.blur_px == pytest.approx(1.5 * 0.002 / made.gsd_m)
    assert made.exposure_s == pytest.approx(0.5 * made.gsd_m / 1.5)
    longest = Wanted(speed_m_s=1.5, rate_hz=10.0, exposure_s=made.exposure_s)
    assert station(LENS, 2.0, longest, TUNING).blur_px == pytest.approx(TUNING.blur_px)


def test_what_is_advised_gives_what_is_wanted():
    wanted = Wanted(overlap=0.9, precision_m=0.002, speed_m_s=2.0, rate_hz=2.0, exposure_s=0.01)
    made = station(LENS, 5.0, wanted, TUNING)
    said = advice(made, LENS, wanted)
    assert len(said) == 3
    base = float(said[0].split("a base of ")[1].split(" m")[0])
    better = station(LENS, 5.0, Wanted(base_m=base, precision_m=0.002), TUNING)
    assert 0.99 < better.precision_m[0] / 0.002 < 1.01
    nearer = station(LENS, made.farthest_m, wanted, TUNING)
    assert nearer.precision_m[0] == pytest.approx(0.002)
    speed = float(said[1].split("go ")[1].split(" m/s")[0])
    assert station(LENS, 5.0, Wanted(speed_m_s=speed, rate_hz=2.0), TUNING).overlap == pytest.approx(0.9, abs=0.002)
    assert "expose" in said[2]
    assert not advice(better, LENS, Wanted(base_m=base, precision_m=0.00201))


def test_images_too_far_apart_are_said_to_show_nothing():
    made = station(LENS, 1.0, Wanted(base_m=5.0), TUNING)
    assert made.overlap == 0 and made.precision_m == ()
    assert "do not overlap" in advice(made, LENS, Wanted(base_m=5.0))[0]


@pytest.mark.parametrize(
    "make, said",
    [
        (lambda: CameraRequest(focal=0.0, pixel=3.45).focal_length_px(), "--focal 0"),
        (lambda: CameraRequest(focal=8.0, pixel=-1.0).focal_length_px(), "--pixel -1"),
        (lambda: CameraRequest(focal=8.0).focal_length_px(), "--pixel too"),
        (lambda: CameraRequest(focal=8.0, focal_px=100.0).focal_length_px(), "say the same"),
        (lambda: CameraRequest(focal=8.0, pixel=3.0, sensor=7.0).focal_length_px(), "say the same"),
        (lambda: CameraRequest(size="0x5").image_size(), "--size 0x5"),
        (lambda: CameraRequest(size="large").image_size(), "2448x2050"),
        (lambda: Wanted(overlap=1.0), "--overlap 1"),
        (lambda: Wanted(overlap=-0.1), "--overlap -0.1"),
        (lambda: Wanted(precision_m=0.0), "--precision 0"),
        (lambda: Wanted(base_m=float("nan")), "--base nan"),
        (lambda: Wanted(speed_m_s=2.0), "without --rate"),
        (lambda: Wanted(rate_hz=2.0), "without --speed"),
        (lambda: Wanted(speed_m_s=-1.0, rate_hz=2.0), "--speed -1"),
        (lambda: Wanted(exposure_s=0.001), "without --speed"),
        (lambda: station(LENS, -1.0, Wanted(overlap=0.8), TUNING), "--distance -1"),
        (lambda: station(LENS, 1.0, Wanted(), TUNING), "--overlap, --base"),
        (lambda: ImageRequest().distances(), "--distance"),
        (lambda: ImageRequest(distance="1,x").distances(), "--distance 1,x"),
        (lambda: ImageRequest(sidelap=1.0).wanted(None, None), "--sidelap 1"),
    ],
)
def test_what_makes_no_survey_is_refused_by_name(make, said):
    with refused(said):
        make()


def test_the_focal_length_by_pitch_or_by_sensor():
    by_pitch = CameraRequest(focal=8.0, pixel=3.45, size="2448x2048").focal_length_px()
    by_sensor = CameraRequest(focal=8.0, sensor=2448 * 0.00345, size="2448x2048").focal_length_px()
    assert by_pitch == pytest.approx(LENS.focal_px) == pytest.approx(by_sensor)
