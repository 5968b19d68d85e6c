"""Poses by image, a COLMAP model and nerfstudio's transforms.json, as the trajectory of a scan."""

from __future__ import annotations

import json
import shutil
from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest
from scan_worlds import papers_rig, picture, scan
from scipy.spatial.transform import Rotation

from tiegraph.errors import InputError
from tiegraph.geometry.transforms import angle_deg, rigid
from tiegraph.scan.priors.trajectory import read_trajectory
from tiegraph.scan.settings import ScanSettings
from tiegraph.scene.scene import Scene

CANAL = Path(__file__).parents[2] / "examples" / "canal"


def truth() -> dict[str, np.ndarray]:
    """world_from_camera of the canal's images, by COLMAP's text format: id, qw qx qy qz, tx ty tz, camera, name."""
    out = {}
    for line in (CANAL / "truth" / "colmap" / "images.txt").read_text().splitlines():
        cells = line.split()
        if line and not line.startswith("#") and len(cells) == 10:
            w, x, y, z = (float(v) for v in cells[1:5])
            camera = rigid(Rotation.from_quat([x, y, z, w]).as_matrix(), np.array(cells[5:8], float))
            out[cells[9]] = np.linalg.inv(camera)
    return out


def same(scene: Scene, expected: dict[str, np.ndarray], folder: str = "cam0") -> int:
    """How many frames have the poses of the rig's first camera."""
    count = 0
    for k in range(scene.frames):
        name = f"{scene.sequences[scene.sequence[k]]}/{folder}/{scene.sequence_index[k]:06d}.jpg"
        if name in expected:
            np.testing.assert_allclose(scene.world_from_rig[k], expected[name], rtol=0, atol=1e-6)
            count += 1
    return count


def transforms(poses: dict[str, np.ndarray], prefix: str = "./images/", **more: object) -> str:
    """As nerfstudio writes it: camera to world, x right, y up, z backward."""
    to_opengl = np.diag([1.0, -1.0, -1.0, 1.0])
    frames = [{"file_path": prefix + n, "transform_matrix": (p @ to_opengl).tolist()} for n, p in poses.items()]
    return json.dumps({"camera_model": "OPENCV", "w": 64, "h": 48, "frames": frames, **more})


def test_a_colmap_model_is_a_trajectory() -> None:
    scene = scan(CANAL / "images", rig=str(CANAL / "rig.toml"), trajectory=CANAL / "truth" / "colmap")
    assert scene.prior == "trajectory" and same(scene, truth()) == 20
    assert any("colmap: the trajectory is taken as poses of 120 images by their names" in n for n in scene.notes)
    assert not any("body frame" in n for n in scene.notes)


@pytest.mark.slow
def test_a_transforms_json_gives_the_same_poses(tmp_path: Path) -> None:
    poses = truth()
    (tmp_path / "transforms.json").write_text(transforms(poses))
    for path in (tmp_path / "transforms.json", tmp_path):
        scene = scan(CANAL / "images", rig=str(CANAL / "rig.toml"), trajectory=path)
        assert same(scene, poses) == 20
    first = poses["up/cam0/000000.jpg"]
    found = read_trajectory(tmp_path)
    np.testing.assert_allclose(found.poses[found.names.index("./images/up/cam0/000000.jpg")], first, atol=1e-9)
    as_written = np.array(json.loads((tmp_path / "transforms.json").read_text())["frames"][0]["transform_matrix"])
    assert angle_deg(as_written[:3, :3], poses[next(iter(poses))][:3, :3]) > 179  # OpenGL's axes are not ours


def test_a_frame_without_its_first_camera_has_the_pose_by_another(tmp_path: Path) -> None:
    """By the rig's geometry; frames and images that lack are said."""
    images = papers_rig(tmp_path / "in", ("up",), 2, 3)
    (tmp_path / "rig.toml").write_text(
        '[[sensors]]\nname = "cam0"\nposition_m = [0.0, 0.0, 0.0]\nyaw_pitch_roll_deg = [0.0, 0.0, 0.0]\n'
        '[[sensors]]\nname = "cam1"\nposition_m = [0.5, 0.0, 0.0]\n'
        "yaw_pitch_roll_deg = [90.0, 0.0, 0.0]\n"
    )
    bare = scan(images, rig=str(tmp_path / "rig.toml"))
    on_rig = bare.rigs[0].sensors[1].sensor_from_rig
    assert on_rig is not None and np.linalg.norm(on_rig[:3, 3]) == pytest.approx(0.5)
    rig = [rigid(Rotation.from_euler("xyz", [5 * k, 10, 0], degrees=True).as_matrix(), np.array([k, 2.0, 3])) for k in
           range(3)]  # fmt: skip
    poses = {
        "up/cam0/000000.jpg": rig[0],
        "up/cam1/000001.jpg": rig[1] @ np.linalg.inv(on_rig),
        "up/cam0/9.jpg": rig[2],
    }
    (tmp_path / "transforms.json").write_text(transforms(poses))
    scene = scan(images, rig=str(tmp_path / "rig.toml"), trajectory=tmp_path / "transforms.json")
    np.testing.assert_allclose(scene.world_from_rig[:2], rig[:2], atol=1e-9)
    assert np.isnan(scene.world_from_rig[2]).any()
    assert any("2 images by their names; 1 of 3 frames have none" in n for n in scene.notes)
    assert any("1 of 3 poses are of images that are not here, such as ./images/up/cam0/9.jpg" in n for n in scene.notes)


@pytest.mark.parametrize("written", ["images/a_{}.jpg", "a_{}.jpg", "./train/a_{}", "../x/images/a_{}.jpg"])
def test_names_as_programs_write_them(tmp_path: Path, written: str) -> None:
    images = tmp_path / "in"
    for k in range(4):
        picture(images / f"a_{k}.jpg")
    poses = {written.format(k): rigid(np.eye(3), np.array([k, 0.0, 0])) for k in range(4)}
    (tmp_path / "t.json").write_text(transforms(poses, prefix=""))
    scene = scan(images, ScanSettings(layout="loose"), trajectory=tmp_path / "t.json")
    assert scene.world_from_rig[:, 0, 3].tolist() == [0, 1, 2, 3]


def frame(**changed: object) -> dict:
    return {"file_path": "a.jpg", "transform_matrix": np.eye(4).tolist(), **changed}


def turned(*frames: object) -> str:
    return json.dumps({"frames": list(frames)})


MIRROR = np.diag([1.0, 1, -1, 1]).tolist()


@pytest.mark.parametrize(
    "text, words",
    [
        ("", r"line 1: no JSON"),
        (transforms({"a": np.eye(4)})[:-30], r"line 1: no JSON .*is the file cut off\?"),
        ("[1, 2]", "no list 'frames'"),
        ('{"frames": 3}', "no list 'frames'"),
        ('{"frames": []}', "no image has a pose"),
        (turned(3), "frame 0: no file_path"),
        (turned(frame(), frame(file_path="")), "frame 1: no file_path"),
        (turned(frame(transform_matrix=[[1, 2], [3, 4]])), r"frame 0 \(a.jpg\): transform_matrix is no 4 x 4"),
        (turned(frame(transform_matrix="x")), r"frame 0 \(a.jpg\): transform_matrix is no 4 x 4"),
        (turned(frame(transform_matrix=(2 * np.eye(4)).tolist())), r"frame 0 \(a.jpg\): .*scaled, or mirrored"),
        (turned(frame(transform_matrix=MIRROR)), r"frame 0 \(a.jpg\): .*scaled, or mirrored"),
        (turned(frame(), frame(transform_matrix=[[1, 0, 0, 5], [0, 1, 0, 0], [0, 0, 1, 0]])), "frame 1: a.jpg has an"),
        (turned(frame(), frame(file_path="b.jpg")), "all 2 poses are the same"),
    ],
)  # fmt: skip
def test_a_transforms_json_that_is_none(tmp_path: Path, text: str, words: str) -> None:
    (tmp_path / "transforms.json").write_text(text)
    with pytest.raises(InputError, match=words) as error:
        read_trajectory(tmp_path / "transforms.json")
    assert "transforms.json" in str(error.value)


def test_poses_of_other_images_are_refused(tmp_path: Path) -> None:
    images = papers_rig(tmp_path / "in", ("up",), 1, 3)
    (tmp_path / "t.json").write_text(
        transforms({f"{k}.png": rigid(np.eye(3), np.array([k, 0.0, 0])) for k in range(3)})
    )
    with pytest.raises(
        InputError, match=r"t.json: none of its 3 images is here: ./images/0.png .*as up/cam0/000000.jpg"
    ):
        scan(images, trajectory=tmp_path / "t.json")


def test_the_folder_above_a_model_says_where_it_is(tmp_path: Path) -> None:
    images = papers_rig(tmp_path / "in", ("up",), 1, 3)
    shutil.copytree(CANAL / "truth" / "colmap", tmp_path / "sparse" / "0")
    with pytest.raises(InputError, match=r"--trajectory .*/sparse: no poses in it; .*/sparse/0 has some: give that"):
        scan(images, trajectory=tmp_path / "sparse")


@pytest.mark.parametrize("cut", [10, 400, 3000])
def test_a_damaged_model_is_a_named_error(tmp_path: Path, cut: int) -> None:
    shutil.copytree(CANAL / "truth" / "colmap", tmp_path / "model")
    text: Sequence[str] = (tmp_path / "model" / "images.txt").read_text()
    (tmp_path / "model" / "images.txt").write_text(str(text)[:cut])
    try:
        found = read_trajectory(tmp_path / "model")
    except InputError as error:
        assert "model" in str(error)
    else:
        assert 0 < len(found) < 120
