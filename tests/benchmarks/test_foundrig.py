"""A rig of one half of a survey on the other: the halves share nothing, and a drawing is off by its rounding."""

from dataclasses import replace
from pathlib import Path

import numpy as np
from benchmarks.confront.given import Given, Picture, Truth, pinhole
from benchmarks.foundrig import drawn, halves
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms
from tiegraph.scan.rigfiles.rigspec import orient
from tiegraph.scene.rig import Rig, Sensor

TURNED = transforms.invert(transforms.rigid(orient(73.4, 1.9, -3.1), np.array([0.33, -0.04, 1.16])))
RIG = Rig(
    "car",
    (
        Sensor("a", pinhole(64, 48, 50.0), np.eye(4), folder="a"),
        Sensor("b", pinhole(64, 48, 50.0), TURNED, folder="b"),
    ),
    fixed=True,
)


def test_the_halves_are_the_frames_of_the_first_and_the_second():
    names = [f"{c}/{k:02d}.jpg" for k in range(7) for c in "ab"]
    given = Given({n: Picture(Path(n)) for n in names}, Truth({n: np.eye(4) for n in names}), RIG)
    first, second = halves(given)
    assert sorted([*first.images, *second.images]) == sorted(names) and len(first.images) == 6
    assert max(n[2:] for n in first.images) < min(n[2:] for n in second.images)
    assert set(second.truth.cam_from_world) == set(second.images)


def test_a_drawing_is_off_by_its_rounding_and_knows_no_camera():
    rig = drawn(replace(RIG))
    assert rig.nominal and not rig.fixed and all(s.camera is None for s in rig.sensors)
    off = rig.sensors[1].sensor_from_rig @ transforms.invert(TURNED)
    assert 0.5 < np.degrees(Rotation.from_matrix(off[:3, :3]).magnitude()) < 4.4
    np.testing.assert_allclose(transforms.invert(rig.sensors[1].sensor_from_rig)[:3, 3], [0.3, 0.0, 1.2], atol=1e-9)
    np.testing.assert_allclose(rig.sensors[0].sensor_from_rig, np.eye(4), atol=1e-12)
