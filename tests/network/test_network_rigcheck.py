"""The sense of rotation and the roll of a rig, against synthetic and real images."""

import json
import os
from dataclasses import replace
from functools import cache
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest
from boat_world import Result, boat, ring
from scipy.spatial.transform import Rotation

from tiegraph.features.preview import extract_preview, match_previews
from tiegraph.features.preview_settings import PreviewSettings
from tiegraph.geometry import transforms
from tiegraph.network.passes import PreviewBook, find_passes
from tiegraph.network.rigcheck import check_rig, check_rigs
from tiegraph.network.settings import NetworkSettings
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene

SETTINGS = NetworkSettings()
DATA = Path(os.environ.get("TIEGRAPH_DATA", "../shared/data"))


def changed(rig: Rig, change: np.ndarray) -> Rig:
    pose = transforms.rigid(change, np.zeros(3))
    back = np.linalg.inv(pose)
    return replace(rig, sensors=tuple(replace(s, sensor_from_rig=pose @ s.sensor_from_rig @ back) for s in rig.sensors))


def axes(rig: Rig) -> np.ndarray:
    return np.stack([s.optical_axis() for s in rig.sensors])


@pytest.mark.parametrize("mirror, roll", [(False, 0), (True, 0), (False, 90), (True, 270), (False, 180)])
def test_wrong_presets_are_corrected(mirror: bool, roll: int) -> None:
    turn = Rotation.from_euler("z", roll, degrees=True).as_matrix() @ np.diag([-1.0 if mirror else 1.0, 1, 1])
    world = boat((10, 10), (2.0, 2.0))
    scene = world.scene.with_(rigs=(changed(ring(), turn),))
    checked, notes = check_rigs(scene, find_passes(scene), PreviewBook(world.match, len(scene)), SETTINGS)
    # The camera that looks up shares nothing with the others: what hangs on it alone cannot be told.
    assert np.allclose(axes(checked.rigs[0])[:5], axes(ring())[:5], atol=1e-6)
    assert ("corrected" in notes[0]) == (mirror or roll > 0)
    if not mirror and not roll:
        assert "agree" in notes[0]


def test_a_calibrated_rig_is_told_of_and_kept() -> None:
    world = boat((10, 10), (2.0, 2.0))
    rig = replace(changed(ring(), np.diag([-1.0, 1, 1])), fixed=True)
    outcome = check_rig(rig, find_passes(world.scene), PreviewBook(world.match, len(world.scene)), SETTINGS)
    assert not outcome.changed and outcome.rig is rig
    assert "mirrored" in outcome.note and "kept" in outcome.note


def test_too_few_matches_are_said() -> None:
    world = boat((10,), (2.0,))
    book = PreviewBook(lambda pairs: [Result(3) for _ in pairs], len(world.scene))
    outcome = check_rig(ring(), find_passes(world.scene), book, SETTINGS)
    assert not outcome.changed and "could not be checked" in outcome.note


def test_swapped_stereo_cameras_are_found() -> None:
    camera = pycolmap.Camera(model="SIMPLE_PINHOLE", width=640, height=480, params=[500.0, 320.0, 240.0])
    right = transforms.rigid(np.eye(3), np.array([-0.5, 0, 0]))
    left = transforms.rigid(np.eye(3), np.array([0.5, 0, 0]))
    scene = simple_scene(
        Rig("stereo", (Sensor("a", camera, np.eye(4)), Sensor("b", camera, left)), nominal=True),
        [f"{s}/{k}.jpg" for s in "ab" for k in range(10)],
        np.tile(np.arange(10), 2),
        np.repeat([0, 1], 10),
        np.zeros(10),
        tracks=("all",),
    )
    # b stands right of a: things move to the left from a to b.
    book = PreviewBook(lambda pairs: [Result(80, np.eye(3), np.array([-0.05, 0.0])) for _ in pairs], len(scene))
    checked, notes = check_rigs(scene, find_passes(scene), book, SETTINGS)
    assert np.allclose(checked.rigs[0].sensors[1].sensor_from_rig, right)
    assert "corrected" in notes[0]


def test_rigs_without_poses_are_left_alone() -> None:
    world = boat((4,), (2.0,), ring(5))
    bare = Rig("rig", tuple(Sensor(s.name, s.camera) for s in ring().sensors))
    scene = world.scene.with_(rigs=(bare,))
    checked, notes = check_rigs(scene, find_passes(scene), PreviewBook(world.match, len(scene)), SETTINGS)
    assert notes == () and checked.rigs[0] is bare


def canal_demo(mirrored: bool) -> tuple[Scene, PreviewBook]:
    folder = DATA / "canal_demo"
    if not (folder / "images").is_dir():
        pytest.skip(f"{folder} not there")
    names = sorted(p.relative_to(folder / "images").as_posix() for p in (folder / "images").rglob("*.jpg"))
    camera = pycolmap.Camera(model="SIMPLE_PINHOLE", width=480, height=360, params=[0.48 * 480, 240, 180])
    table = json.loads((folder / "sensors" / "rig_nominal.json").read_text())
    poses = [
        transforms.from_quaternion_wxyz(np.array(p["cam_from_body_qwxyz"]), np.array(p["cam_from_body_t"]))
        for _, p in sorted(table.items())
    ]
    from_rig = [p @ np.linalg.inv(poses[0]) for p in poses]
    sensors = [Sensor(f"cam{k}", camera, from_rig[k], "up" if k == 5 else "side") for k in range(6)]
    rig = Rig("ladybug5", tuple(sensors), nominal=True)
    if mirrored:
        rig = changed(rig, np.diag([-1.0, 1, 1]))
    frames = sorted({(n.split("/")[0], n.split("/")[2]) for n in names})
    place = {f: k for k, f in enumerate(frames)}
    tracks = sorted({f[0] for f in frames})
    scene = simple_scene(
        rig,
        names,
        np.array([place[n.split("/")[0], n.split("/")[2]] for n in names]),
        np.array([int(n.split("/")[1][3:]) for n in names]),
        np.array([tracks.index(f[0]) for f in frames]),
        np.array([int(f[1].split(".")[0]) for f in frames]),
        tracks=tuple(tracks),
    )
    settings = PreviewSettings()

    @cache
    def preview(k: int) -> object:
        return extract_preview(cv2.imread(str(folder / "images" / names[k]), cv2.IMREAD_GRAYSCALE), None, settings)

    def match(pairs: np.ndarray) -> list:
        return [match_previews(preview(i), preview(j), camera, camera, settings) for i, j in pairs.tolist()]

    return scene, PreviewBook(match, len(scene))


@pytest.mark.slow
@pytest.mark.parametrize("mirrored", [False, True])
def test_real_images_tell_a_mirrored_preset(mirrored: bool) -> None:
    scene, book = canal_demo(mirrored)
    truth = canal_demo(False)[0].rigs[0]
    checked, notes = check_rigs(scene, find_passes(scene), book, SETTINGS)
    assert np.allclose(axes(checked.rigs[0]), axes(truth), atol=1e-6)
    assert ("mirrored: corrected" in notes[0]) == mirrored
