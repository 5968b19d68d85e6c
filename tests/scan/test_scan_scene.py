"""Folders of images as a scene: layouts, cameras, frames and passes, sequences or loose photographs, copies."""

from __future__ import annotations

import json
import shutil
from itertools import product
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pytest
from PIL import Image
from scan_worlds import TUNING, Survey, data, exif_of, papers_rig, picture, scan
from test_rig_files import toml

from said import refused, says
from tiegraph.api import open_project
from tiegraph.network.passes import find_passes
from tiegraph.network.sections import find_sections
from tiegraph.network.tuning import SectionsTuning
from tiegraph.pipeline.features import up_light
from tiegraph.project.settings import Settings
from tiegraph.scan.scan import ScanInputs, build_scene, safe_names
from tiegraph.scan.settings import ScanSettings
from tiegraph.scan.tuning import Tuning
from tiegraph.scene.images import find_images, probe_image
from tiegraph.scene.scene import Scene


def reasons(scene: Scene) -> dict[str, str]:
    return {d.name: d.reason for d in scene.dropped}


def frame_names(scene: Scene) -> list[list[str]]:
    return [[scene.names[k] for k in np.flatnonzero(scene.frame == f)] for f in range(scene.frames)]


def photographs(folder: Path, *names: str, **save: object) -> Path:
    for name in names:
        picture(folder / name, **save)
    return folder


def test_papers_layout(three_cameras: Survey) -> None:
    scene = three_cameras.scan()
    assert (len(scene), scene.frames, scene.sequences) == (18, 6, ("down", "up"))
    assert scene.names == tuple(sorted(scene.names)) and scene.names[0] == "down/cam0/000000.jpg"
    assert scene.sequence_index.tolist() == [0, 1, 2, 0, 1, 2] and scene.sequence.tolist() == [0, 0, 0, 1, 1, 1]
    for names in frame_names(scene):
        assert len({n.split("/")[0] for n in names}) == len({n.split("/")[2] for n in names}) == 1 and len(names) == 3
    assert [scene.sensor_of(k).name for k in range(18)] == [n.split("/")[1] for n in scene.names]
    rig = scene.rigs[0]
    assert rig.sensors[0].sensor_from_rig is not None and rig.sensors[1].sensor_from_rig is None
    for said in (r"layout guessed: 3 cameras, 2 pass\(es\)", "no rig given", "1.2 x the longer side"):
        assert says(scene.notes, said)
    assert not says(scene.notes, "repeat") and scene.exposure is None


@pytest.mark.slow
@pytest.mark.parametrize(
    "folders, cameras, passes",
    [
        (("left", "right"), 2, 1),
        (("image_0", "image_1"), 2, 1),
        (("front_camera", "back_camera"), 2, 1),
        (("aft", "bow"), 2, 1),  # equal file names
        (("up", "down"), 1, 2),  # named like passes
        (("cam0/up", "cam1/up", "cam0/down", "cam1/down"), 2, 2),
        (("up/cam0", "up/cam1", "down/cam0", "down/cam1"), 2, 2),
        (("mon/a", "mon/b", "tue/a", "tue/b"), 2, 2),  # a product
        (("survey/2023/up/cam0", "survey/2023/up/cam1"), 2, 1),
        (("survey/2023/up/cam0", "survey/2024/up/cam1"), 2, 2),
    ],
)
def test_folder_layouts(tmp_path: Path, folders: tuple[str, ...], cameras: int, passes: int) -> None:
    for folder in folders:
        for k in range(30):
            picture(tmp_path / folder / f"{k:04d}.png")
    scene = scan(tmp_path)
    assert (len(scene.rigs), len(scene.rigs[0].sensors), len(scene.sequences)) == (1, cameras, passes)
    assert len(scene) == 30 * len(folders) and not scene.dropped


@pytest.mark.slow
@pytest.mark.parametrize(
    ("north", "south", "step_s", "cameras", "words"),
    [
        ({"lat": 35.0}, {"lat": 35.001}, 5, 1, "images of equal names are 111 m apart"),
        ({"lat": 35.0}, {"lat": 35.00001}, 5, 2, ""),
        ({"hour": 9}, {"hour": 11}, 5, 1, "one folder was taken after the other"),
        ({"hour": 9}, {"hour": 9, "slower": 2}, 5, 1, "the time between images of equal names differs by"),
        ({"hour": 9}, {"hour": 9}, 5, 2, ""),
    ],
)
def test_two_flights_with_equal_file_names_are_no_rig(
    tmp_path: Path, north: dict, south: dict, step_s: int, cameras: int, words: str
) -> None:
    """North and south, averaged as one rig, put a survey 37 m off, and all positions were "inliers"."""
    for (folder, own), k in product((("north", north), ("south", south)), range(32)):
        seconds = k * step_s * own.get("slower", 1)
        time = f"2023:09:15 {own.get('hour', 9):02d}:{seconds // 60:02d}:{seconds % 60:02d}"
        place = {"lat": own["lat"], "lon": 139 + 1e-4 * k, "alt": 50} if "lat" in own else {}
        stamp = {"time": time} if "hour" in own else {}
        picture(tmp_path / folder / f"DJI_{k:04d}.JPG", exif=exif_of(make="DJI", model="X", **stamp, **place))
    scene = scan(tmp_path)
    assert len(scene.rigs[0].sensors) == cameras
    assert says(scene.notes, words) if words else not says(scene.notes, "no cameras of a rig")


@pytest.mark.slow
@pytest.mark.parametrize("step_s", [0.05, 1.0])
def test_images_named_by_their_times_are_paired_by_these_though_each_camera_lost_one(
    tmp_path: Path, step_s: float
) -> None:
    """Paired by order they were one step apart from the lost image on."""
    rng = np.random.default_rng(0)
    for camera, lost in ((0, 12), (1, 5)):
        for k in range(30):
            if k != lost:
                stamp = 1662064521.0 + k * step_s + (0.0 if camera == 0 else rng.uniform(-0.004, 0.004))
                picture(tmp_path / f"cam{camera}" / f"{round(stamp * 1e6)}000.png")
    scene = scan(tmp_path)
    assert says(scene.notes, "found by the times in their names")
    pairs = [n for n in frame_names(scene) if len(n) == 2]
    assert len(pairs) == 28 and scene.frames == 30
    times = np.array([[int(Path(name).stem) for name in sorted(n)] for n in pairs])
    assert np.abs(np.diff(times, axis=1)).max() < 5e6


def test_cameras_are_in_natural_order(tmp_path: Path) -> None:
    scene = scan(papers_rig(tmp_path, ("up",), 11, 1))
    assert [s.name for s in scene.all_sensors] == [f"cam{k}" for k in range(11)]


def test_strays_beside_the_camera_folders_do_not_spoil_the_rig(tmp_path: Path) -> None:
    papers_rig(tmp_path, ("up",), 3, 4)
    picture(tmp_path / "overview.jpg")
    picture(tmp_path / "up" / "cam0" / "thumbs" / "x.jpg")
    scene = scan(tmp_path)
    assert (len(scene.all_sensors), scene.frames, len(scene)) == (3, 4, 12)
    assert set(reasons(scene)) == {"overview.jpg", "up/cam0/thumbs/x.jpg"}
    assert "outside the camera folders (cam0, cam1, cam2)" in reasons(scene)["overview.jpg"]


def test_the_layout_can_be_forced(tmp_path: Path) -> None:
    survey = Survey(photographs(tmp_path, *(f"a/{f}/{f}{k}.jpg" for f in "xy" for k in range(3))))
    assert len(survey.scan(ScanSettings(layout="cameras")).all_sensors) == 2
    sequence = survey.scan(ScanSettings(layout="sequence"))
    assert sequence.sequences == ("x", "y") and sequence.guessed == ()
    assert (survey.scan(ScanSettings(layout="loose")).sequence == -1).all()


def test_frames_by_last_number_as_in_paper_000_figure_8(tmp_path: Path) -> None:
    for camera, numbers in enumerate(([168035, 168040, 168045], [168035, 168040, 168050])):
        photographs(tmp_path / "up" / f"cam{camera}", *(f"image{camera}up_{n}.jpg" for n in numbers))
    scene = scan(tmp_path)
    assert [len(f) for f in frame_names(scene)] == [2, 2, 1, 1]
    assert says(scene.notes, "by the last number") and says(scene.notes, "2 of 4 frames lack")


def test_frames_by_order_are_said_and_unequal_counts_too(tmp_path: Path) -> None:
    for camera, count in ((0, 3), (1, 4)):
        photographs(tmp_path / f"cam{camera}", *(f"x{1000 * camera + 7 * k}.jpg" for k in range(count)))
    scene = scan(tmp_path)
    assert [len(f) for f in frame_names(scene)] == [2, 2, 2, 1]
    assert says(scene.notes, "in the order of names, although the cameras have 3 to 4 images")


def test_frame_matching_can_be_forced(tmp_path: Path) -> None:
    survey = Survey(photographs(tmp_path, *(f"cam{c}/c{c}_{k}.jpg" for c in range(2) for k in range(3))))
    found = {how: survey.scan(ScanSettings(frames=how)).frames for how in ("name", "number", "order")}
    assert found == {"name": 6, "number": 3, "order": 3}


def test_bad_images_are_listed_with_a_reason_and_never_fatal(tmp_path: Path) -> None:
    papers_rig(tmp_path, ("up",), 2, 6)
    cam0 = tmp_path / "up" / "cam0"
    whole = (cam0 / "000001.jpg").read_bytes()
    (cam0 / "000001.jpg").write_bytes(whole[: len(whole) // 2])
    (cam0 / "000002.jpg").write_bytes(b"")
    (cam0 / "000003.jpg").write_text("not an image")
    shutil.copy(cam0 / "000004.jpg", cam0 / "000009.jpg")
    whole = (cam0 / "000004.jpg").read_bytes()
    (cam0 / "000008.jpg").write_bytes(whole[:2] + b"\xff\xfe\0\7hello" + whole[2:])
    picture(cam0 / "000005.png")
    picture(tmp_path / "up" / "cam1" / "000006.jpg", (80, 60))
    scene = scan(tmp_path)
    found = reasons(scene)
    assert "truncated" in found["up/cam0/000001.jpg"]
    assert found["up/cam0/000002.jpg"] == "zero bytes"
    assert found["up/cam0/000003.jpg"] == "not an image file"
    for name in ("000008", "000009"):  # one has other tags
        assert found[f"up/cam0/{name}.jpg"] == "the same photograph as up/cam0/000004.jpg"
    assert found["up/cam0/000005.png"] == "the same photograph as up/cam0/000005.jpg in another format"
    assert "80 x 60 pixels, but most images of cam1 have 64 x 48" == found["up/cam1/000006.jpg"]
    assert len(found) == 7 and len(scene) == 9 and scene.frames == 6


def test_two_usable_images_are_enough_and_fewer_an_error_that_says_why(tmp_path: Path) -> None:
    photographs(tmp_path, "a.jpg")
    (tmp_path / "b.jpg").write_bytes(b"")
    with refused(r"1 usable image.*b.jpg: zero bytes"):
        scan(tmp_path)
    assert len(scan(photographs(tmp_path, "c.jpg"))) == 2


def test_a_sensor_whose_images_are_all_broken_leaves_the_rig(tmp_path: Path) -> None:
    papers_rig(tmp_path, ("up",), 3, 2)
    for path in (tmp_path / "up" / "cam0").iterdir():
        path.write_bytes(b"")
    scene = scan(tmp_path, rig="ring:2")
    assert [s.name for s in scene.all_sensors] == ["cam1", "cam2"] and len(scene.dropped) == 2


@pytest.mark.slow
@pytest.mark.parametrize(
    "pattern, count, loose",
    [
        ("{:04d}.jpg", 10, True),  # few
        ("{:04d}.jpg", 40, False),
        ("frame_{:05d}.jpg", 40, False),
        ("IMG_{:04d}.jpg", 40, True),
        ("DJI_{:04d}.jpg", 40, True),
        ("survey{}.jpg", 40, False),
    ],
)
def test_loose_or_sequence_by_the_numbers(tmp_path: Path, pattern: str, count: int, loose: bool) -> None:
    survey = Survey(photographs(tmp_path, *(pattern.format(5 * k) for k in range(count))))
    scene = survey.scan()
    assert bool((scene.sequence == -1).all()) == loose
    assert scene.frames == count and says(scene.notes, "loose" if loose else "sequence")
    camera = scene.sensor_of(0).camera
    assert camera.model.name == ("SIMPLE_RADIAL" if loose else "RADIAL")
    if not loose:
        assert scene.sequences == ("all",) and scene.sequence_index.tolist() == list(range(count))
        assert scene.guessed == ("all",) and says(scene.notes, "if the images confirm it")
        assert survey.scan(ScanSettings(layout="sequence")).guessed == ()
        (tmp_path / "times.csv").write_text("image,time\n" + "".join(f"{n},{k}\n" for k, n in enumerate(scene.names)))
        assert survey.scan(times=tmp_path / "times.csv").guessed == ()  # somebody knows when they were taken


@pytest.mark.parametrize("regular", [True, False])
def test_loose_or_sequence_by_the_times(tmp_path: Path, regular: bool) -> None:
    rng = np.random.default_rng(1)
    clock = np.cumsum(np.full(35, 2) if regular else rng.integers(1, 60, 35))
    for k, t in enumerate(clock):
        stamp = f"2024:05:01 10:{t // 60:02d}:{t % 60:02d}"
        picture(tmp_path / f"IMG_{k:04d}.jpg", exif=exif_of(time=stamp))
    scene = scan(tmp_path)
    assert bool((scene.sequence == -1).all()) != regular and scene.guessed == (("all",) if regular else ())
    assert np.allclose(np.diff(np.sort(scene.time_s)), np.diff(clock))


def test_loose_photographs_of_several_cameras_are_several_rigs(tmp_path: Path) -> None:
    canon = {"make": "Canon", "model": "EOS"}
    for k in range(3):
        picture(tmp_path / f"a{k}.jpg", exif=exif_of(**canon, focal_35mm=50))
        picture(tmp_path / f"b{k}.jpg", exif=exif_of(**canon, focal_35mm=85))
        picture(tmp_path / f"c{k}.jpg", (80, 60))
    picture(tmp_path / "d0.jpg", exif=exif_of(**canon, focal_35mm=50, orientation=6))
    scene = scan(tmp_path)
    assert len(scene.rigs) == 4 and scene.frames == 10 and not scene.dropped
    for k, name in enumerate(scene.names):
        camera = scene.sensor_of(k).camera
        assert camera.has_prior_focal_length == (name[0] != "c")
        assert (camera.width, camera.height) == {"c": (80, 60), "d": (48, 64)}.get(name[0], (64, 48))
    assert len({scene.sensor_key[scene.names.index(n)] for n in ("a0.jpg", "b0.jpg", "c0.jpg", "d0.jpg")}) == 4


def test_mixed_orientations_of_a_mounted_camera_keep_the_sensor_rows(tmp_path: Path) -> None:
    for k in range(3):
        picture(tmp_path / "cam0" / f"{k}.jpg", exif=exif_of(orientation=6 if k else 1))
        picture(tmp_path / "cam1" / f"{k}.jpg", exif=exif_of(orientation=8))
    scene = scan(tmp_path)
    assert len(scene) == 6
    first, second = scene.all_sensors
    assert not first.source.upright and second.source is None
    assert (first.camera.width, second.camera.width) == (64, 48)


def test_names_with_blanks_are_renamed_and_remember_their_file(tmp_path: Path) -> None:
    files = ("DCIM 100/a b.jpg", "DCIM 100/a_b.jpg", "DCIM_100/a b.jpg", "#1/c.webp")
    scene = scan(photographs(tmp_path, *files))
    assert set(scene.sources) == set(files)
    assert len(set(scene.names)) == 4 and not any(c in n for n in scene.names for c in " #")
    assert "_1/c.png" in scene.names and scene.names == tuple(sorted(scene.names))
    assert scene.source_name(scene.names.index("_1/c.png")) == "#1/c.webp"
    assert says(scene.notes, "renamed")
    assert safe_names(["a/b.jpg", "a/B.JPEG", "ü/é.png"]) == ["a/b.jpg", "a/B.JPEG", "ü/é.png"]
    assert safe_names(["a b.jpg", "a_b.jpg", "a\tb.jpg"]) == ["a_b_2.jpg", "a_b.jpg", "a_b_3.jpg"]


def test_crop_and_undistort_settings(three_cameras: Survey) -> None:
    camera = three_cameras.scan(ScanSettings(crop_px=(2, 4, 6, 8))).sensor_of(0).camera
    assert (camera.width, camera.height) == (56, 36)
    assert (camera.principal_point_x, camera.principal_point_y) == (30, 20)
    with refused("leaves less than 32 px"):
        three_cameras.scan(ScanSettings(crop_px=(30, 0, 30, 0)))
    with refused("'cam0' has no calibrated camera"):
        three_cameras.scan(ScanSettings(undistort=True))


def test_camera_model_setting_and_fisheye_folders(tmp_path: Path) -> None:
    """And the angle of view that is guessed of a fisheye."""
    survey = Survey(photographs(tmp_path, "fisheye_left/0.jpg", "fisheye_right/0.jpg"))
    camera = survey.scan().sensor_of(0).camera
    assert camera.model.name == "OPENCV_FISHEYE" and not camera.has_prior_focal_length
    assert camera.mean_focal_length() == pytest.approx(64 / np.pi)
    camera = survey.scan(ScanSettings(camera_model="OPENCV")).sensor_of(0).camera
    assert camera.model.name == "OPENCV"
    assert camera.mean_focal_length() == pytest.approx(1.2 * 64)
    narrow = survey.scan(tuning=tuned({"rig": {"camera": {"guessed_fisheye_deg": 90}}}))
    assert narrow.sensor_of(0).camera.mean_focal_length() == pytest.approx(40.74, abs=0.01)
    assert says(narrow.notes, "a fisheye of 90 degrees across")


def test_deep_images_tell_their_depth(tmp_path: Path) -> None:
    for k in range(2):
        Image.fromarray(np.full((48, 64), 900 + k, np.uint16)).save(tmp_path / f"{k}.png")
    source = scan(tmp_path).sensor_of(0).source
    assert source.levels == (900, 902)


def test_scene_survives_json(tmp_path: Path) -> None:
    papers_rig(tmp_path / "in")
    picture(tmp_path / "in" / "up" / "cam0" / "x y.jpg")
    (tmp_path / "in" / "up" / "cam0" / "z.jpg").write_bytes(b"")
    scene = scan(tmp_path / "in", ScanSettings(crop_px=(1, 1, 1, 1)), rig="ring:3")
    again = Scene.from_json(scene.to_json())
    assert again.to_json() == scene.to_json()
    assert again.sources == scene.sources and again.dropped == scene.dropped and again.notes == scene.notes
    source, other = again.sensor_of(0).source, scene.sensor_of(0).source
    assert source.crop_px == other.crop_px == (1, 1, 1, 1)


@pytest.mark.slow
def test_four_thousand_images_take_seconds() -> None:
    probe = probe_image(data("canal_demo", "images", "up", "cam0", "000000.jpg"))
    from dataclasses import replace

    names = [f"{p}/cam{c}/{f:06d}.jpg" for p in ("up", "down") for c in range(6) for f in range(334)]
    probes = [replace(probe, digest=str(k)) for k in range(len(names))]
    scene = build_scene(ScanInputs(Path("nowhere"), rig="ladybug5"), names, probes, ScanSettings(), TUNING)
    assert (len(scene), scene.frames) == (4008, 668)


@pytest.mark.slow
@pytest.mark.parametrize(
    "folder, rigs, sensors, frames, loose",
    [
        (("canal_demo", "images"), 1, 6, 20, False),
        (("kitti_stereo",), 1, 2, 51, False),
        (("strecha", "fountain-P11"), 1, 1, 11, True),
    ],
)
def test_real_folders(folder: tuple[str, ...], rigs: int, sensors: int, frames: int, loose: bool) -> None:
    scene = scan(data(*folder))
    assert (len(scene.rigs), len(scene.all_sensors), scene.frames, scene.dropped) == (rigs, sensors, frames, ())
    assert bool((scene.sequence == -1).all()) == loose
    assert len(find_images(data(*folder))) == len(scene)


@pytest.mark.parametrize(("colour", "depth"), [("{0}.color.jpg", "{0}.depth.png"), ("rgb/{0}.jpg", "depth/9{0}.png")])
def test_depth_maps_are_no_photographs(tmp_path: Path, colour: str, depth: str) -> None:
    photographs(tmp_path, *(colour.format(k) for k in range(3)))
    for k in range(3):
        (tmp_path / depth.format(k)).parent.mkdir(exist_ok=True)
        cv2.imwrite(str(tmp_path / depth.format(k)), np.arange(64 * 48, dtype=np.uint16).reshape(48, 64) * 9 + k)
    scene = scan(tmp_path)
    assert scene.names == tuple(colour.format(k) for k in range(3)) and len(scene.all_sensors) == 1
    assert scene.dropped == () and says(scene.notes, "3 files are depth maps by their names")
    for k in range(3):  # alone they are the survey
        (tmp_path / colour.format(k)).unlink()
    assert len(scan(tmp_path)) == 3


@pytest.mark.parametrize(
    "form", ["{0}_mask.png", "{0}.mask.png", "{0}.jpg.png", "dynamic_mask_{0}.png", "{0}_Mask.jpg"]
)
def test_masks_beside_their_images_are_no_photographs(tmp_path: Path, form: str) -> None:
    photographs(tmp_path / "d", *(f"IMG_{k}.jpg" for k in range(3)), "IMG_9_mask.jpg")  # the last of no image here
    photographs(tmp_path / "d", *(form.format(f"IMG_{k}") for k in range(3)), mode="L")
    scene = scan(tmp_path)
    assert scene.names == ("d/IMG_0.jpg", "d/IMG_1.jpg", "d/IMG_2.jpg", "d/IMG_9_mask.jpg")
    assert scene.dropped == () and says(scene.notes, "3 files are masks of other images by their names")


def test_a_partly_copied_camera_and_a_frozen_one(tmp_path: Path) -> None:
    papers_rig(tmp_path, ("up",), 2, 4)
    shutil.copy(tmp_path / "up/cam0/000000.jpg", tmp_path / "up/cam1/000002.jpg")
    for k in (2, 3):
        shutil.copy(tmp_path / "up/cam0/000001.jpg", tmp_path / f"up/cam0/{k:06d}.jpg")
    notes = scan(tmp_path).notes
    assert says(notes, "^folder up/cam1 repeats folder up/cam0: 1 of 4 images")
    assert says(notes, "^folder up/cam0: 2 of 4 images repeat others of it")


def test_a_fixed_aperture_may_be_left_away(tmp_path: Path) -> None:
    for k in range(2):
        picture(tmp_path / f"{k}.jpg", exif=exif_of(exposure=0.01) if k else exif_of(iso=100))
    exposure = scan(tmp_path).exposure
    assert np.isnan(exposure[0]) and exposure[1] == pytest.approx(0.01)


def tuned(changes: dict) -> Tuning:
    return Tuning.model_validate(changes)


def test_few_images_are_loose_however_many_that_is(tmp_path: Path) -> None:
    survey = Survey(photographs(tmp_path, *(f"{k:04d}.jpg" for k in range(12))))
    few = survey.scan()
    assert "fewer than 30" in few.notes[0] and few.sequences == ()
    assert survey.scan(tuning=tuned({"folders": {"few": 12}})).sequences == ("all",)


@pytest.mark.slow
def test_a_run_takes_constants_from_its_settings(tmp_path: Path) -> None:
    images, out = papers_rig(tmp_path / "in", cameras=2, frames=2), tmp_path / "out"
    changed = {"scan": {"rig": {"camera": {"guessed_focal": 0.5}}}}
    project = open_project(images, out, pool="serial", settings={"tuning": changed})
    camera = project.run("scan").scene().sensor_of(0).camera
    assert camera.mean_focal_length() == 32.0
    assert json.loads((out / "receipts" / "scan.json").read_text())["tuning"] == changed


def test_a_rig_is_held_against_the_constants_before_the_run(three_cameras: Survey, tmp_path: Path) -> None:
    settings = {"tuning": {"scan": {"rig": {"max_rig_m": 0.01}}}}
    with refused(r"more than 0\.01 m"):
        open_project(three_cameras.images, tmp_path / "out", rig=str(toml(tmp_path)), settings=settings).run("scan")


def test_a_copied_pass_is_named_with_the_figure(tmp_path: Path) -> None:
    papers_rig(tmp_path, ("up",), 2, 4)
    shutil.copytree(tmp_path / "up", tmp_path / "up2")
    scene = scan(tmp_path)
    assert [n for n in scene.notes if "repeats" in n] == [
        "pass up2 repeats pass up: 8 of 8 images are identical files; pairs between them have no base, so they are"
        " left out"
    ]
    assert scene.sequences == ("up",) and len(scene) == 8


def test_sections_by_the_exposure_that_the_camera_wrote(tmp_path: Path) -> None:
    """A camera and one that looks up, whose automatic exposure makes the deck of a bridge as bright as the sky."""
    bridge, grey, sky = range(6, 11), 118.0, 0.5
    for k in range(16):
        shown = {"exposure": 1 / 60, "iso": 400} if k in bridge else {"exposure": 1 / 500, "iso": 100}
        picture(tmp_path / "cam0" / f"{k:04d}.jpg", exif=exif_of(exposure=1 / 250, f_number=2.8, iso=100))
        picture(tmp_path / "up" / f"{k:04d}.jpg", exif=exif_of(f_number=2.8, **shown))
    scene = scan(tmp_path)
    up = np.array([scene.sensor_of(k).role == "up" for k in range(len(scene))])
    assert scene.exposure[~up] == pytest.approx(100 / 250 / 2.8**2)
    assert sorted(set(scene.exposure[up])) == pytest.approx([100 / 500 / 2.8**2, 400 / 60 / 2.8**2])
    run = SimpleNamespace(settings=Settings(), folder=tmp_path, map=lambda _, names, *__: [(grey, sky)] * len(names))
    found = find_sections(scene, find_passes(scene), up_light(run, scene), SectionsTuning())
    assert [f for s in found.sections if s.kind == "bridge" for f in s.frames] == list(bridge), found.notes
