"""The rig as a run found it: written, read again, given to the next run; and what a file cannot say is said."""

from __future__ import annotations

import json
from dataclasses import replace
from pathlib import Path

import numpy as np
import pycolmap
import pytest

from said import refused, says
from scan.scan_worlds import picture
from tiegraph.cli.main import main
from tiegraph.geometry.transforms import centre, invert, rigid
from tiegraph.pipeline.foundrig import rig_file
from tiegraph.project.inputs import Inputs, Stamps
from tiegraph.scan.prepare import crop_camera
from tiegraph.scan.rigfiles.rigfile import parse_rig_file, read_rig_file
from tiegraph.scan.rigfiles.rigspec import RigSpec, orient
from tiegraph.scan.tuning import RigTuning
from tiegraph.scene.colmapmodel import rigid3d
from tiegraph.scene.composed import WIDE
from tiegraph.scene.rig import Rig, Sensor, Source
from tiegraph.scene.scene import Scene, simple_scene
from tiegraph.sfm.covariance import INTERIOR, INTERIOR_TABLE, MOUNTING
from tiegraph.sfm.mapping import believed_cameras
from tiegraph.sfm.settings import SparseSettings

RIG = RigTuning()
SIZE = (64, 48)
GUESS = [60.0, 32.0, 24.0, 0.0, 0.0]
FOUND = [61.2345678901, 60.9876543211, 32.4, 23.1, 0.0123456789, -0.02, 1e-4, -2e-4]
SCALE, SCALE_SIGMA = 3.5, 0.02  # metres in a unit of the model
TURNS = (("a", 0.0), ("b", 72.0), ("c", 144.0))


def _camera(model: str, params: list[float], prior: bool = True) -> pycolmap.Camera:
    made = pycolmap.Camera(model=model, width=SIZE[0], height=SIZE[1], params=params)
    made.has_prior_focal_length = prior
    return made


def _poses(out_m: float, off_deg: float = 0.0) -> list[np.ndarray]:
    """sensor_from_rig of three cameras that stand ``out_m`` apart."""
    body = [
        rigid(orient(t + off_deg * (k > 0), off_deg, -off_deg), [out_m * k, 0.1 * k, 0])
        for k, (_, t) in enumerate(TURNS)
    ]
    return [invert(b) @ body[0] for b in body]


def _given(**more: object) -> Rig:
    sensors = tuple(Sensor(n, _camera("RADIAL", GUESS), p, folder=n) for (n, _), p in zip(TURNS, _poses(0.3)))
    return replace(Rig("head", sensors, nominal=True), **more)  # type: ignore[arg-type]


def _model(folder: Path, poses: list[np.ndarray] | None, params: list[float], model: str = "OPENCV") -> None:
    """A model of three cameras in one rig, or (no poses) each by itself."""
    out = pycolmap.Reconstruction()
    rig = pycolmap.Rig(rig_id=1 if poses else 9)
    for k in range(3):
        camera = _camera(model, params)
        camera.camera_id = k + 1
        out.add_camera(camera)
        identity = pycolmap.sensor_t(pycolmap.SensorType.CAMERA, k + 1)
        if k == 0:
            rig.add_ref_sensor(identity)
        elif poses:
            rig.add_sensor(identity, rigid3d(poses[k]))
    out.add_rig(rig)
    folder.mkdir(parents=True)
    out.write(str(folder))


def _scene(rigs: tuple[Rig, ...]) -> Scene:
    count = len(rigs[0].sensors)
    names = [f"{s.folder or 'x'}/{f}.jpg" for f in range(2) for s in rigs[0].sensors]
    scene = simple_scene(rigs[0], names, np.repeat([0, 1], count), np.tile(np.arange(count), 2))
    return scene.with_(rigs=rigs)


def _run(
    out: Path, rig: Rig | tuple[Rig, ...], poses: list[np.ndarray] | None, *, scale_source: str = "gnss",
    params: list[float] = FOUND, tables: dict | None = None, georef: bool = True,
) -> Path:  # fmt: skip
    """A run folder as sparse and georef leave it; ``poses`` in metres, sparse/0 in its own units."""
    rigs = rig if isinstance(rig, tuple) else (rig,)
    (out / "receipts").mkdir(parents=True)
    (out / "network").mkdir()
    (out / "candidates").mkdir()
    (out / "candidates" / "scene.json").write_text(_scene(rigs).to_json())
    (out / "receipts" / "folder.json").write_text(json.dumps({"made by": "tiegraph run", "format": 3}))
    (out / "tiegraph.toml").write_text(f'[run]\nimages = "{out}"\n')
    (out / "network" / "scene.json").write_text(_scene(rigs).to_json())
    sparse = {"made": "m1", "finished": "now", "settings": {"rig": "auto"}, "tables": tables or {}, "counts": {}}
    (out / "receipts" / "sparse.json").write_text(json.dumps(sparse))
    unscaled = None
    if poses is not None:
        unscaled = [np.array(p) for p in poses]
        for pose in unscaled:
            pose[:3, 3] /= SCALE
    _model(out / "sparse" / "0", unscaled, params)
    if georef:
        _model(out / "sparse" / "world", poses, params)
        placed = {"from": {"sparse": "m1"}, "finished": "now"}
        (out / "receipts" / "georef.json").write_text(json.dumps(placed))
        sigma = {"scale": SCALE_SIGMA} if scale_source == "gnss" else {}
        world = {"scale_source": scale_source, "scale": SCALE, "sigma": sigma, "antenna_m": None}
        (out / "world.json").write_text(json.dumps(world))
    return out


def _mounting(poses: list[np.ndarray], sigma: float = 0.001, turn_deg: float = 0.05) -> dict:
    rows = [[n, *(centre(p) / SCALE).tolist(), sigma, turn_deg] for (n, _), p in list(zip(TURNS, poses))[1:]]
    return {MOUNTING: {"columns": [], "rows": rows}}


def _read(text: str) -> RigSpec:
    return parse_rig_file(Path("rig.toml"), text, RIG)[0]


def _sensor_from_rig(spec: RigSpec) -> list[np.ndarray]:
    first = spec.sensors[0].body_from_sensor
    return [np.linalg.inv(s.body_from_sensor) @ first for s in spec.sensors]


def _same(spec: RigSpec, poses: list[np.ndarray]) -> None:
    for mine, true in zip(_sensor_from_rig(spec), poses):
        np.testing.assert_allclose(mine, true, rtol=0, atol=1e-9)


def _receipt(out: Path, **changed: object) -> None:
    """Other words in the receipt of sparse."""
    path = out / "receipts" / "sparse.json"
    path.write_text(json.dumps({**json.loads(path.read_text()), **changed}))


def test_what_is_written_is_read_as_it_was_found(tmp_path: Path) -> None:
    poses = _poses(0.37, 1.5)
    table = {INTERIOR_TABLE: {"columns": list(INTERIOR), "rows": [["b", "fx", 61.2, 0.34, None, ""]]}}
    found = rig_file(_run(tmp_path / "out", _given(), poses, tables={**_mounting(poses), **table}))
    spec = _read(found.text)
    _same(spec, poses)
    assert np.abs(poses[2] - _poses(0.3)[2]).max() > 0.01  # the other side: what was given is another rig
    assert all(s.params == tuple(FOUND) and s.size == SIZE and s.model == "OPENCV" for s in spec.sensors)
    assert not spec.nominal and not spec.fixed
    assert "# head: lengths are in metres by gnss, known to 2 %" in found.text
    assert "# b: sigmas of its camera: fx 0.34" in found.text
    assert [s.camera_sigma_px for s in spec.sensors] == [None, 0.34, None]


def test_sigmas_are_those_of_an_axis_in_metres_with_the_scale(tmp_path: Path) -> None:
    poses = _poses(0.37, 1.5)
    text = rig_file(_run(tmp_path / "out", _given(), poses, tables=_mounting(poses, 0.001, 0.05))).text
    first, second, third = _read(text).sensors
    assert first.sigma_deg is None and first.sigma_m is None
    assert second.sigma_deg == pytest.approx(0.05 / 3**0.5, rel=0.01)
    length = float(np.linalg.norm(centre(poses[2])))
    assert 0.7 < length < 0.8
    assert third.sigma_m == pytest.approx(np.hypot(SCALE * 0.001, length * SCALE_SIGMA) / 3**0.5, rel=0.01)
    bare = rig_file(_run(tmp_path / "bare", _given(), poses))
    assert "the run has no sigmas of the poses of b, c" in bare.said[-1] and _read(bare.text).sensors[1].sigma_m is None


def test_a_camera_that_no_tie_holds_stands_as_it_was_drawn(tmp_path: Path) -> None:
    """Also where the coarse model of that run had turned it, by matches that did not hold: 58 degrees on canal_demo."""
    drawn, astray = _poses(0.3), rigid(orient(0, 58, 0), [0, 0, 0]) @ _poses(0.3)[2]
    turned = _given(
        sensors=tuple(replace(s, sensor_from_rig=p) for s, p in zip(_given().sensors, [*drawn[:2], astray]))
    )
    poses = [*_poses(0.37, 1.5)[:2], astray]
    out = _run(tmp_path / "out", turned, poses, tables=_mounting(poses, sigma=0.3))
    (out / "candidates" / "scene.json").write_text(_scene((_given(),)).to_json())
    found = rig_file(out)
    _, told, left = _read(found.text).sensors
    assert told.sigma_deg < 0.1 < 0.9 < left.sigma_deg < 1.1 and left.sigma_m < 0.05  # type: ignore[operator]
    placed = _sensor_from_rig(_read(found.text))
    np.testing.assert_allclose(placed[1], poses[1], rtol=0, atol=1e-9)
    np.testing.assert_allclose(placed[2], drawn[2], rtol=0, atol=1e-9)
    assert says(found.said, "c as given: too few ties")


@pytest.mark.slow
def test_constants_are_those_the_model_was_made_with_and_before_them_those_of_the_settings(tmp_path: Path) -> None:
    poses = [*_poses(0.37, 1.5)[:2], _poses(0.3)[2]]
    out = _run(tmp_path / "out", _given(), poses, tables=_mounting(poses, sigma=0.3))

    def sigmas() -> tuple:
        left = _read(rig_file(out).text).sensors[2]
        return left.sigma_deg, left.sigma_m

    _receipt(out, tuning={"sfm": {"rig": {"nominal_deg": 4.0, "nominal_m": 0.2}}})
    assert sigmas() == pytest.approx((4.0, 0.2))
    (out / "tiegraph.toml").write_text((out / "tiegraph.toml").read_text() + '[sparse]\nrig = "fixed"\n')
    assert sigmas()[0] == pytest.approx(4.0), "the run did not hold the rig"
    (out / "tiegraph.toml").write_text(f'[run]\nimages = "{out}"\n[tuning.sfm.rig]\nnominal_deg = 3.0\n')
    assert sigmas() == pytest.approx((3.0, 0.2))
    _receipt(out, tuning={"sfm": {"gone": 1}})
    with refused("sparse.json.*gone.*finish that run again"):
        rig_file(out)


def test_a_rig_that_was_held_keeps_its_lengths(tmp_path: Path) -> None:
    """The positions say 3.5 m a unit; the rig says that its own metres are those of the model."""
    poses = _poses(0.3)
    scaled = [np.array(p) for p in poses]
    for pose in scaled:
        pose[:3, 3] *= 1.07
    found = rig_file(_run(tmp_path / "out", _given(nominal=False, fixed=True), scaled, tables=_mounting(scaled)))
    spec = _read(found.text)
    _same(spec, poses)
    assert spec.fixed and spec.sensors[1].sigma_m is None and says(found.said, "the run held them")
    turned = [poses[0], poses[1], _poses(0.3, 0.2)[2]]
    out = _run(tmp_path / "turned", _given(nominal=False, fixed=True), turned)
    _receipt(out, contradictions=["c is turned by 0.2 deg"])
    found = rig_file(out)
    assert says(found.said, "held by the run except for c, which the images rotated or moved")
    assert "# contradicted in that run: c is turned by 0.2 deg" in found.text
    np.testing.assert_allclose(_sensor_from_rig(_read(found.text))[1], poses[1], rtol=0, atol=1e-9)


@pytest.mark.parametrize("georef", [True, False])
def test_lengths_that_nothing_tells_in_metres_are_refused_in_a_rig_toml(tmp_path: Path, georef: bool) -> None:
    out = _run(tmp_path / "out", _given(), _poses(0.37, 1.5), scale_source="none", georef=georef)
    with refused(r"this run has no metric scale, .* of head .* `tiegraph georef .*rig_config"):
        rig_file(out)
    found = rig_file(out, "rig_config")
    assert says(found.said, "lengths are in model units")
    rotation = json.loads(found.text)[0]["cameras"][1]["cam_from_rig_rotation"]
    assert len(rotation) == 4 and np.linalg.norm(rotation) == pytest.approx(1)


def test_a_rig_whose_cameras_have_their_own_times_says_what_is_left_out(tmp_path: Path) -> None:
    rows = [["a", 0.0, None], ["b", 0.1, -31.0], ["c", 0.1, 11.5]]
    tables = {"rig diagnostics": {"columns": ["camera", "off m", "time offset ms"], "rows": rows}}
    found = rig_file(_run(tmp_path / "out", _given(nominal=False, fixed=True), _poses(0.3), tables=tables))
    spec = _read(found.text)
    _same(spec, _poses(0.3))
    assert spec.fixed and all(s.params == tuple(GUESS) for s in spec.sensors)
    assert sum("its calibration is as given, though the images differ from it by" in s for s in found.said) == 3
    assert any("do not fire at one instant" in s and "b -31 ms, c +11.5 ms" in s for s in found.said)
    assert "-31 ms" in found.text
    receipt = tmp_path / "out" / "receipts" / "sparse.json"
    receipt.write_text(receipt.read_text().replace('"auto"', '"absent"'))
    assert any("sparse.rig = absent" in s for s in rig_file(tmp_path / "out").said)


@pytest.mark.slow
def test_cameras_are_written_as_the_files_of_the_user_have_them(tmp_path: Path) -> None:
    """b is cropped, c was guessed and never adjusted, a's lens folds its image."""
    rig = _given()
    crop = (4, 2, 0, 6)
    whole = crop_camera(_camera("RADIAL", GUESS), *(-c for c in crop))
    cropped = replace(rig.sensors[1], source=Source(camera=whole, crop_px=crop))
    guessed = replace(rig.sensors[2], camera=_camera("OPENCV", FOUND, prior=False))
    poses = _poses(0.37, 1.5)
    out = _run(tmp_path / "out", replace(rig, sensors=(rig.sensors[0], cropped, guessed)), poses)
    _, second, third = _read(rig_file(out).text).sensors
    assert second.crop_px == crop and second.size == (68, 56)
    assert second.params == (FOUND[0], FOUND[1], FOUND[2] + 4, FOUND[3] + 2, *FOUND[4:])
    assert third.params is None and says(rig_file(out).said, "c: its camera was guessed")
    folds = [*FOUND[:4], -3.0, 0.0, 0.0, 0.0]
    found = rig_file(_run(tmp_path / "folds", _given(), poses, params=folds))
    first = _read(found.text).sensors[0]
    assert first.model == "SIMPLE_RADIAL" and first.params[0] == pytest.approx(np.mean(FOUND[:2]))  # type: ignore[index]
    assert says(found.said, "a: only the focal length is written, because OPENCV with")


def test_a_single_camera_needs_no_metres(tmp_path: Path) -> None:
    alone = _given(sensors=(replace(_given().sensors[0], folder=""),), nominal=False)
    found = rig_file(_run(tmp_path / "out", alone, None, georef=False))
    (sensor,) = _read(found.text).sensors
    assert sensor.params == tuple(FOUND) and sensor.folder == "" and found.said == ()


def _with_wide(out: Path, wide: int) -> Path:
    """A run of which the first cameras alone carried structure from motion."""
    whole = _given(nominal=False)
    roles = [WIDE if k < wide else "side" for k in range(3)]
    sensors = tuple(replace(s, role=r) for s, r in zip(whole.sensors, roles))
    carry = replace(whole, sensors=sensors[:wide])
    out = _run(out, carry, _poses(0.37, 1.5) if wide > 1 else None, scale_source="none", georef=False)
    (out / "whole.json").write_text(_scene((replace(whole, sensors=sensors),)).to_json())
    return out


def test_cameras_that_hang_on_a_wide_one_stay_as_given(tmp_path: Path) -> None:
    found = rig_file(_with_wide(tmp_path / "out", 1))
    spec = _read(found.text)
    assert [(s.name, s.role) for s in spec.sensors] == [("a", WIDE), ("b", "side"), ("c", "side")]
    assert [s.params for s in spec.sensors] == [tuple(FOUND), tuple(GUESS), tuple(GUESS)]
    _same(spec, _poses(0.3))
    assert "head: b, c depend on it: poses and lenses are as given" in found.said


def test_hanging_cameras_have_the_unit_of_the_wide_ones_in_a_file_without_one(tmp_path: Path) -> None:
    out = _with_wide(tmp_path / "out", 2)
    with refused("this run has no metric scale"):
        rig_file(out)
    (config,) = json.loads(rig_file(out, "rig_config").text)
    places = [np.linalg.norm(c["cam_from_rig_translation"]) for c in config["cameras"][1:]]
    given = [float(np.linalg.norm(p[:3, 3])) for p in _poses(0.3)]
    assert places[1] / places[0] == pytest.approx(given[2] / given[1])
    assert places[0] == pytest.approx(np.linalg.norm(_poses(0.37, 1.5)[1][:3, 3]) / SCALE)


def test_folders_that_have_no_rig_to_give(tmp_path: Path) -> None:
    out = _run(tmp_path / "out", _given(), _poses(0.3))
    (out / "receipts" / "sparse.json").unlink()
    views = tuple(replace(s, source=Source(panorama=(1, 0, 0, 0, 1, 0, 0, 0, 1))) for s in _given().sensors)
    damaged = _run(tmp_path / "damaged", _given(), _poses(0.3))
    (damaged / "world.json").write_text("{")
    alone = [replace(_given(), name=n, sensors=_given().sensors[k : k + 1]) for k, n in enumerate("xy")]
    two = _run(tmp_path / "two", tuple(alone), None)
    for folder, words in (
        (tmp_path / "nowhere", r"nowhere is no run folder: give one that"),
        (out, r"has no sparse model yet; `tiegraph sparse .*out` makes it"),
        (_run(tmp_path / "views", _given(sensors=views), _poses(0.3)), r"views of panoramas, .* give --rig panorama"),
        (damaged, r"world.json cannot be read any more .* finish that run again"),
        (two, r"2 rigs \(x, y\), but a rig.toml has one; take --format rig_config"),
    ):
        with refused(words):
            rig_file(folder)
    assert len(json.loads(rig_file(two, "rig_config").text)) == 2


def _survey(folder: Path) -> Path:
    for name, _ in TURNS:
        for k in range(2):
            picture(folder / name / f"{k:03d}.png", SIZE)
    return folder


# --- the command line -------------------------------------------------------------------------------------------------


@pytest.mark.slow
def test_the_verb_writes_what_colmap_and_tiegraph_read(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    poses = _poses(0.37, 1.5)
    out = _run(tmp_path / "out", _given(), poses, tables=_mounting(poses))
    assert main(["rig", str(out)]) == 0
    said = capsys.readouterr()
    assert _read(said.out).sensors[2].sigma_m and not said.err
    path = tmp_path / "rig_config.json"
    assert main(["rig", str(out), "-o", str(path), "--format", "rig_config"]) == 0
    assert "written: " in capsys.readouterr().out
    (config,) = pycolmap.read_rig_config(str(path))
    for camera, pose in zip(config.cameras[1:], poses[1:]):
        np.testing.assert_allclose(camera.cam_from_rig.matrix(), pose[:3], atol=1e-9)
    np.testing.assert_allclose(config.cameras[1].camera.params, FOUND)
    (mine,) = read_rig_file(path, RIG)
    np.testing.assert_allclose(_sensor_from_rig(mine)[2], poses[2], atol=1e-9)
    assert main(["rig", str(out), "-o", str(path)]) == 2
    assert "rig_config.json exists already" in capsys.readouterr().err
    assert main(["rig", str(tmp_path / "no")]) == 2
    assert "is not a run folder" in capsys.readouterr().err


@pytest.mark.slow
def test_another_run_starts_from_it_at_once(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    poses = _poses(0.37, 1.5)
    before = _run(tmp_path / "before", _given(), poses, tables=_mounting(poses))
    images, out = _survey(tmp_path / "images"), tmp_path / "out"
    command = ["run", str(images), "-o", str(out), "--rig", str(before), "--until", "scan", "--pool", "serial"]
    assert main(command) == 0
    scene = Scene.from_json((out / "scene.json").read_text())
    for sensor, pose in zip(scene.rigs[0].sensors, poses):
        np.testing.assert_allclose(sensor.sensor_from_rig, pose, rtol=0, atol=1e-9)
        np.testing.assert_allclose(sensor.camera.params, FOUND, rtol=0, atol=1e-12)
    assert scene.rigs[0].soft() and scene.rigs[0].sensors[1].sigma_deg == pytest.approx(0.0289)
    assert any(
        "lengths are in metres by gnss" in n for n in json.loads((out / "receipts/scan.json").read_text())["notes"]
    )
    capsys.readouterr()
    assert main(command) == 0 and "scan  up to date" in capsys.readouterr().err
    (before / "log.txt").write_text("another stage of the other run\n")
    assert main(command) == 0 and "scan  up to date" in capsys.readouterr().err
    receipt = before / "receipts" / "sparse.json"
    receipt.write_text(receipt.read_text() + "\n")
    assert main(command) == 0 and "scan  up to date" not in capsys.readouterr().err


@pytest.mark.slow
def test_a_folder_that_cannot_be_meant_stores_nothing(tmp_path: Path, capsys: pytest.CaptureFixture) -> None:
    before, images = _run(tmp_path / "before", _given(), _poses(0.3)), _survey(tmp_path / "images")
    for receipt, words in (
        ("sparse", "no sparse model yet"),
        ("folder", "a folder, not a file, and no run folder"),
    ):
        (before / "receipts" / f"{receipt}.json").unlink()
        assert main(["run", str(images), "-o", str(tmp_path / "out"), "--rig", str(before), "--until", "scan"]) == 2
        assert words in capsys.readouterr().err and not (tmp_path / "out").exists()


def test_a_calibration_that_a_rig_file_names_counts_among_the_inputs(tmp_path: Path) -> None:
    (tmp_path / "images").mkdir()
    (tmp_path / "rig.toml").write_text('[[sensors]]\nname = "a"\ncamera = {file = "left.yaml"}\n')
    (tmp_path / "left.yaml").write_text("one")
    given = Inputs(tmp_path / "images", rig=str(tmp_path / "rig.toml"))
    before = given.parts(Stamps(tmp_path))
    assert given.parts(Stamps(tmp_path)) == before
    (tmp_path / "left.yaml").write_text("another")
    assert given.parts(Stamps(tmp_path)) != before


def test_a_camera_with_a_sigma_is_adjusted_and_one_without_is_held() -> None:
    sensors = tuple(replace(s, camera=_camera("OPENCV", FOUND)) for s in _given().sensors)
    soft = (sensors[0], replace(sensors[1], camera_sigma_px=0.3), sensors[2])
    scene = _scene((_given(sensors=soft),))
    assert believed_cameras(scene, SparseSettings()) == (1, 3)
    assert believed_cameras(Scene.from_json(scene.to_json()), SparseSettings()) == (1, 3)
    assert believed_cameras(_scene((_given(sensors=sensors),)), SparseSettings()) == (1, 2, 3)
