"""Images that hang on a rig see no sparse points: they are matched within their frame."""

import numpy as np
import pycolmap

from tiegraph.dense.settings import DenseSettings
from tiegraph.dense.shot import plan_hanging
from tiegraph.dense.tuning import Tuning
from tiegraph.scene.hanging import with_hanging
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import simple_scene

PLACES = {"wide": (0.0, 0, 0), "a": (-0.04, 0, 0), "b": (0.04, 0, 0)}


def lens() -> pycolmap.Camera:
    camera = pycolmap.Camera(model="PINHOLE", width=200, height=160, params=[180, 180, 100, 80], camera_id=1)
    camera.has_prior_focal_length = True
    return camera


def hung(points: int, frames: int = 2) -> pycolmap.Reconstruction:
    """A wide camera that sees points 0.5 to 1 m away, and two that hang on it."""
    sensors = []
    for name, place in PLACES.items():
        pose = np.eye(4)
        pose[:3, 3] = -np.array(place)
        sensors.append(Sensor(name, lens(), pose, role="wide" if name == "wide" else "side", folder=name))
    rows = sorted((f"{s}/{f}.png", f, k) for k, s in enumerate(PLACES) for f in range(frames))
    names, frame, sensor = zip(*rows)
    scene = simple_scene(Rig("head", tuple(sensors)), list(names), np.array(frame), np.array(sensor))
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(lens())
    for k in range(frames):
        image = pycolmap.Image(name=f"wide/{k}.png", camera_id=1, image_id=k + 1, keypoints=np.ones((points, 2)))
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(np.eye(4)[:3]))
    for row, depth in enumerate(np.linspace(0.5, 1, points)):
        track = pycolmap.Track([pycolmap.TrackElement(k + 1, row) for k in range(frames)])
        model.add_point3D(np.array([0, 0, depth]), track)
    return with_hanging(model, scene)


def test_partners_are_those_of_the_frame():
    names = {"a/0.png", "a/1.png", "b/0.png", "b/1.png"}
    plan = plan_hanging(hung(20), names, DenseSettings(), Tuning())
    assert set(plan.images) == names and plan.dropped == ()
    one = plan.images["a/1.png"]
    assert [p.name for p in one.partners] == ["b/1.png"] == list(one.witnesses)
    assert 0.2 < one.depth_range.near < 0.5 and 1 < one.depth_range.far < 1.5


def test_a_frame_that_sees_too_little_is_left_out_with_the_reason():
    plan = plan_hanging(hung(3), {"a/0.png", "b/0.png"}, DenseSettings(), Tuning())
    assert not plan.images and [n for n, _ in plan.dropped] == ["a/0.png", "b/0.png"]
    assert "see 3 points: too few" in plan.dropped[0][1]
