"""``--start``: models of COLMAP, OpenSfM, nerfstudio and Metashape as what a scan starts from."""

from __future__ import annotations

import json
import shutil
from collections.abc import Callable
from dataclasses import replace
from itertools import product
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from scan_worlds import exif_of, papers_rig, picture, scan, two_cameras_rig
from start_models import (
    FOCAL_PX,
    HEIGHT,
    K1,
    WIDTH,
    colmap_model,
    metashape_file,
    nerf_file,
    opensfm_file,
    walk,
)

from said import refused, says
from tiegraph.geometry.transforms import angle_deg
from tiegraph.scan.priors.startmodel import read_start
from tiegraph.scan.settings import ScanSettings
from tiegraph.scene.namedposes import find_start
from tiegraph.scene.scene import Scene

LOOSE = ScanSettings(layout="loose")
Write = Callable[[Path], Path]
FORMATS: dict[str, Write] = {
    "COLMAP text": lambda t: colmap_model(t / "model", walk()),
    "COLMAP binary": lambda t: colmap_model(t / "model", walk(), binary=True),
    "COLMAP images.bin": lambda t: colmap_model(t / "model", walk(), binary=True) / "images.bin",
    "COLMAP workspace": lambda t: colmap_model(t / "work" / "sparse" / "0", walk()).parents[1],
    "COLMAP folder of models": lambda t: colmap_model(t / "sparse" / "0", walk()).parent,
    "OpenSfM file": lambda t: opensfm_file(t / "reconstruction.json", walk()),
    "OpenSfM project": lambda t: opensfm_file(t / "p" / "reconstruction.json", walk()).parent,
    "ODM project": lambda t: opensfm_file(t / "odm" / "opensfm" / "reconstruction.json", walk()).parents[1],
    "nerfstudio file": lambda t: nerf_file(t / "transforms_train.json", walk()),
    "nerfstudio folder": lambda t: nerf_file(t / "transforms.json", walk()).parent,
    "Metashape file": lambda t: metashape_file(t / "cameras.xml", walk()),
    "Metashape folder": lambda t: metashape_file(t / "cameras.xml", walk()).parent,
}


def photographs(tmp_path: Path, count: int = 6, size: tuple[int, int] = (WIDTH, HEIGHT)) -> Path:
    for k in range(count):
        picture(tmp_path / "in" / f"a_{k}.jpg", size)
    return tmp_path / "in"


def lens_of(scene: Scene) -> pycolmap.Camera:
    camera = scene.rigs[0].sensors[0].camera
    return camera


@pytest.mark.parametrize("name", FORMATS)
def test_every_format_gives_the_same_poses_and_camera(tmp_path: Path, name: str) -> None:
    images = photographs(tmp_path)
    start = read_start(FORMATS[name](tmp_path))
    assert start.program == name.split()[0].replace("ODM", "OpenSfM")
    assert start.unposed == (1 if "Metashape" in name else 0)
    scene = scan(images, LOOSE, start=start)
    for k, truth in enumerate(walk().values()):
        np.testing.assert_allclose(scene.world_from_rig[k], np.linalg.inv(truth), atol=1e-9)
    assert scene.prior == "trajectory" and scene.started and scene.has_orientations()
    camera = scene.rigs[0].sensors[0].camera
    assert camera.has_prior_focal_length
    pixel = camera.img_from_cam(np.array([[0.3, -0.2, 1.0]]))[0]
    stretch = FOCAL_PX * (1 + K1 * 0.13)
    np.testing.assert_allclose(pixel, [32 + 0.3 * stretch, 24 - 0.2 * stretch], atol=1e-4)


def test_a_start_measures_nothing_and_is_never_in_metres(tmp_path: Path) -> None:
    scene = scan(photographs(tmp_path), LOOSE, start=read_start(FORMATS["COLMAP text"](tmp_path)))
    assert not scene.measured_positions().any() and not scene.metric_positions()
    measured = scene.measured()
    assert not measured.has_positions() and not measured.has_orientations()
    assert says(scene.notes, "its unit and its georeference are not used")
    again = Scene.from_json(scene.to_json())
    assert again.started and not again.measured().has_orientations()
    as_trajectory = scan(tmp_path / "in", LOOSE, trajectory=tmp_path / "model")
    assert as_trajectory.measured_positions().all() and not as_trajectory.started
    assert says(as_trajectory.notes, "model: its unit is taken as metres; give it by --start")


def test_its_camera_is_a_start_and_no_calibration(tmp_path: Path) -> None:
    start = read_start(metashape_file(tmp_path / "c.xml", walk(), lens="<cx>1.5</cx><cy>-0.5</cy>"))
    (rig,) = scan(photographs(tmp_path), LOOSE, start=start).rigs
    (sensor,) = rig.sensors
    assert sensor.camera.principal_point_x == pytest.approx(33.5, abs=1e-6)
    assert sensor.camera_sigma_px == pytest.approx(0.01 * FOCAL_PX, rel=1e-3) and not rig.measured()
    assert replace(rig, sensors=(replace(sensor, camera_sigma_px=None),)).measured()


def test_a_camera_that_the_user_gives_stays(tmp_path: Path) -> None:
    start = read_start(FORMATS["OpenSfM file"](tmp_path))
    scene = scan(photographs(tmp_path), LOOSE, start=start, camera="PINHOLE,70,71,31,23")
    assert lens_of(scene).params.tolist() == [70, 71, 31, 23]
    assert scene.rigs[0].sensors[0].camera_sigma_px is None
    assert says(scene.notes, "the cameras given are used, not those of the start model")


def test_cameras_of_another_shape_are_refused_and_of_another_size_scaled(tmp_path: Path) -> None:
    start = read_start(FORMATS["nerfstudio file"](tmp_path))
    larger = scan(photographs(tmp_path, size=(2 * WIDTH, 2 * HEIGHT)), LOOSE, start=start)
    assert lens_of(larger).mean_focal_length() == pytest.approx(2 * FOCAL_PX)
    with refused(r"transforms_train.json.*64 x 48, those here 64 x 64: start from a model of"):
        scan(photographs(tmp_path, size=(WIDTH, WIDTH)), LOOSE, start=start)


@pytest.mark.parametrize(
    "words, most_px",
    [("OPENCV 64 48 60 60.3 33 23 -0.05 0.01 0.0005 -0.0003", 0.2), ("PINHOLE 64 48 60 60 32 24", 1e-9),
     ("FULL_OPENCV 64 48 60 60 32 24 -0.05 0.01 0 0 0.002 0 0 0", 0.02)],
)  # fmt: skip
def test_a_perspective_camera_is_adjusted_from_the_nearest_radial_one(
    tmp_path: Path, words: str, most_px: float
) -> None:
    """Of it nothing runs off that a straight survey does not tell: fy beside fx, tangential and high terms."""
    folder = colmap_model(tmp_path / "m", walk())
    (folder / "cameras.txt").write_text(f"7 {words}\n")
    camera = scan(photographs(tmp_path), LOOSE, start=read_start(folder)).rigs[0].sensors[0].camera
    assert camera.model.name == "RADIAL"
    model, width, height, *params = words.split()
    given = pycolmap.Camera(model=model, width=int(width), height=int(height), params=[float(v) for v in params])
    rays = np.array([[x, y, 1.0] for x in np.linspace(-0.5, 0.5, 5) for y in np.linspace(-0.35, 0.35, 5)])
    off = np.linalg.norm(camera.img_from_cam(rays) - given.img_from_cam(rays), axis=1)
    assert off.max() < most_px


def test_of_several_cameras_the_middle_one_is_taken(tmp_path: Path) -> None:
    folder = colmap_model(tmp_path / "m", walk(3))
    lines = [f"{k} SIMPLE_RADIAL 64 48 {f} 32 24 0" for k, f in ((7, 59), (8, 61), (9, 75))]
    (folder / "cameras.txt").write_text("\n".join(lines))
    text = (folder / "images.txt").read_text()
    (folder / "images.txt").write_text(text.replace("7 a_1", "8 a_1").replace("7 a_2", "9 a_2"))
    scene = scan(photographs(tmp_path, 3), LOOSE, start=read_start(folder))
    assert lens_of(scene).mean_focal_length() == pytest.approx(61)
    assert any("of 3 cameras of the start model (focal length 59.0 to 75.0 px)" in n for n in scene.notes)


def test_a_lens_that_no_camera_model_has_leaves_the_poses(tmp_path: Path) -> None:
    start = read_start(metashape_file(tmp_path / "c.xml", walk(), lens="<b2>0.3</b2>"))
    assert len(start.poses) == 6 and not start.cameras
    assert any("a camera is not taken from it" in n and "b2 = 0.3" in n for n in start.notes)
    start = read_start(nerf_file(tmp_path / "t.json", walk(), camera_model="EQUIRECTANGULAR"))
    assert len(start.poses) == 6 and not start.cameras and "EQUIRECTANGULAR" in start.notes[0]


def test_cameras_of_instant_ngp_and_of_each_frame(tmp_path: Path) -> None:
    path = tmp_path / "t.json"
    nerf_file(path, walk(2))
    data = json.loads(path.read_text())
    bare = {"camera_angle_x": float(2 * np.arctan(32 / 55)), "w": 64, "h": 48}
    path.write_text(json.dumps({**bare, "frames": data["frames"]}))
    first, second = read_start(path).cameras.values()
    assert first == second and first.params[:4] == pytest.approx((55, 55, 32, 24))
    data["frames"][1] |= {"fl_x": 61.0, "fl_y": 61.0, "k3": 0.01}
    path.write_text(json.dumps(data))
    first, second = read_start(path).cameras.values()
    assert (first.model, second.model) == ("OPENCV", "FULL_OPENCV") and second.params[0] == 61


# --- which of several -----------------------------------------------------------------------------------------------


def test_the_largest_of_several_models_is_taken_and_said(tmp_path: Path) -> None:
    colmap_model(tmp_path / "w" / "sparse" / "0", walk(2))
    colmap_model(tmp_path / "w" / "sparse" / "1", walk(6))
    start = read_start(tmp_path / "w")
    assert start.path.name == "1" and says(start.notes, "sparse/1: the largest of 2 models")
    start = read_start(opensfm_file(tmp_path / "reconstruction.json", walk(), more=2))
    assert len(start.poses) == 6 and start.unposed == 2
    assert says(start.notes, "the largest of 2 reconstructions is taken: 6 images; 2 are in others")


def test_the_largest_component_of_a_metashape_chunk(tmp_path: Path) -> None:
    path = metashape_file(tmp_path / "c.xml", walk())
    text = path.read_text()
    for k in (0, 1):
        text = text.replace(f'id="{k}" sensor_id="3" component_id="0"', f'id="{k}" sensor_id="3" component_id="1"')
    path.write_text(text)
    start = read_start(path)
    assert set(start.poses) == {"a_2", "a_3", "a_4", "a_5"} and start.unposed == 3
    assert says(start.notes, "the largest of 2 components is taken: 4 of 6")


# --- names ----------------------------------------------------------------------------------------------------------


def in_passes(tmp_path: Path, names: list[str]) -> Path:
    poses = walk(len(names))
    return colmap_model(tmp_path / "m", dict(zip(names, poses.values())))


def test_names_that_fit_several_images_and_two_of_one_are_errors_that_name_them(tmp_path: Path) -> None:
    short = [f"{k:06d}.jpg" for k in range(3)]
    for images, names, words in (
        (papers_rig(tmp_path / "in", ("up", "down"), 1, 3), short,
         r"000000.jpg .*several images have this name: write down/cam0/000000.jpg or up/"),
        (papers_rig(tmp_path / "one", (".",), 1, 3), [f"cam0/{n}" for n in short] + short,
         r"000000.jpg and cam0/000000.jpg can both be cam0/000000.jpg"),
    ):  # fmt: skip
        with refused(words):
            scan(images, start=read_start(in_passes(tmp_path, names)))


def test_a_model_of_more_images_is_no_error(tmp_path: Path) -> None:
    """Another pass whose files are called the same is not taken for one that is here."""
    images = papers_rig(tmp_path / "in", ("up", "down"), 1, 3)
    names = [f"{p}/cam0/{k:06d}.jpg" for p in ("third", "up") for k in range(3)]
    scene = scan(images, start=read_start(in_passes(tmp_path, names)))
    known = np.isfinite(scene.world_from_rig[:, 0, 0])
    assert [scene.sequences[s] for s in scene.sequence[known]] == ["up"] * 3
    assert any("3 of 6 poses are of images that are not here, such as third/cam0/000000.jpg" in n for n in scene.notes)
    assert says(scene.notes, "3 images by their names; 3 of 6 frames have none")


# --- units and places -----------------------------------------------------------------------------------------------


def test_a_rig_tells_the_unit_of_a_start(tmp_path: Path) -> None:
    """Poses of a rig's cameras 7 times too large become metres, so that lengths of rig and path go together."""
    images, rig_toml = papers_rig(tmp_path / "in", ("up",), 2, 3), two_cameras_rig(tmp_path)
    bare = scan(images, rig=rig_toml)
    on_rig = [s.sensor_from_rig for s in bare.rigs[0].sensors]
    frames = [np.linalg.inv(p) for p in walk(3).values()]
    poses = {}
    for k, camera in product(range(3), range(2)):
        at = frames[k] @ np.linalg.inv(on_rig[camera])
        at[:3, 3] *= 7
        poses[f"up/cam{camera}/{k:06d}.jpg"] = np.linalg.inv(at)
    without = {n: p for n, p in poses.items() if n != "up/cam0/000002.jpg"}  # known by cam1 alone
    scene = scan(images, rig=rig_toml, start=read_start(colmap_model(tmp_path / "m", without)))
    assert not says(scene.notes, "its unit is"), "two frames are too few to tell"
    scene = scan(images, rig=rig_toml, start=read_start(colmap_model(tmp_path / "m", poses)))
    np.testing.assert_allclose(scene.world_from_rig, frames, atol=1e-6)
    assert says(scene.notes, r"its unit is 0\.1429 m by the distances between the rig's cameras")
    assert scene.guessed == bare.guessed, "a model tells no order"


@pytest.mark.slow
def test_a_start_is_laid_on_positions_tilted_or_not(tmp_path: Path) -> None:
    """A drone's images that look down have no common direction that is up: a similarity places them."""
    truth = {}
    for k in range(6):
        east, north = 40.0 * (k % 3), 50.0 * (k // 3)
        turn = np.diag([1.0, -1, -1]) if k < 3 else np.diag([-1.0, 1, -1])  # there and back, looking down
        truth[f"a_{k}.jpg"] = np.block([[turn, np.array([[east], [north], [100.0]])], [0, 0, 0, 1]])
        picture(tmp_path / "in" / f"a_{k}.jpg", (WIDTH, HEIGHT),
                exif=exif_of(lat=35 + north / 110941, lon=139 + east / 91288, alt=100.0))  # fmt: skip
    tilt = np.linalg.inv(walk(3)["a_2.jpg"])
    poses = {}
    for name, pose in truth.items():
        other = tilt @ pose
        other[:3, 3] /= 9
        poses[name] = np.linalg.inv(other)
    settings = ScanSettings(layout="loose", gnss_sigma_m=1.0)
    scene = scan(tmp_path / "in", settings, start=read_start(colmap_model(tmp_path / "m", poses)))
    assert scene.prior == "exif" and scene.started and scene.measured_positions().all()
    east = scene.world_from_rig[:, :3, :3] @ truth["a_0.jpg"][:3, :3].T
    expected = [p[:3, :3] @ truth["a_0.jpg"][:3, :3].T for p in truth.values()]
    assert angle_deg(east, np.array(expected)).max() < 2  # of the grid's north
    assert any("fitted by a similarity to 6 positions: scale 9.0" in n for n in scene.notes)
    assert not scene.measured().has_orientations() and scene.measured().has_positions()


# --- what is none ---------------------------------------------------------------------------------------------------


def damaged(write: Write, old: str, new: str) -> Write:
    def made(tmp_path: Path) -> Path:
        path = write(tmp_path)
        file = path / "images.txt" if path.is_dir() else path
        text = file.read_text()
        assert old in text
        file.write_text(text.replace(old, new, 1))
        return path

    return made


TWICE = '"a_0"><transform>2 0 0 0 0 2 0 0 0 0 2 0 0 0 0 1</transform></camera><camera label="b"><transform>'
WRONG: dict[str, tuple[Write, str]] = {
    "no such": (lambda t: t / "nowhere", r"--start .*nowhere: no such file or folder; give a COLMAP model"),
    "empty folder": (lambda t: t, r"--start .*: no model of a known kind; give .*Metashape exports as XML"),
    "other file": (lambda t: picture(t / "x.jpg"), r"x.jpg: no model of a known kind; give a COLMAP"),
    "other json": (lambda t: _text(t / "x.json", "{}"), r"x.json: no model of a known kind"),
    "lens xml": (lambda t: _text(t / "x.xml", "<calibration><f>3</f></calibration>"), r"x.xml: no model of a known"),
    "several xml": (
        lambda t: metashape_file(metashape_file(t / "a.xml", walk()).with_name("b.xml"), walk()).parent,
        r"2 files of cameras in it \(a.xml, b.xml\): give the right one",
    ),
    "no shots": (lambda t: _text(t / "x.json", '[{"shots": {}}]'), r"x.json: no reconstruction with shots"),
    "cut json": (lambda t: _text(t / "x.json", '[{"shots": {'), r"x.json, line 1: no JSON .*cut off"),
    "shot without": (
        lambda t: _text(t / "x.json", '[{"shots": {"a.jpg": {"rotation": [0, 0, 0]}}}]'),
        r"x.json, shot a.jpg: translation is no list of three",
    ),
    "shot of words": (
        lambda t: _text(t / "x.json", '[{"shots": {"a.jpg": {"rotation": [0, 0, "x"], "translation": [0, 0, 0]}}}]'),
        r"shot a.jpg: rotation is no list of three",
    ),
    "cut xml": (damaged(FORMATS["Metashape file"], "</document>", ""), r"cameras.xml, line \d+: XML that is cut off"),
    "entities": (
        damaged(FORMATS["Metashape file"], "<document", '<!DOCTYPE d [<!ENTITY a "b">]><document'),
        r"cameras.xml, line 2: defines entities",
    ),
    "scaled": (damaged(FORMATS["Metashape file"], '"a_0"><transform>', TWICE), r"cameras.xml, line \d+: transform"
                                                                                    r" of 'a_0' has no rotation"),
    "numbers": (damaged(FORMATS["Metashape file"], '"a_0"><transform>', '"a_0"><transform>5 '), r"of 'a_0' has not 16"),
    "twins": (damaged(FORMATS["Metashape file"], '"a_1"', '"a_0"'), r"line \d+: two cameras are called 'a_0'"),
    "no chunk": (
        lambda t: _text(t / "x.xml", "<document><chunk></chunk></document>"), r"x.xml: no image has a pose in it"
    ),
    "none aligned": (lambda t: metashape_file(t / "x.xml", {}, lost=3), r"x.xml: no image has a pose in it"),
    "same poses": (
        lambda t: opensfm_file(t / "reconstruction.json", dict.fromkeys(("a.jpg", "b.jpg"), np.eye(4))),
        r"all 2 poses are the same",
    ),
    "colmap cut": (damaged(FORMATS["COLMAP text"], "7 a_3.jpg", "99 a_3.jpg"), "no camera 99, which .* has for a_3"),
}  # fmt: skip


def _text(path: Path, text: str) -> Path:
    path.write_text(text)
    return path


@pytest.mark.parametrize("name", WRONG)
def test_what_is_no_model_is_refused_by_name(tmp_path: Path, name: str) -> None:
    write, message = WRONG[name]
    path = write(tmp_path)
    with refused(message):
        read_start(path)


def test_a_model_is_found_beside_other_files(tmp_path: Path) -> None:
    """A folder of a project is searched for the model only; that is what a run watches for changes."""
    model = colmap_model(tmp_path / "work" / "sparse" / "0", walk())
    (tmp_path / "work" / "database.db").write_bytes(b"x")
    assert find_start(tmp_path / "work") == ("COLMAP", model)
    shutil.rmtree(tmp_path / "work" / "sparse")
    nerf_file(tmp_path / "work" / "transforms.json", walk())
    assert find_start(tmp_path / "work") == ("nerfstudio", tmp_path / "work" / "transforms.json")
