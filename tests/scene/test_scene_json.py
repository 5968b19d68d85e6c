import numpy as np
import pycolmap

from tiegraph.geometry.geodesy import make_origin
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Dropped, Scene, simple_scene


def scene():
    camera = pycolmap.Camera(model="OPENCV", width=64, height=48, params=[30, 31, 32, 24, 0.1, 0, 0, 0])
    turned = np.eye(4)
    turned[:3, :3] = [[0, 0, 1], [0, 1, 0], [-1, 0, 0]]
    turned[:3, 3] = [0.1, 0, 0]
    rig = Rig("boat", (Sensor("cam0", camera, np.eye(4)), Sensor("cam1", camera, turned), Sensor("up", role="up")),
              antenna_m=(0, 0, 1.5))  # fmt: skip
    return simple_scene(rig, ["a/0", "a/1", "b/0"], np.array([0, 1, 0]), np.array([0, 0, 1]), np.zeros(2),
                        origin=make_origin(35, 139, 10), dropped=(Dropped("x.jpg", "truncated"),), sequences=("up",),
                        time_s=np.array([5.0, np.nan]))  # fmt: skip


def test_json_round_trip():
    one = scene()
    two = Scene.from_json(one.to_json())
    assert two.to_json() == one.to_json()
    assert two.names == one.names and two.dropped == one.dropped and two.origin == one.origin
    assert two.rigs[0].antenna_m == (0, 0, 1.5)
    np.testing.assert_array_equal(two.time_s, one.time_s)
    assert two.rigs[0].sensors[0].camera.params.tolist() == one.rigs[0].sensors[0].camera.params.tolist()


def test_exposure_is_there_where_it_is_known():
    one = scene().with_(exposure=np.array([0.25, np.nan, 2.0]))
    assert scene().exposure is None and Scene.from_json(scene().to_json()).exposure is None
    np.testing.assert_array_equal(Scene.from_json(one.to_json()).exposure, one.exposure)
    np.testing.assert_array_equal(one.only(np.array([0, 2])).exposure, [0.25, 2.0])


def test_rig_geometry_and_priors():
    rig = scene().rigs[0]
    assert abs(rig.axis_angles_deg()[0, 1] - 90) < 1e-9
    assert np.isnan(rig.axis_angles_deg()[0, 2]) and not rig.known()
    pose = np.full((2, 4, 4), np.nan)
    pose[0] = np.eye(4)
    priors = scene().with_(world_from_rig=pose).image_priors()
    np.testing.assert_allclose(np.linalg.inv(priors[2]), rig.sensors[1].sensor_from_rig, atol=1e-12)
    assert np.isnan(priors[1]).all()


def test_a_part_of_a_scene_keeps_what_its_images_are():
    whole = scene().with_(sources=("p", "q", "r"))
    part = whole.only(np.array([1, 2]))
    assert part.names == ("a/1", "b/0") and part.sources == ("q", "r") and part.frames == 2
    assert part.frame.tolist() == [1, 0] and part.sequence_index[part.frame].tolist() == [1, 0]
    assert part.sensor_key.tolist() == whole.sensor_key[1:].tolist()
    last = whole.only(np.array([1]))
    assert last.frames == 1 and last.frame.tolist() == [0] and np.isnan(last.time_s).all()
    assert last.world_from_rig.shape == (1, 4, 4) and last.origin == whole.origin
