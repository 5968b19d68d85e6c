"""The bench against self-deception: its judge reaches each verdict, its faults change what they say and no more."""

import json
from dataclasses import replace
from pathlib import Path

import cv2
import numpy as np
import pycolmap
import pytest
from benchmarks.confront import __main__ as bench
from benchmarks.confront import drive, said, sets
from benchmarks.confront.faults import FAULTS, apart, extent_m, strangers
from benchmarks.confront.given import (
    Given,
    Picture,
    Positions,
    Truth,
    between,
    pinhole,
    read_positions,
    write_positions,
)
from benchmarks.confront.judge import Poses, errors_of, verdict
from benchmarks.confront.said import Said
from benchmarks.confront.table import table
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms
from tiegraph.geometry.geodesy import Origin, geodetic_from_world, make_origin, world_from_geodetic
from tiegraph.scene.rig import Rig, Sensor

ORIGIN = Origin(35.6965, 139.7695, 40.0)
SIGMA = {"camera": 0.01, "scale": 0.002, "yaw": 0.1, "tilt": 0.1, "plan": 0.02, "height": 0.02}


def survey(frames: int = 12) -> Given:
    """A pair of cameras 0.5 m apart on a bent way of 1 m a frame."""
    across = transforms.rigid(np.eye(3), np.array([-0.5, 0, 0]))
    sensors = (
        Sensor("a", pinhole(64, 48, 50.0), np.eye(4), folder="a"),
        Sensor("b", pinhole(64, 48, 50.0), across, folder="b"),
    )
    truth, times = {}, {}
    for k in range(frames):
        turn = Rotation.from_euler("z", 3 * k, degrees=True).as_matrix()
        pose = transforms.invert(transforms.rigid(turn, np.array([1.0 * k, 0.05 * k * k, 0.1 * np.sin(k)])))
        truth[f"a/{k:03d}.jpg"], truth[f"b/{k:03d}.jpg"] = pose, across @ pose
        times[f"a/{k:03d}.jpg"] = 100.0 + k
    place = np.stack([transforms.centre(truth[f"a/{k:03d}.jpg"]) for k in range(frames)])
    positions = Positions(100.0 + np.arange(frames), place, np.full((frames, 2), 0.02), ORIGIN)
    images = {n: Picture(Path(n)) for n in sorted(truth)}
    known = Truth(truth, ORIGIN, {"a": 50.0, "b": 50.0})
    return Given(images, known, Rig("pair", sensors, fixed=True), positions, times)


def result(given: Given, scale: float = 1.0, shift: float = 0.0, noise: float = 0.003) -> Poses:
    """A model as found: the truth, scaled about its middle, moved to the east, in a UTM world."""
    world = make_origin(ORIGIN.lat_deg, ORIGIN.lon_deg, ORIGIN.height_m)
    rng = np.random.default_rng(0)
    names = sorted(given.truth.cam_from_world)
    centres = np.stack([transforms.centre(given.truth.cam_from_world[n]) for n in names])
    centres = centres.mean(axis=0) + scale * (centres - centres.mean(axis=0)) + [shift, 0, 0]
    centres = centres + noise * rng.standard_normal(centres.shape)
    moved = world_from_geodetic(geodetic_from_world(centres, ORIGIN), world)
    step = world_from_geodetic(geodetic_from_world(np.array([[0.0, 0, 0], [0, 100, 0]]), ORIGIN), world)
    convergence = np.arctan2(*(step[1] - step[0])[:2])  # of the grid's north, to the east
    turn = Rotation.from_euler("z", -convergence).as_matrix()
    poses = {}
    for name, centre in zip(names, moved):
        rotation = given.truth.cam_from_world[name][:3, :3] @ turn.T
        poses[name] = transforms.rigid(rotation, -rotation @ centre)
    return Poses(poses, {n: 100 for n in names}, {"a": 50.0, "b": 50.0}, world)


def claims(**more: object) -> Said:
    return replace(Said(sigma=SIGMA, metric=True, placed=True), **more)


def judged(found: Poses, given: Given, told: Said, wrong_input: str, held: dict[str, float] | None = None):
    return verdict(errors_of(found, given, told, held or {}), told, wrong_input)


def test_each_verdict_is_reached() -> None:
    given = survey()
    right, long = result(given), result(given, scale=1.03)
    alarm = claims(contradictions=("scale: rig 1 and positions 1.03 contradict each other",))
    hedge = claims(hedges=("the scale rests on the positions alone",))
    assert judged(right, given, claims(), "").verdict == "right"
    assert judged(right, given, claims(), "positions").verdict == "right"
    assert judged(right, given, alarm, "").verdict == "alarm"
    assert judged(right, given, alarm, "positions").verdict == "right"  # there is something to say
    found = judged(long, given, claims(), "positions")
    assert found.verdict == "silent" and found.wrong == ("scale",)
    assert judged(long, given, alarm, "positions").how == ("contradiction",)
    assert judged(long, given, hedge, "positions").how == ("hedge",)
    assert judged(long, given, claims(hedges=("the heading is known to 5 deg only",)), "positions").verdict == "silent"
    assert verdict((), claims(error="--gnss x.csv: no column lat"), "positions").verdict == "failed"
    assert verdict((), claims(error="unexpected KeyError"), "positions").verdict == "crashed"


def test_the_limit_is_three_stated_sigmas() -> None:
    given = survey()
    for scale, wrong in ((1.005, False), (1.007, True), (0.993, True)):
        errors = {e.quantity: e for e in errors_of(result(given, scale=scale), given, claims(), {})}
        assert errors["scale"].wrong is wrong
        assert abs(errors["scale"].off - abs(scale - 1)) < 5e-4
    errors = {e.quantity: e for e in errors_of(result(given, shift=0.1), given, claims(), {})}
    assert errors["plan"].wrong and abs(errors["plan"].off - 0.1) < 0.005
    assert not any(errors[q].wrong for q in ("height", "yaw", "tilt", "scale", "camera"))
    rough = {e.quantity: e for e in errors_of(result(given, noise=0.06), given, claims(), {})}
    assert rough["camera"].wrong


def test_the_truth_s_own_error_counts() -> None:
    given = survey()
    given = replace(given, truth=replace(given.truth, sigma_m=0.05))
    errors = {e.quantity: e for e in errors_of(result(given, noise=0.06), given, claims(), {})}
    assert not errors["camera"].wrong


def test_what_is_held_as_given_is_wrong_if_it_keeps_half_of_the_fault() -> None:
    given = survey()
    spoilt = FAULTS["rig_baseline"].make(given, 0.1)
    assert spoilt is not None
    truth = {n: p.copy() for n, p in given.truth.cam_from_world.items()}
    for n, p in truth.items():
        if n.startswith("b/"):
            p[0, 3] -= 0.05  # the rig's place of b, as the wrong file has it
    kept = result(replace(given, truth=replace(given.truth, cam_from_world=truth)), noise=0)
    found = judged(kept, spoilt.given, claims(), "rig", dict(spoilt.held))
    assert found.wrong == ("place:b",) and found.verdict == "silent"
    assert judged(result(given), spoilt.given, claims(), "rig", dict(spoilt.held)).verdict == "right"
    sure = claims(sigma={**SIGMA, "place:b": 0.001})
    assert judged(kept, given, sure, "rig").wrong == ("place:b",)


def test_a_stranger_that_finds_a_place_is_wrong() -> None:
    given = strangers([Picture(Path("x.jpg"))])(survey(), 2).given
    assert len(given.strangers) == 2 and not set(given.strangers) & set(given.truth.cam_from_world)
    everything = result(survey())
    without = replace(
        everything, cam_from_world={n: p for n, p in everything.cam_from_world.items() if n not in given.strangers}
    )
    assert judged(everything, given, claims(), "images").verdict == "silent"
    assert judged(without, given, claims(), "images").verdict == "right"


def test_what_a_run_says_is_read_from_its_folder(tmp_path: Path) -> None:
    (tmp_path / "receipts").mkdir()
    mounting = {
        "columns": ["camera", "x", "y", "z", "sigma", "sigma of the rotation deg"],
        "rows": [["b", 1, 0, 0, 0.02, 0.1]],
    }
    interior = {
        "columns": ["camera", "parameter", "value", "sigma"],
        "rows": [["a", "fx", 500.0, 0.5], ["a", "cx", 1, 1]],
    }
    tables = {"mounting in the rig, model units": mounting, "interior orientation": interior}
    receipts = {
        "sparse": {"tables": tables, "notes": ["camera b is not synchronised: it stands off its place in the rig"]},
        "network": {
            "notes": ["the rig and the images neither prove nor contradict it"],
            "dropped": [["x.jpg", "no ties"]],
        },
        "georef": {
            "notes": ["the roll about the track is known to 10 deg only"],
            "contradictions": ["scale: this and that"],
        },
    }
    for name, receipt in receipts.items():
        (tmp_path / "receipts" / f"{name}.json").write_text(json.dumps(receipt))
    world = {
        "placed": True,
        "scale_source": "gnss",
        "scale": 2.0,
        "origin": {},
        "sigma": {"scale": 0.01, "yaw_deg": 1.0},
    }
    (tmp_path / "world.json").write_text(json.dumps({**world, "model_sigma": {"median": 0.004}}))
    found = said.read(tmp_path)
    assert found.contradictions == ("scale: this and that", receipts["sparse"]["notes"][0])
    assert found.hedges == tuple(receipts["georef"]["notes"])
    assert found.sigma == {"scale": 0.01, "yaw": 1.0, "camera": 0.004, "place:b": 0.04, "turn:b": 0.1, "focal:a": 0.001}
    assert found.placed and found.metric and found.dropped == (("x.jpg", "no ties"),)
    assert found.names("place:b", "rig") == "contradiction" and found.names("tilt", "positions") == "hedge"
    assert said.read(tmp_path / "nowhere").sigma == {}


def test_a_scale_by_the_rig_alone_has_the_sigma_of_its_sentence() -> None:
    georef = {"notes": ["metric by the rig's baselines (scale good to 0.6%)"]}
    assert said.sigmas({"georef": georef}, {"scale_source": "rig baseline"}) == {"scale": 0.006}


@pytest.mark.parametrize("name", sorted(FAULTS))
def test_each_fault_has_three_sizes_and_leaves_the_survey_itself_alone(name: str) -> None:
    given, fault = survey(), FAULTS[name]
    assert len(fault.sizes) == 3
    words = set()
    for size in fault.sizes:
        before = json.dumps(
            [given.rig.sensors[1].sensor_from_rig.tolist(), given.positions.enu_m.tolist(), sorted(given.images)]
        )
        made = fault.make(given, size)
        if name == "rig_swapped" and size:  # of a pair there is one exchange
            assert made is None
            continue
        assert made is not None and (made.given is not given)
        words.add(made.what)
        after = json.dumps(
            [given.rig.sensors[1].sensor_from_rig.tolist(), given.positions.enu_m.tolist(), sorted(given.images)]
        )
        assert before == after
    assert len(words) == (1 if name == "rig_swapped" else 3)
    bare = replace(given, rig=None, positions=None)
    if name not in ("order", "blurred"):
        assert fault.make(bare, fault.sizes[0]) is None


def test_faults_of_positions_are_as_large_as_they_say() -> None:
    given = survey()
    extent = extent_m(given.positions)

    def moved(name: str, size: float) -> np.ndarray:
        return FAULTS[name].make(given, size).given.positions.enu_m - given.positions.enu_m

    assert np.allclose(np.linalg.norm(moved("gnss_step", 0.03)[-1]), 0.03 * extent * np.hypot(1, 0.7))
    assert np.allclose(moved("gnss_step", 0.03)[0], 0)
    drift = np.linalg.norm(moved("gnss_drift", 0.1), axis=1)
    assert drift[0] == 0 and np.isclose(drift[-1], 0.1 * extent * np.hypot(1, 0.7)) and np.all(np.diff(drift) > 0)
    lag = FAULTS["gnss_lag"].make(given, 0.3).given.positions
    assert np.allclose(lag.time_s - given.positions.time_s, 0.3)
    axes = FAULTS["gnss_axes"].make(given, 0).given.positions
    assert np.allclose(axes.enu_m[:, 0], given.positions.enu_m[:, 1])


def test_faults_of_rig_and_camera_say_what_they_changed() -> None:
    given = survey()
    assert FAULTS["rig_turned"].make(given, 0.5).held == {"turn:b": pytest.approx(0.5)}
    assert FAULTS["rig_baseline"].make(given, 0.03).held == {"place:b": pytest.approx(0.015), "scale": 0.03}
    swapped = FAULTS["rig_swapped"].make(given, 0)
    assert swapped.held == {"place:b": pytest.approx(1.0)}
    focal = FAULTS["focal"].make(given, 0.05)
    assert focal.given.rig.sensors[0].camera.mean_focal_length() == pytest.approx(52.5)
    assert given.rig.sensors[0].camera.mean_focal_length() == pytest.approx(50.0)
    nominal = replace(given, rig=replace(given.rig, nominal=True))
    assert FAULTS["rig_baseline"].make(nominal, 0.1).held == {}  # a drawing claims nothing


def test_shuffled_frames_keep_their_pictures_with_their_poses() -> None:
    given = survey()
    for size in (0, 1, 2):
        made = FAULTS["order"].make(given, size).given
        assert sorted(made.images) == sorted(given.images) and made.times == given.times
        for name, picture in made.images.items():
            assert made.truth.cam_from_world[name] is given.truth.cam_from_world[str(picture.file)]
        assert any(str(p.file) != n for n, p in made.images.items())


def test_a_camera_that_fires_late_stands_where_it_was_then() -> None:
    given = survey()
    stamps = {n: float(Path(n).stem) for n in given.images}
    late = apart(given, {"a": 0.0, "b": 0.25}, stamps)
    true, found = given.truth.cam_from_world, late.truth.cam_from_world
    was, now, then = map(transforms.centre, (true["b/004.jpg"], found["b/004.jpg"], true["b/005.jpg"]))
    assert np.allclose(now, 0.75 * was + 0.25 * then, atol=1e-9)
    assert late.images["b/004.jpg"].share == 0.25 and late.images["a/004.jpg"].plain
    assert late.images["b/011.jpg"].plain  # nothing comes after the last


def test_a_picture_between_two_lies_between_them() -> None:
    rng = np.random.default_rng(1)
    wide = cv2.GaussianBlur(rng.uniform(0, 255, (120, 200)).astype(np.float32), (0, 0), 3)
    wide = np.clip(128 + 6 * (wide - wide.mean()), 0, 255).astype(np.uint8)
    a, b, half = wide[:, 4:164], wide[:, 0:160], wide[:, 2:162]
    made = between(a, b, 0.5)[20:-20, 20:-20].astype(float)
    error = np.abs(made - half[20:-20, 20:-20]).mean()
    assert error < 0.2 * np.abs(a[20:-20, 20:-20].astype(float) - half[20:-20, 20:-20]).mean()


def test_a_piece_keeps_its_frames_and_the_truth_is_put_where_the_positions_are() -> None:
    given = survey()
    there = transforms.rigid(Rotation.from_euler("z", 40, degrees=True).as_matrix(), np.array([7.0, -3, 1]))
    elsewhere = {n: p @ transforms.invert(there) for n, p in given.truth.cam_from_world.items()}
    lost = replace(given, truth=replace(given.truth, cam_from_world=elsewhere, origin=None))
    found = sets._anchored(lost).truth
    assert found.origin == ORIGIN
    assert all(np.allclose(p, found.cam_from_world[n], atol=1e-9) for n, p in given.truth.cam_from_world.items())
    piece = sets.cut(given, 2, 4)
    assert sorted(piece.images) == [f"{c}/{k:03d}.jpg" for c in "ab" for k in range(2, 6)]
    assert piece.positions.time_s.tolist() == [102.0, 103.0, 104.0, 105.0] and len(piece.times) == 4


def test_positions_survive_their_file(tmp_path: Path) -> None:
    given = survey()
    write_positions(given.positions, tmp_path / "gnss.csv")
    again = read_positions(tmp_path / "gnss.csv")
    back = world_from_geodetic(geodetic_from_world(again.enu_m, again.origin), ORIGIN)
    assert np.allclose(back, given.positions.enu_m, atol=1e-3) and np.allclose(again.sigma_m, 0.02)


@pytest.mark.slow
def test_early_stages_of_the_clean_run_count_as_made_here(tmp_path: Path) -> None:
    """A fault of positions: the tool itself then holds everything but georef for up to date."""
    from tiegraph.pipeline import STAGES
    from tiegraph.project.artefacts import Artefacts
    from tiegraph.project.stages import Outcome

    clean, out, images = tmp_path / "clean", tmp_path / "out", tmp_path / "in"
    images.mkdir()
    command = ["run", str(images), "-o", str(out), "--pool", "serial"]
    keys = drive._keys(command)
    to_world = STAGES[: 1 + [s.name for s in STAGES].index("georef")]
    for folder, place, wanted in ((clean, 1.0, [s.name for s in to_world]), (out, 2.0, ["scan"])):
        artefacts = Artefacts(folder, STAGES)
        scene = {"names": ["x"], "frame": [0], "sensor": [0], "rigs": "as given"}
        scene |= {"time_s": [1], "world_from_rig": [place], "position_sigma_m": [1], "origin": None, "prior": "gnss"}
        for stage in [s for s in STAGES if s.name in wanted]:
            artefacts.begin(replace(stage, clear=None), keys[stage.name] if folder is out else "other")
            for name in stage.makes:
                at = folder / name if "." in name else folder / name / "some.json"
                at = folder / "network" / "scene.json" if name == "network" else at
                at.parent.mkdir(parents=True, exist_ok=True)
                checked = scene | {"rigs": "checked"} if stage.name == "network" else scene
                at.write_text(json.dumps(checked))
            ledger = artefacts.receipts.files(stage.name) or {}
            names = [n for n in artefacts._there(stage)]
            artefacts.receipts.write_files(stage.name, ledger | {n: [] for n in names})
            artefacts.finish(stage, keys[stage.name] if folder is out else "other", Outcome(), {})
    drive.adopt(out, clean, {"georef"}, command)
    here = Artefacts(out, STAGES)
    here.look()
    why = {s.name: here.why(s, keys[s.name]) for s in to_world}
    assert {n for n, text in why.items() if text} == {"georef"}, why
    scene = json.loads((out / "network" / "scene.json").read_text())
    assert scene["world_from_rig"] == [2.0] and scene["rigs"] == "checked"


def test_the_table_counts_silent_failures() -> None:
    error = {"quantity": "scale", "off": 0.1, "sigma": 0.001, "limit": 0.003}
    silent = {"set": "s", "fault": "gnss_scale", "size": 2, "what": "too long", "verdict": "silent", "wrong": ["scale"],
              "how": [""], "errors": [error]}  # fmt: skip
    clean = silent | {"fault": "clean", "size": 0, "verdict": "right", "wrong": [], "how": []}
    text = table([silent, clean, silent | {"size": 1, "verdict": "said", "how": ["hedge"]}])
    assert "silent failures: 1 of 2 cases" in text and "false alarms 0" in text
    assert "- s/gnss_scale/2 (too long): scale off 0.1 (stated 0.001)" in text


def test_cameras_keep_their_parameters_through_a_fault() -> None:
    given = survey()
    camera = FAULTS["focal"].make(given, 0.2).given.rig.sensors[1].camera
    assert (
        isinstance(camera, pycolmap.Camera)
        and camera.params[2] == pytest.approx(32.25)
        and camera.has_prior_focal_length
    )


def model(folder: Path, found: Poses) -> None:
    """A COLMAP model of these poses, every image in a frame of its own."""
    made = pycolmap.Reconstruction()
    for key in (1, 2):
        camera = pinhole(64, 48, 50.0)
        camera.camera_id = key
        made.add_camera_with_trivial_rig(camera)
    for key, (name, pose) in enumerate(sorted(found.cam_from_world.items()), start=1):
        image = pycolmap.Image(name=name, camera_id=1 if name.startswith("a/") else 2, image_id=key)
        made.add_image_with_trivial_frame(image, pycolmap.Rigid3d(pose[:3]))
    folder.mkdir(parents=True)
    made.write(folder)


@pytest.mark.slow
def test_the_bench_writes_a_row_a_case_and_goes_on_where_it_was(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "x.jpg").write_bytes(b"x")
    given = survey()
    given = replace(given, images={n: Picture(tmp_path / "x.jpg") for n in given.images})
    monkeypatch.setattr(bench.sets, "load", lambda name, work: given)
    specs = []

    def run(command: list[str], log: Path, timeout_s: float) -> dict:
        """A tool that believes the positions, whatever they are, and says nothing of it."""
        spec = json.loads(Path(command[-1]).read_text())
        specs.append(spec)
        out, words = Path(spec["out"]), spec["command"]
        positions = read_positions(Path(words[words.index("--gnss") + 1]))
        longer = extent_m(positions) / extent_m(given.positions)
        log.write_text("" if longer < 1.05 else "the positions are too long: mend them\n")
        if longer < 1.05:
            found = result(given, scale=longer)
            model(out / "sparse" / "world", found)
            world = {"placed": True, "scale_source": "gnss", "scale": 1.0, "origin": found.origin.to_dict()}
            sigma = {"scale": 0.002, "yaw_deg": 0.1, "tilt_deg": 0.1, "position_m": 0.02, "height_m": 0.02}
            (out / "world.json").write_text(json.dumps({**world, "sigma": sigma, "model_sigma": {"median": 0.01}}))
        return {"returncode": 0 if longer < 1.05 else 2, "cpu_s": 1.0, "wall_s": 1.0}

    monkeypatch.setattr(bench.runner, "measured", run)
    words = [
        "--sets",
        "tiny",
        "--faults",
        "gnss_scale",
        "--work",
        str(tmp_path / "w"),
        "--json",
        str(tmp_path / "r.json"),
    ]
    assert bench.main(words) == 1
    rows = json.loads((tmp_path / "r.json").read_text())["rows"]
    assert [(r["fault"], r["size"], r["verdict"]) for r in rows] == [
        ("clean", 0, "right"), ("gnss_scale", 0, "silent"), ("gnss_scale", 1, "silent"), ("gnss_scale", 2, "failed"),
    ]  # fmt: skip
    assert rows[1]["wrong"] == ["scale"] and rows[3]["how"] == ["the positions are too long: mend them"]
    assert specs[0]["clean"] is None and specs[0]["redo"] == ["scan"]
    assert specs[1]["clean"] == specs[0]["out"] and specs[1]["redo"] == ["georef"]
    assert str(tmp_path) not in (tmp_path / "r.json").read_text()
    assert bench.main(words) == 1 and len(specs) == 4  # every row is there
    assert bench.main([*words, "--only", "tiny/gnss_scale/0", "--again"]) == 1 and len(specs) == 5
