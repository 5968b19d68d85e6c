"""Trajectories of a body, and poses by image (a COLMAP model, nerfstudio's transforms.json), as poses of frames."""

import json
import shutil
from pathlib import Path

import numpy as np
import pytest
from scan_worlds import Survey, data, flu_rig, gnss_csv, in_enu, papers_rig, picture, scan, times_csv, two_cameras_rig
from scipy.spatial.transform import Rotation

from said import refused, says
from tiegraph.errors import InputError
from tiegraph.geometry.transforms import angle_deg, rigid
from tiegraph.scan.priors.trajectory import read_trajectory
from tiegraph.scan.rigfiles.rigspec import orient
from tiegraph.scan.settings import ScanSettings
from tiegraph.scene.posefile import write_tum
from tiegraph.scene.scene import Scene


def drive(frames: int, turn_deg: float = 60.0) -> np.ndarray:
    """(F, 4, 4) world_from_body of a level body (x forward, y left, z up) on an arc from the origin, 1 m a frame."""
    yaw = np.radians(np.linspace(0, turn_deg, frames))
    step = np.stack([np.cos(yaw), np.sin(yaw), 0.02 * np.sin(4 * yaw)], axis=1)
    position = np.cumsum(step, axis=0) - step[0]
    return rigid(Rotation.from_rotvec(yaw[:, None] * [0.0, 0.0, 1.0]).as_matrix(), position)


def test_one_trajectory_as_long_as_the_pass(one_pass: Survey, tmp_path: Path) -> None:
    write_tum(tmp_path / "a.tum", 50 + np.arange(8.0), drive(8))
    scene = one_pass.scan(trajectory=tmp_path / "a.tum")
    assert scene.prior == "trajectory" and np.allclose(scene.world_from_rig, drive(8), atol=1e-8)
    assert scene.time_s.tolist() == list(range(50, 58)) and np.isnan(scene.position_sigma_m).all()
    assert says(scene.notes, r"'cam0' \(x right, y down, z forward\)")


def test_kitti_poses_by_frame(one_pass: Survey, tmp_path: Path) -> None:
    np.savetxt(tmp_path / "poses.txt", drive(8)[:, :3].reshape(8, 12))
    assert np.allclose(one_pass.scan(trajectory=tmp_path / "poses.txt").world_from_rig, drive(8), atol=1e-8)
    np.savetxt(tmp_path / "poses.txt", drive(9)[:, :3].reshape(9, 12))
    with refused("9 poses for 8 frames, and no times or names assign them"):
        one_pass.scan(trajectory=tmp_path / "poses.txt")


def test_a_trajectory_by_time_is_interpolated(one_pass: Survey, tmp_path: Path) -> None:
    t = 99.5 + np.arange(4)
    write_tum(tmp_path / "a.tum", t, rigid(np.tile(np.eye(3), (4, 1, 1)), np.stack([t, t, t], axis=1)))
    scene = one_pass.scan(trajectory=tmp_path / "a.tum", times=times_csv(tmp_path / "t.csv", 8))
    assert scene.world_from_rig[:3, 0, 3] == pytest.approx([100, 101, 102])
    assert np.isnan(scene.world_from_rig[3:, 0, 3]).all()
    with refused("do not overlap"):
        one_pass.scan(trajectory=tmp_path / "a.tum", times=times_csv(tmp_path / "t.csv", 8, start=900))


BODY_FROM_CAM0 = rigid(orient(30, -5, 0, "flu"), np.array([0.1, 0, 0.2]))  # as ``flu_rig`` says
ANTENNA = [0.9, 0.6, 0.3, 1]


def test_a_trajectory_of_the_body_becomes_one_of_the_first_camera(one_pass: Survey, tmp_path: Path) -> None:
    write_tum(tmp_path / "a.tum", np.arange(8.0), drive(8))
    scene = one_pass.scan(rig=flu_rig(tmp_path), trajectory=tmp_path / "a.tum")
    assert np.allclose(scene.world_from_rig, drive(8) @ BODY_FROM_CAM0, atol=1e-8)
    assert scene.rigs[0].antenna_m == pytest.approx(np.linalg.inv(BODY_FROM_CAM0)[:3] @ ANTENNA)
    assert says(scene.notes, "body frame of rig.toml")


@pytest.fixture
def vo(tmp_path: Path) -> Path:
    """A folder of odometry."""
    (tmp_path / "vo").mkdir()
    return tmp_path / "vo"


def test_odometry_of_each_pass_is_never_in_one_world(two_passes: Survey, vo: Path) -> None:
    for name in ("up", "down"):
        write_tum(vo / f"vo_{name}.tum", np.arange(3.0), drive(3))
    scene = two_passes.scan(trajectory=vo)
    assert scene.prior == "odometry" and scene.has_orientations() and not scene.measured_positions().any()
    assert scene.pose_world().tolist() == [0] * 3 + [1] * 3
    assert says(scene.notes, "each pass in its own world")
    shifted = drive(3)
    shifted[:, 0, 3] += 7
    write_tum(vo / "vo_down.tum", np.arange(3.0), shifted)
    scene = two_passes.scan(trajectory=vo)
    assert scene.prior == "trajectory" and set(scene.pose_world()) == {0} and scene.measured_positions().all()


def test_folders_without_a_trajectory_for_a_pass(two_passes: Survey, vo: Path) -> None:
    with refused("none of its files"):
        two_passes.scan(trajectory=vo)
    for name in ("a", "b"):
        write_tum(vo / f"{name}.tum", np.arange(2.0), drive(2))
    with refused(r"\(a.tum, b.tum\) contains the name of a pass \(down, up\)"):
        two_passes.scan(trajectory=vo)
    with refused("no such file or folder"):
        two_passes.scan(trajectory=vo / "nowhere")


@pytest.mark.parametrize("scale", [1.0, 0.4])
def test_odometry_laid_on_gnss_gives_poses_in_the_world(tmp_path: Path, vo: Path, scale: float) -> None:
    """Two passes, each odometry in its own world and scale, GNSS off the body, an outage in the middle."""
    frames, open_sky = 12, np.r_[0:4, 8:12]
    images = papers_rig(tmp_path / "in", ("up", "down"), 2, frames)
    rng = np.random.default_rng(3)
    truth, times, positions = {}, [], []
    for n, name in enumerate(("up", "down")):
        body = drive(frames, 80)
        turn = rigid(Rotation.from_euler("z", 40 + 150 * n, degrees=True).as_matrix(), np.array([20.0 * n, 5, 2]))
        truth[name] = turn @ body
        body[:, :3, 3] *= scale
        time_s = 100 + 1000 * n + np.arange(frames, dtype=float)
        write_tum(vo / f"{name}.tum", time_s, body)
        times.append(time_s[open_sky])
        positions.append(((truth[name] @ ANTENNA)[:, :3] + rng.normal(0, 0.02, (frames, 3)))[open_sky])
    gnss = gnss_csv(tmp_path / "g.csv", np.concatenate(times), np.concatenate(positions))
    scene = scan(images, ScanSettings(crs="ENU"), rig=flu_rig(tmp_path), gnss=gnss, trajectory=vo)
    assert scene.prior == "gnss" and np.isfinite(scene.world_from_rig).all()
    assert np.isfinite(scene.position_sigma_m[:, 0]).sum() == scene.measured_positions().sum() == 16
    for name in ("up", "down"):
        rows = scene.sequence == scene.sequences.index(name)
        want = truth[name] @ BODY_FROM_CAM0
        assert 0 < angle_deg(scene.world_from_rig[rows, :3, :3], want[:, :3, :3]).max() < 1.0
        miss = np.linalg.norm(in_enu(scene)[rows] - (truth[name] @ ANTENNA)[:, :3], axis=1)
        assert 0 < miss[4:8].max() < 0.15 and 0 < miss[:4].max() < 0.15


def test_canal_gnss_and_odometry() -> None:
    """Real-looking sensors: outages under the bridge, single fixes, drifting odometry per pass."""
    sensors = data("canal_demo", "sensors")
    scene = scan(data("canal_demo", "images"), rig="ladybug5", gnss=sensors / "gnss.csv", trajectory=sensors)
    known = np.isfinite(scene.position_sigma_m[:, 0])
    assert 8 <= known.sum() <= 12 and np.isfinite(scene.world_from_rig).all()
    assert scene.origin.crs == "EPSG:32654"
    assert np.ptp(scene.world_from_rig[:, :3, 3], axis=0).max() < 40  # m: the boat stays on its canal


def test_a_pass_without_a_trajectory_and_what_a_file_says_of_itself_is_noted(two_passes: Survey, vo: Path) -> None:
    for name in ("up", "dwn"):
        write_tum(vo / f"vo_{name}.tum", np.arange(3.0), drive(3))
    notes = two_passes.scan(trajectory=vo).notes
    assert says(notes, "no trajectory of pass down: no file besides vo_up.tum")
    rows = (vo / "vo_up.tum").read_text().splitlines()
    (vo / "vo_up.tum").write_text("\n".join([rows[0], rows[2], rows[1], *rows[3:], rows[-1]]))
    notes = two_passes.scan(trajectory=vo).notes
    assert says(notes, "vo_up.tum, line 3: rows are not in time order")
    assert says(notes, "vo_up.tum, line 5: 1 rows have the time of another row")


def truth(canal: Path) -> dict[str, np.ndarray]:
    """world_from_camera of the canal's images, by COLMAP's text format: id, qw qx qy qz, tx ty tz, camera, name."""
    out = {}
    for line in (canal / "truth" / "colmap" / "images.txt").read_text().splitlines():
        cells = line.split()
        if line and not line.startswith("#") and len(cells) == 10:
            w, x, y, z = (float(v) for v in cells[1:5])
            camera = rigid(Rotation.from_quat([x, y, z, w]).as_matrix(), np.array(cells[5:8], float))
            out[cells[9]] = np.linalg.inv(camera)
    return out


def same(scene: Scene, expected: dict[str, np.ndarray]) -> int:
    """How many frames have the poses of the rig's first camera."""
    names = [f"{scene.sequences[s]}/cam0/{k:06d}.jpg" for s, k in zip(scene.sequence, scene.sequence_index)]
    found = {n: pose for n, pose in zip(names, scene.world_from_rig) if n in expected}
    for name, pose in found.items():
        np.testing.assert_allclose(pose, expected[name], rtol=0, atol=1e-6)
    return len(found)


def transforms(poses: dict[str, np.ndarray], prefix: str = "./images/", **more: object) -> str:
    """As nerfstudio writes it: camera to world, x right, y up, z backward."""
    to_opengl = np.diag([1.0, -1.0, -1.0, 1.0])
    frames = [{"file_path": prefix + n, "transform_matrix": (p @ to_opengl).tolist()} for n, p in poses.items()]
    return json.dumps({"camera_model": "OPENCV", "w": 64, "h": 48, "frames": frames, **more})


def test_a_colmap_model_is_a_trajectory(canal: Path) -> None:
    scene = scan(canal / "images", rig=str(canal / "rig.toml"), trajectory=canal / "truth" / "colmap")
    assert scene.prior == "trajectory" and same(scene, truth(canal)) == 20
    assert says(scene.notes, "colmap: the trajectory is read as poses of 120 images by their names")
    assert not says(scene.notes, "body frame")


@pytest.mark.slow
def test_a_transforms_json_gives_the_same_poses(canal: Path, tmp_path: Path) -> None:
    poses = truth(canal)
    (tmp_path / "transforms.json").write_text(transforms(poses))
    for path in (tmp_path / "transforms.json", tmp_path):
        assert same(scan(canal / "images", rig=str(canal / "rig.toml"), trajectory=path), poses) == 20
    name = "up/cam0/000000.jpg"
    found = read_trajectory(tmp_path)
    np.testing.assert_allclose(found.poses[found.names.index(f"./images/{name}")], poses[name], atol=1e-9)
    as_written = np.array(json.loads((tmp_path / "transforms.json").read_text())["frames"][0]["transform_matrix"])
    assert angle_deg(as_written[:3, :3], poses[next(iter(poses))][:3, :3]) > 179  # OpenGL's axes are not ours


def test_a_frame_without_its_first_camera_has_the_pose_by_another(tmp_path: Path) -> None:
    """By the rig's geometry; frames and images that lack are said."""
    images, rig_toml = papers_rig(tmp_path / "in", ("up",), 2, 3), two_cameras_rig(tmp_path)
    on_rig = scan(images, rig=rig_toml).rigs[0].sensors[1].sensor_from_rig
    assert np.linalg.norm(on_rig[:3, 3]) == pytest.approx(0.5)
    turns = [Rotation.from_euler("xyz", [5 * k, 10, 0], degrees=True).as_matrix() for k in range(3)]
    rig = [rigid(turn, np.array([k, 2.0, 3])) for k, turn in enumerate(turns)]
    poses = {"cam0/000000": rig[0], "cam1/000001": rig[1] @ np.linalg.inv(on_rig), "cam0/9": rig[2]}
    (tmp_path / "transforms.json").write_text(transforms({f"up/{n}.jpg": p for n, p in poses.items()}))
    scene = scan(images, rig=rig_toml, trajectory=tmp_path / "transforms.json")
    np.testing.assert_allclose(scene.world_from_rig[:2], rig[:2], atol=1e-9)
    assert np.isnan(scene.world_from_rig[2]).any()
    assert says(scene.notes, "2 images by their names; 1 of 3 frames have none")
    assert says(scene.notes, "1 of 3 poses are of images that are not here, such as ./images/up/cam0/9.jpg")


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
    with refused(words, "transforms.json"):
        read_trajectory(tmp_path / "transforms.json")


def test_poses_of_other_images_are_refused(one_pass: Survey, tmp_path: Path) -> None:
    poses = {f"{k}.png": rigid(np.eye(3), np.array([k, 0.0, 0])) for k in range(3)}
    (tmp_path / "t.json").write_text(transforms(poses))
    with refused(r"t.json: none of its 3 images is here: ./images/0.png .*like up/cam0/000000.jpg"):
        one_pass.scan(trajectory=tmp_path / "t.json")


def test_the_folder_above_a_model_says_where_it_is(one_pass: Survey, canal: Path, tmp_path: Path) -> None:
    shutil.copytree(canal / "truth" / "colmap", tmp_path / "sparse" / "0")
    with refused(r"--trajectory .*/sparse: no poses in it; .*/sparse/0 has some: give that path"):
        one_pass.scan(trajectory=tmp_path / "sparse")


@pytest.mark.parametrize("cut", [10, 400, 3000])
def test_a_damaged_model_is_a_named_error(canal: Path, tmp_path: Path, cut: int) -> None:
    shutil.copytree(canal / "truth" / "colmap", tmp_path / "model")
    images = tmp_path / "model" / "images.txt"
    images.write_text(images.read_text()[:cut])
    try:
        assert 0 < len(read_trajectory(tmp_path / "model")) < 120
    except InputError as error:
        assert "model" in str(error)
