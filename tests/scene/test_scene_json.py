"""Scenes, pairs and models of COLMAP: written and read unchanged or refused; rigs, rays, weak ties."""

from __future__ import annotations

import itertools
import os
from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from said import refused
from tiegraph.geometry.geodesy import make_origin
from tiegraph.geometry.transforms import invert, rigid
from tiegraph.scene.colmapmodel import image_poses, is_model, read_model, registration, tracks
from tiegraph.scene.composed import carries, carrying, with_hanging
from tiegraph.scene.graph import WeaklyTied, named, strongest_first, weakly_tied
from tiegraph.scene.pairs import REASON_LOOKS, REASONS, Pairs, PreviewMatches
from tiegraph.scene.rig import Rig, Sensor, on_plane, pixel_rays, rays_or_axis
from tiegraph.scene.scene import Dropped, Scene, simple_scene
from tiegraph.scene.tuning import RegisteredTuning


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


def test_a_scene_says_what_it_has():
    one = scene().with_(sequence=np.array([0, -1]), world_from_rig=np.stack([np.eye(4), np.full((4, 4), np.nan)]))
    assert repr(one) == "Scene(3 images in 2 frames, 1 passes, 1 rigs of 3 cameras)"
    row = "<tr><td>{}</td><td>1</td><td>{}</td><td>{}</td></tr>"
    assert row.format("up", 2, 1) + row.format("loose photographs", 1, 0) in one._repr_html_()


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


CAMERA = pycolmap.Camera(model="OPENCV", width=640, height=480, params=[500, 500, 320, 240, 0.1, 0.01, 0, 0])


def test_rays_come_back_to_their_pixels():
    xy = np.random.default_rng(0).uniform((0, 0), (640, 480), (50, 2))
    rays = pixel_rays(CAMERA, xy)
    assert np.allclose(np.linalg.norm(rays, axis=1), 1)
    assert np.allclose(CAMERA.img_from_cam(rays), xy, atol=1e-6)
    assert np.allclose(rays[:, :2] / rays[:, 2:], on_plane(CAMERA, xy))
    assert np.array_equal(rays_or_axis(CAMERA, xy), rays)
    assert np.array_equal(on_plane(CAMERA, xy[:1])[0], CAMERA.cam_from_img(xy[0]))


def test_pixels_without_inverse_are_nan_or_the_axis():
    far = np.array([[1e9, 1e9], [320.0, 240.0]])
    assert np.isnan(pixel_rays(CAMERA, far)[0]).all() and np.isfinite(pixel_rays(CAMERA, far)[1]).all()
    assert np.array_equal(rays_or_axis(CAMERA, far)[0], [0.0, 0.0, 1.0])


def test_beyond_90_degrees_a_fisheye_pixel_has_no_ray():
    params = [129.15, 129.26, 240, 240, 0.0381, -0.008, 0.00833, -0.00269]
    camera = pycolmap.Camera(model="OPENCV_FISHEYE", width=480, height=480, params=params)
    radius = np.arange(1.0, 239.0)
    rays = pixel_rays(camera, np.column_stack([240 + radius, np.full(len(radius), 240.0)]))
    angle = np.degrees(np.arccos(rays[:, 2]))
    known = np.isfinite(angle)
    assert known[radius < 212].all() and not known[radius > 218].any()
    assert (np.diff(angle[known]) > 0).all() and 86 < angle[known].max() < 90


DRAW = np.random.default_rng(0)
LISTS = [list(map(tuple, DRAW.integers(0, 13, (k, 2)).tolist())) for k in range(41)]


def table(pairs, source="sequence"):
    array = np.array(pairs, dtype=int).reshape(-1, 2)
    return Pairs.make(array[:, 0], array[:, 1], source)


@pytest.mark.parametrize("pairs", LISTS, ids=len)
def test_always_sorted_unique_and_without_self_pairs(pairs):
    made = table(pairs)
    want = sorted({(min(p), max(p)) for p in pairs if p[0] != p[1]})
    assert list(zip(made.i.tolist(), made.j.tolist())) == want


@pytest.mark.parametrize(("a", "b"), list(zip(LISTS, LISTS[::-1])), ids=len)
def test_union_keeps_every_pair_and_both_sources(a, b):
    both = table(a) | table(b, "offsets")
    names = {tuple(p): k for k, p in enumerate(zip(both.i.tolist(), both.j.tolist()))}
    for pairs, source in ((a, "sequence"), (b, "offsets")):
        for p in pairs:
            if p[0] != p[1]:
                assert both.from_source(source)[names[tuple(sorted(p))]]
    assert len(names) == len({tuple(sorted(p)) for p in a + b if p[0] != p[1]})


@pytest.mark.parametrize("pairs", LISTS, ids=len)
def test_filters_only_drop_and_the_first_reason_stays(pairs):
    made = table(pairs)
    mask = np.random.default_rng(len(pairs)).random(len(made)) < 0.5
    dropped = made.drop(mask, "weak").drop(np.ones(len(made), bool), "cut")
    assert len(dropped) == len(made) and len(dropped.kept()) == 0
    assert (dropped.dropped[mask] == REASONS.index("weak")).all()
    funnel = made.drop(mask, "weak").funnel()
    assert funnel["candidates"] - funnel.get("weak", 0) == funnel["used"]


def test_a_pair_kept_by_one_source_is_kept_and_known_numbers_win():
    a = Pairs.make([0, 1], [1, 2], "offsets", score=np.array([3.0, 7.0])).drop(np.array([True, False]), "weak")
    both = a | Pairs.make([1], [0], "sequence")
    assert both.dropped.tolist() == [0, 0] and both.score.tolist() == [3.0, 7.0]


def test_best_score_of_duplicates_and_round_trips():
    made = Pairs.make([1, 0, 0], [0, 1, 2], "file", score=np.array([2.0, 9.0, np.nan]))
    assert made.score[0] == 9
    again = Pairs.from_npz(made.to_npz())
    assert again.to_csv(("a", "b", "c")) == made.to_csv(("a", "b", "c"))
    assert made.to_text(("a", "b", "c")) == "a b\na c\n"
    assert made.matrix(3).tolist() == [[0, 1, 1], [1, 0, 0], [1, 0, 0]]


def test_unsorted_columns_are_refused():
    good = Pairs.make([0, 0], [1, 2], "file")
    with pytest.raises(ValueError, match="sorted and unique"):
        good.where(np.array([1, 0]))
    with pytest.raises(ValueError, match="read-only"):
        good.i[0] = 5


def test_every_reason_has_a_look() -> None:
    assert all(words and colour for words, colour in REASON_LOOKS.values())
    assert len({colour for _, colour in REASON_LOOKS.values()}) == len(REASONS)


def ties() -> PreviewMatches:
    return PreviewMatches.make([3, 0, 0], [5, 2, 1], [np.array([[1, 2], [3, 4]]), np.zeros((0, 2)), np.array([[7, 8]])])


def test_ties_are_sorted_with_their_matches_and_found_in_either_order() -> None:
    made = ties()
    assert list(zip(made.i, made.j)) == [(0, 1), (0, 2), (3, 5)]
    assert made.counts().tolist() == [1, 0, 2] and made.of(2).tolist() == [[1, 2], [3, 4]]
    assert made.find(np.array([5, 1, 4]), np.array([3, 0, 5])).tolist() == [2, 0, -1]
    assert PreviewMatches.empty().find(np.array([1]), np.array([2])).tolist() == [-1]
    with pytest.raises(ValueError, match="PreviewMatches.make"):
        PreviewMatches(np.array([2]), np.array([1]), np.array([0, 0]), np.zeros((0, 2)))


def test_subset_and_round_trip() -> None:
    kept = ties().where(np.array([True, False, True]))
    assert kept.counts().tolist() == [1, 2]
    again = PreviewMatches.from_npz(kept.to_npz())
    assert np.array_equal(again.matches, kept.matches) and np.array_equal(again.start, kept.start)


def test_union_keeps_the_first_of_a_pair_in_both() -> None:
    both = ties() | PreviewMatches.make([0, 1], [1, 2], [np.array([[1, 1], [2, 2]]), np.array([[5, 6]])])
    assert list(zip(both.i, both.j)) == [(0, 1), (0, 2), (1, 2), (3, 5)]
    assert both.of(0).tolist() == [[7, 8]] and both.of(2).tolist() == [[5, 6]]


def test_whole_cut_and_odd_models(tmp_path: Path) -> None:
    assert not is_model(tmp_path)
    pycolmap.Reconstruction().write_binary(tmp_path)
    assert is_model(tmp_path) and read_model(tmp_path).num_images() == 0
    (tmp_path / "points3D.bin").write_bytes((10**12).to_bytes(8, "little"))
    with refused("points3D.bin: the file is cut off"):
        read_model(tmp_path)
    (tmp_path / "points3D.bin").unlink()
    with refused("not a readable COLMAP model"):
        read_model(tmp_path)


def model(folder: Path) -> None:
    """Two cameras on a rig, two frames, one point."""
    made = pycolmap.synthesize_dataset(
        pycolmap.SyntheticDatasetOptions(num_rigs=1, num_cameras_per_rig=2, num_frames_per_rig=2, num_points3D=5)
    )
    made.write_binary(folder)


def as_text(folder: Path, images: str, cameras: str = "1 SIMPLE_RADIAL 64 48 70 32 24 0.01\n") -> Path:
    for name, text in ("images", images), ("cameras", cameras):
        (folder / f"{name}.txt").write_bytes(text.encode("utf-8"))
    return folder


def image(k: int, name: str, points: str = "\n") -> str:
    return f"{k} 1 0 0 0 {k} 0 0 1 {name}\n{points}"


@pytest.mark.parametrize(
    ("without", "begin", "end"), [("\n", "", "\n"), ("", "", "\n"), ("\n", "\ufeff# list\n", "\r\n")]
)
def test_text_as_other_programs_write_it(tmp_path: Path, without: str, begin: str, end: str) -> None:
    """Names with blanks; images without points have an empty line or none."""
    images = image(1, "A (1).jpg", without) + image(2, "A (2).jpg", "1 2 -1\n") + image(7, "sub dir/b  c.jpg", without)
    images = (begin + images).replace("\n", end)
    found = read_model(as_text(tmp_path, images)).images  # without points3D.txt
    assert {k: (i.name, i.projection_center().tolist()) for k, i in found.items()} == {
        1: ("A (1).jpg", [-1, 0, 0]),
        2: ("A (2).jpg", [-2, 0, 0]),
        7: ("sub dir/b  c.jpg", [-7, 0, 0]),
    }
    assert found[2].num_points2D() == 1


def test_text_of_rigs_is_read_as_binary_is(tmp_path: Path) -> None:
    (tmp_path / "text").mkdir()
    model(tmp_path)
    binary = read_model(tmp_path)
    binary.write_text(tmp_path / "text")
    text = read_model(tmp_path / "text")
    assert (text.num_frames(), text.num_points3D()) == (2, 5)
    for k, one in binary.images.items():
        assert text.images[k].name == one.name
        assert text.images[k].projection_center() == pytest.approx(one.projection_center(), abs=1e-9)


@pytest.mark.parametrize(
    ("images", "cameras", "words"),
    [
        ("1 1,0 0,0 0,0 0,0 1 0 0 1 a.jpg\n", None, r"images.txt, line 1: neither an image \(.*decimal points"),
        (image(1, "a.jpg") + "1 2\n", None, "line 3: neither an image"),
        ("1 0 0 0 0 1 0 0 1 a.jpg\n", None, "line 1: 0 0 0 0 1 0 0 is no pose"),
        (image(1, "a.jpg") + image(2, "a.jpg"), None, "line 3: a.jpg or its number 2 is listed twice"),
        (image(1, "a.jpg"), "", "cameras.txt: no camera 1, which images.txt has for a.jpg"),
    ],
)
def test_text_that_cannot_be_meant(tmp_path: Path, images: str, cameras: str | None, words: str) -> None:
    as_text(tmp_path, images, *([] if cameras is None else [cameras]))
    with refused(words):
        read_model(tmp_path)


@pytest.mark.timeout(120)
@pytest.mark.parametrize("name", ["cameras", "rigs", "frames", "images", "points3D"])
def test_a_file_cut_anywhere_is_named_at_once(tmp_path: Path, name: str) -> None:
    model(tmp_path)
    assert read_model(tmp_path).num_reg_images() == 4
    path = tmp_path / f"{name}.bin"
    whole = path.read_bytes()
    for size in {*range(0, len(whole), max(1, len(whole) // 40)), len(whole) - 1}:
        path.write_bytes(whole[:size])
        with refused(f"{name}.bin: the file is cut off"):
            read_model(tmp_path)
    path.write_bytes(b"\xff" * 8 + whole[8:])
    with refused(f"{name}.bin: the file is cut off"):
        read_model(tmp_path)


@pytest.mark.timeout(60)
def test_a_pipe_among_its_files_is_refused(tmp_path: Path) -> None:
    model(tmp_path)
    (tmp_path / "images.bin").unlink()
    os.mkfifo(tmp_path / "images.bin")
    with refused("images.bin: cannot be read .a named pipe"):
        read_model(tmp_path)


def lens(camera_id: int = 1) -> pycolmap.Camera:
    camera = pycolmap.Camera(
        model="PINHOLE", width=100, height=80, params=[90 + camera_id, 90, 50, 40], camera_id=camera_id
    )
    camera.has_prior_focal_length = True
    return camera


def survey(frames: int = 3, missing: tuple[str, ...] = (), **changes: object) -> Scene:
    """A wide camera and two that hang on it."""
    places = {"wide": np.eye(4), "a": rigid(np.eye(3), np.array([-0.1, 0, 0])), "b": rigid(np.eye(3), np.ones(3))}
    roles = {"wide": "wide", "a": "side", "b": "up"}
    sensors = tuple(Sensor(n, lens(k + 1), p, role=roles[n], folder=n) for k, (n, p) in enumerate(places.items()))
    rows = sorted(
        (f"{s}/{f:02d}.png", f, k) for k, s in enumerate(places) for f in range(frames) if f"{s}{f}" not in missing
    )
    names, frame, sensor = zip(*rows)
    return simple_scene(Rig("head", sensors, **changes), list(names), np.array(frame), np.array(sensor))


def with_sensor(scene: Scene, place: int, **changes: object) -> Scene:
    sensors = list(scene.rigs[0].sensors)
    sensors[place] = replace(sensors[place], **changes)
    return scene.with_(rigs=(replace(scene.rigs[0], sensors=tuple(sensors)),))


def test_only_wide_images_carry():
    scene = survey(missing=("wide1",))
    part = carrying(scene)
    assert part.names == ("wide/00.png", "wide/02.png") and part.frames == 2
    assert [s.name for s in part.rigs[0].sensors] == ["wide"]
    assert carries(scene).sum() == 2 and len(scene) == 8
    said = part.notes[-1]
    assert "6 images of a, b get poses by the rig" in said and "1 frames lack a wide image" in said
    assert carrying(part) is part
    alike = with_sensor(scene, 0, role="side")
    assert carrying(alike) is alike and carries(alike).all()


@pytest.mark.parametrize(
    "scene, what",
    [
        (
            with_sensor(survey(), 1, sensor_from_rig=None),
            "a depends on the rig, but its pose relative to wide is unknown",
        ),
        (with_sensor(survey(), 2, camera=None), "b depends on the rig, but its lens is not calibrated"),
        (survey(nominal=True), "but it is nominal: calibrate the rig"),
    ],
)
def test_nothing_hangs_on_a_rig_that_is_not_calibrated(scene, what):
    with refused(what):
        carrying(scene)


def test_a_second_rig_beside_is_refused():
    scene = survey()
    both = scene.with_(rigs=(*scene.rigs, Rig("other", (Sensor("x", lens()),))), rig=np.array([0, 0, 1]))
    with refused("has 2 rigs or cameras of other kinds: run them separately"):
        carrying(both.with_(sensor=np.where(both.frame == 2, 0, both.sensor)))


def model_of(scene: Scene, poses: np.ndarray) -> pycolmap.Reconstruction:
    """Of the images that carry, one frame each, with two points seen by all."""
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(lens())
    for k, name in enumerate(scene.names):
        image = pycolmap.Image(name=name, camera_id=1, image_id=k + 1, keypoints=np.full((3, 2), 7.0 + k))
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d(poses[k][:3]))
    for row in (0, 2):
        track = pycolmap.Track([pycolmap.TrackElement(k + 1, row) for k in range(len(scene))])
        model.add_point3D(np.array([row, 1.0, 5]), track)
    return model


def test_hanging_images_stand_where_the_rig_places_them(tmp_path):
    scene = survey(missing=("b0",))
    part = carrying(scene)
    turn = np.array([[0.0, -1, 0], [1, 0, 0], [0, 0, 1]])
    poses = np.array([rigid(turn, np.array([k, 2.0, 3.0])) for k in range(3)])
    with_hanging(model_of(part, poses), scene).write(tmp_path)
    found = pycolmap.Reconstruction(tmp_path)
    assert found.num_reg_images() == len(scene) == 8 and found.num_reg_frames() == 3
    placed = image_poses(found, scene)
    for k, name in enumerate(scene.names):
        sensor = scene.sensor_of(k)
        np.testing.assert_allclose(placed[k], sensor.sensor_from_rig @ poses[scene.frame[k]], atol=1e-12, err_msg=name)
    b = found.find_image_with_name("b/01.png")
    assert b.num_points3D == 0 and found.camera(b.camera_id).params[0] == 93
    xyz, image, _ = tracks(found, scene)
    assert len(xyz) == 2 and {scene.names[k] for k in image} == set(part.names)
    np.testing.assert_allclose(invert(placed[scene.image_index["a/01.png"]])[:3, 3], placed_a(poses[1]), atol=1e-12)


def placed_a(pose: np.ndarray) -> np.ndarray:
    return (invert(pose) @ np.array([0.1, 0, 0, 1]))[:3]


def alone(count: int) -> Scene:
    """Photographs of one camera."""
    return simple_scene(Rig("r", (Sensor("c"),)), [f"{k}.jpg" for k in range(count)], np.arange(count), np.zeros(count))


def seen_off(pixels_off: list[np.ndarray]) -> pycolmap.Reconstruction:
    """One image for each array: as many points as it is long, seen so far off where they are."""
    camera = pycolmap.Camera(model="PINHOLE", width=640, height=480, params=[500, 500, 320, 240], camera_id=1)
    model = pycolmap.Reconstruction()
    model.add_camera_with_trivial_rig(camera)
    for k, off in enumerate(pixels_off):
        xy = np.stack([np.linspace(50, 600, len(off)), np.full(len(off), 200.0)], axis=1)
        local = 5 * np.column_stack([camera.cam_from_img(xy), np.ones(len(off))]) if len(off) else np.zeros((0, 3))
        seen = xy + np.stack([off, 0 * off], axis=1)
        image = pycolmap.Image(name=f"{k}.jpg", camera_id=1, image_id=k + 1, keypoints=seen)
        model.add_image_with_trivial_frame(image, pycolmap.Rigid3d())
        for row, point in enumerate(local):
            model.add_point3D(point, pycolmap.Track([pycolmap.TrackElement(k + 1, row)]))
    return model


def test_an_image_counts_if_it_sees_points_that_agree() -> None:
    off = [
        np.full(10, 3.9),
        np.full(9, 0.1),  # one too few
        np.zeros(0),  # none at all: a camera of a rig over forest
        np.r_[np.full(9, 0.5), np.full(40, 4.1)],  # a camera moved to its given place: its points lie elsewhere
        np.r_[np.full(300, 0.5), np.full(100, 30.0)],  # more than are looked at one by one
    ]
    found = registration(seen_off(off), alone(6), RegisteredTuning())
    assert found.placed.tolist() == [True] * 5 + [False]
    assert found.registered.tolist() == [True, False, False, False, True, False]
    assert found.by_rig.tolist() == [False, True, True, True, False, False]
    assert found.points[:4].tolist() == [10, 9, 0, 9] and found.points[4] == pytest.approx(300, abs=5)


def test_points_behind_a_camera_do_not_agree() -> None:
    model = seen_off([np.full(30, 0.1)])
    for point in model.points3D.values():
        point.xyz = -point.xyz
    found = registration(model, alone(1), RegisteredTuning())
    assert not found.registered.any() and found.by_rig.all() and found.points[0] == 0


def test_what_counts_as_registered_is_in_reach() -> None:
    model, scene = seen_off([np.full(10, 3.9), np.full(9, 0.1)]), alone(2)
    assert registration(model, scene, RegisteredTuning()).registered.tolist() == [True, False]
    assert registration(model, scene, RegisteredTuning(min_points=9)).registered.tolist() == [True, True]
    strict = registration(model, scene, RegisteredTuning(min_points=9, agree_px=3.0))
    assert strict.registered.tolist() == [False, True] and strict.by_rig.tolist() == [True, False]


def seen(*points: tuple[int, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Points and frames of sightings, from the frames that see each point."""
    return np.repeat(np.arange(len(points)), [len(p) for p in points]), np.array([f for p in points for f in p], int)


def test_groups_join_the_strongest_first() -> None:
    a, b, weight = np.array([0, 1, 3, 2]), np.array([1, 2, 4, 3]), np.array([5.0, 9.0, 7.0, 1.0])
    assert [g.tolist() for g in strongest_first(a, b, weight, 6)] == [[1, 2], [3, 4], [0, 1, 2], [0, 1, 2, 3, 4]]


def test_three_frames_that_hang_on_few_points_are_named_together() -> None:
    """Each of the three has hundreds of points, nearly all with the other two only."""
    chain = [(k, k + 1, k + 2) for k in range(8)] * 100
    inside, across = [(10, 11, 12)] * 300, [(9, 10)] * 20 + [(5, 12)] * 11
    point, frame = seen(*chain, *inside, *across)
    assert weakly_tied(point, frame, np.ones(13, bool), 50) == (WeaklyTied((10, 11, 12), 31),)
    assert weakly_tied(point, frame, np.ones(13, bool), 31) == ()
    assert weakly_tied(point, frame, np.ones(13, bool), 50, 10) == (WeaklyTied((10, 11, 12), 31),)
    assert named(WeaklyTied((10, 11, 12), 31), tuple(f"{k}.jpg" for k in range(13))) == "10.jpg .. 12.jpg (3 frames)"


def test_a_frame_without_points_is_weak_only_where_it_has_a_place() -> None:
    point, frame = seen(*[(0, 1, 2)] * 60)
    assert weakly_tied(point, frame, np.array([True, True, True, False]), 50) == ()
    assert weakly_tied(point, frame, np.ones(4, bool), 50) == (WeaklyTied((3,), 0),)
    assert weakly_tied(point, frame, np.array([True, True, True, False]), 100, 50) == ()  # 60 are enough for one
    assert weakly_tied(point, np.zeros(len(frame), int), np.array([True]), 50) == ()  # there is no rest


def test_frames_that_hold_together_by_sums_are_not_weak() -> None:
    """No two frames share 50 points, but every frame shares more with all others together."""
    point, frame = seen(*[pair for pair in itertools.combinations(range(6), 2) for _ in range(20)])
    assert weakly_tied(point, frame, np.ones(6, bool), 50) == ()


@pytest.mark.parametrize("points", range(41))
def test_what_is_found_is_weak_and_a_frame_that_is_weak_is_found(points: int) -> None:
    draw = np.random.default_rng(points)
    frames, least = int(draw.integers(2, 8)), int(draw.integers(1, 9))
    tracks = [tuple(np.unique(draw.integers(0, frames, draw.integers(1, 5))).tolist()) for _ in range(points)]
    found = weakly_tied(*seen(*tracks), np.ones(frames, bool), least)
    for group in found:
        across = sum(bool(set(t) & set(group.frames)) and bool(set(t) - set(group.frames)) for t in tracks)
        assert across == group.points < least and 2 * len(group.frames) <= frames
    taken = [f for group in found for f in group.frames]
    assert len(taken) == len(set(taken))
    alone = [sum(f in t and len(t) > 1 for t in tracks) for f in range(frames)]
    assert bool(found) or min(alone) >= least
