"""`tiegraph odometry` from images to a trajectory that `run` reads; covariances by simulated observations."""

import shutil

import cv2
import numpy as np
import pytest
from scipy.spatial.transform import Rotation

from odometry.odometry_world import images, rig_of, single, stereo, true_path, truth
from tiegraph.api import open_project
from tiegraph.cli.main import main
from tiegraph.errors import InputError
from tiegraph.geometry import transforms
from tiegraph.odometry.cameras import Tracks
from tiegraph.odometry.covariance import keyframe_covariances, resection_covariance, wider
from tiegraph.odometry.tuning import Tuning
from tiegraph.odometry.worldmap import Keyframe, WorldMap, adjust
from tiegraph.scan.rigfiles.rigspec import write_rig_toml
from tiegraph.scene.posefile import FREE_UNIT, read_poses

FRAMES, CAMERA = 8, "PINHOLE,320x240,250,250,162,117"


def written(folder, frames):
    """images/left, images/right and rig.toml."""
    for frame in range(frames):
        for camera, image in images(stereo(), frame).items():
            path = folder / "images" / stereo().names[camera] / f"{frame:06d}.png"
            path.parent.mkdir(parents=True, exist_ok=True)
            cv2.imwrite(str(path), image)
    write_rig_toml(rig_of(stereo()), folder / "rig.toml")
    return folder


@pytest.fixture(scope="module")
def survey(tmp_path_factory):
    return written(tmp_path_factory.mktemp("drive"), FRAMES)


@pytest.fixture(scope="module")
def start(tmp_path_factory):
    """Its first two frames, for what is refused before any is followed."""
    return written(tmp_path_factory.mktemp("start"), 2)


def opened(survey, out, **more):
    return open_project(survey / "images", out, pool="serial", **more)


def run(folder, *arguments, images="images"):
    return main(["odometry", str(folder / images), "--pool", "serial", "--quiet", *map(str, arguments)])


@pytest.mark.slow
def test_what_the_verb_writes_is_read_by_run(survey, tmp_path):
    out = tmp_path / "vo.tum"
    assert run(survey, "--rig", survey / "rig.toml", "-o", out) == 0
    truth = true_path(list(range(FRAMES)))
    found = read_poses(out).poses
    assert 1e-6 < np.linalg.norm((found - truth)[:, :3, 3], axis=1).max() < 0.02
    table = np.genfromtxt(tmp_path / "vo.csv", delimiter=",", names=True, dtype=None, encoding="utf-8")
    assert table["image"].tolist() == [f"left/{k:06d}.png" for k in range(FRAMES)]
    assert table["sigma_x"][0] == 0 < table["sigma_x"][-1] < 0.05
    for times in (None, tmp_path / "vo.csv"):
        given = {"rig": str(survey / "rig.toml"), "trajectory": out, "times": times}
        scene = opened(survey, tmp_path / f"out{times is None}", **given).run("scan").scene()
        assert scene.prior == "trajectory" and not scene.started
        assert np.allclose(scene.world_from_rig, found, atol=1e-6)


@pytest.mark.slow
def test_a_run_follows_its_own_images(survey, tmp_path):
    truth = true_path(list(range(FRAMES)))
    project = opened(survey, tmp_path / "out", rig=str(survey / "rig.toml"), trajectory="auto")
    scene = project.run("scan").scene()
    assert scene.prior == "trajectory" and not scene.started
    assert 1e-6 < np.linalg.norm((scene.world_from_rig - truth)[:, :3, 3], axis=1).max() < 0.02
    assert np.allclose(read_poses(tmp_path / "out" / "odometry" / "path.tum").poses, scene.world_from_rig, atol=1e-6)
    again = open_project(out=tmp_path / "out")
    assert str(again.inputs.trajectory) == "auto" and again.status()[0][1] == ""
    plain = open_project(out=tmp_path / "out", pool="serial", unset=("trajectory",)).run("scan")
    assert plain.scene().prior == "none" and not (tmp_path / "out" / "odometry").exists()


@pytest.mark.slow
def test_a_run_that_is_to_follow_its_images_needs_a_calibrated_rig(survey, tmp_path):
    project = opened(survey, tmp_path / "out", trajectory="auto")
    with pytest.raises(InputError, match="calibrat"):
        project.run("scan")
    assert not (tmp_path / "out" / "images").exists()  # said before any is prepared


@pytest.mark.slow
def test_a_single_camera_says_that_it_has_no_scale_and_holds_nothing(survey, tmp_path, capsys):
    arguments = ["odometry", str(survey / "images" / "left"), "--pool", "serial", "--camera", CAMERA]
    assert main([*arguments, "-o", str(tmp_path / "vo.tum")]) == 0
    assert "no scale" in "".join(capsys.readouterr()) and FREE_UNIT in (tmp_path / "vo.tum").read_text()
    given = {"camera": CAMERA, "trajectory": tmp_path / "vo.tum"}
    scene = open_project(survey / "images" / "left", tmp_path / "out", pool="serial", **given).run("scan").scene()
    assert scene.started and not scene.measured_positions().any() and scene.has_orientations()


@pytest.mark.slow
def test_an_image_that_cannot_be_read_and_one_of_another_size_are_told_and_not_fatal(survey, tmp_path, capsys):
    folder = shutil.copytree(survey / "images", tmp_path / "images")
    (folder / "left" / "000003.png").write_bytes(b"no image")
    small = cv2.imread(str(folder / "right" / "000005.png"))[:100]
    cv2.imwrite(str(folder / "right" / "000005.png"), small)
    arguments = ["odometry", str(folder), "--pool", "serial", "--rig", str(survey / "rig.toml")]
    assert main([*arguments, "-o", str(tmp_path / "vo.tum")]) == 0
    said = "".join(capsys.readouterr())
    assert "left/000003.png" in said and "320 x 100" in said
    assert len(read_poses(tmp_path / "vo.tum").poses) >= FRAMES - 1
    assert not (tmp_path / "tiegraph.toml").exists()


@pytest.mark.slow
def test_a_stereo_head_without_its_rig_is_refused(start, tmp_path, capsys):
    assert run(start, "-o", tmp_path / "vo.tum") == 2
    assert "its place in the rig is not known" in capsys.readouterr().err
    assert not list(tmp_path.iterdir())


@pytest.mark.slow
def test_a_file_that_is_there_is_not_written_over(start, tmp_path, capsys):
    out = tmp_path / "vo.tum"
    out.with_suffix(".csv").write_text("mine")
    assert run(start, "--rig", start / "rig.toml", "-o", out) == 2
    assert "vo.csv exists already" in capsys.readouterr().err
    assert out.with_suffix(".csv").read_text() == "mine" and not out.exists()


@pytest.mark.slow
def test_one_frame_and_images_without_texture_are_refused(start, tmp_path, capsys):
    for folder in ("one", "grey"):
        (tmp_path / folder).mkdir()
    shutil.copy(start / "images" / "left" / "000000.png", tmp_path / "one")
    for frame in range(3):
        cv2.imwrite(str(tmp_path / "grey" / f"{frame:06d}.png"), np.full((240, 320), 128 + frame, np.uint8))
    assert run(tmp_path, "-o", tmp_path / "vo.tum", images="one") == 2
    assert "usable image" in capsys.readouterr().err
    assert run(tmp_path, "--camera", CAMERA, "-o", tmp_path / "vo.tum", images="grey") != 0
    assert "no pose was found" in capsys.readouterr().err and not (tmp_path / "vo.tum").exists()


KEYFRAMES, POINTS, NOISE_PX, LOSS_PX = 7, 300, 0.4, 1.0


def world_of(cameras, seed, noise_px=NOISE_PX):
    """A map at the truth with noisy observations."""
    rng = np.random.default_rng(seed)
    world = WorldMap(cameras)
    first = transforms.invert(truth(0))
    poses = [transforms.invert(first @ truth(4 * k)) for k in range(KEYFRAMES)]
    points = np.column_stack([rng.uniform(-4, 4, POINTS), rng.uniform(-2, 1.5, POINTS), rng.uniform(3, 14, POINTS)])
    world.new_points(POINTS)
    world.xyz[:] = points
    for number, pose in enumerate(poses):
        seen = Tracks.none()
        for camera in range(len(cameras)):
            where = np.full(POINTS, camera)
            xy = cameras.project(where, transforms.apply(pose, points))
            noisy = xy + rng.normal(0, noise_px, xy.shape)
            seen = seen.plus(Tracks(np.arange(POINTS), where, noisy).where(cameras.inside(camera, xy)))
        world.keyframes.append(Keyframe(frame=number, segment=0, rig_from_world=pose, seen=seen))
    return world, poses


def errors(world, poses):
    """(K, 6) of position and turn about the world's axes."""
    out = []
    for frame, true in zip(world.keyframes, poses):
        found, there = transforms.invert(frame.rig_from_world), transforms.invert(true)
        turn = Rotation.from_matrix(found[:3, :3] @ there[:3, :3].T).as_rotvec()
        out.append([*(found - there)[:3, 3], *turn])
    return np.array(out)


def normalised(cameras, seeds, held, **noise):
    """(S, 6) errors of the last keyframe over its sigmas."""
    out = []
    for seed in seeds:
        world, poses = world_of(cameras, seed, **noise)
        numbers = list(range(KEYFRAMES))
        adjust(world, numbers, held, Tuning().map, LOSS_PX, 30)
        sigma = np.sqrt(np.diag(keyframe_covariances(world, numbers, LOSS_PX, len(cameras) > 1)[-1]))
        out.append(errors(world, poses)[-1] / sigma)
    return np.array(out)


@pytest.mark.slow
def test_errors_are_as_large_as_the_sigmas_say():
    """60 values, of which half are nearly independent: the ratio is known to about 10 %."""
    ratio = np.sqrt(np.mean(normalised(stereo(), range(10), [0]) ** 2))
    assert 0.7 < ratio < 1.35


def test_the_first_keyframe_and_the_first_base_line_are_held():
    world, _ = world_of(single(), 0)
    numbers = list(range(KEYFRAMES))
    found = keyframe_covariances(world, numbers, LOSS_PX, metric=False)
    assert (found[0] == 0).all() and np.isfinite(found).all()
    places = [transforms.centre(world.keyframes[k].rig_from_world) for k in (0, 1)]
    way = (places[1] - places[0]) / np.linalg.norm(places[1] - places[0])
    along, all_of_it = np.sqrt(way @ found[1][:3, :3] @ way), np.sqrt(np.trace(found[1][:3, :3]))
    assert along < 0.01 * all_of_it


def test_more_noise_gives_sigmas_as_much_larger():
    sigmas = []
    for noise in (0.2, 0.4):
        world, _ = world_of(stereo(), 3, noise_px=noise)
        sigmas.append(np.sqrt(np.diag(keyframe_covariances(world, list(range(KEYFRAMES)), 100.0, True)[-1])))
    assert np.allclose(sigmas[1] / sigmas[0], 2, rtol=0.05)


def test_a_sigma_is_raised_and_correlations_stay():
    classical = np.diag([1.0, 4.0]) + 0.5 * (1 - np.eye(2))
    raised = wider(classical, np.diag([9.0, 1.0]))
    assert np.allclose(np.diag(raised), [9, 4]) and np.isclose(raised[0, 1], 1.5)


def test_a_point_behind_a_camera_says_nothing_of_a_frame():
    """Later keyframes may move a point there; a frame that has lost nearly all of them is not known."""
    world, poses = world_of(single(), 1)
    seen = world.keyframes[2].seen
    xyz = world.xyz[seen.point].copy()
    whole = resection_covariance(world.cameras, poses[2], seen, xyz, LOSS_PX)
    back = transforms.apply(transforms.invert(poses[2]), np.array([[0.0, 0, -2]]))
    xyz[:20] = back
    less = resection_covariance(world.cameras, poses[2], seen, xyz, LOSS_PX)
    others = seen.where(np.arange(len(seen)) >= 20)
    assert np.allclose(less, resection_covariance(world.cameras, poses[2], others, xyz[20:], LOSS_PX))
    assert 1 < np.trace(less[:3, :3]) / np.trace(whole[:3, :3]) < 2
    xyz[2:] = back
    assert np.isnan(resection_covariance(world.cameras, poses[2], seen, xyz, LOSS_PX)).all()
