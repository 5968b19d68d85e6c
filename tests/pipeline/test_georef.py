"""Control points through the stages, and the glue of georef: a child that dies, a control file that does not fit."""

from __future__ import annotations

import json
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pytest

import worlds
from tiegraph.cli.main import main
from tiegraph.project.settings import Settings
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import simple_scene

import pycolmap  # isort: skip
from dataclasses import replace

from PIL import Image

from tiegraph.errors import ChildDied, InputError, UnreadableArtefact
from tiegraph.pipeline import STAGES, georef
from tiegraph.pipeline.baseline import Block, interrupted_note, run_side
from tiegraph.pipeline.inputs import orientations
from tiegraph.project.artefacts import LOST
from tiegraph.project.run import Inputs, Run
from tiegraph.project.settings import merged
from tiegraph.project.stages import Receipts
from tiegraph.scene.gcp import read_gcps
from tiegraph.sfm.settings import GeorefSettings
from tiegraph.sfm.tuning import Tuning
from tiegraph.sfm.world.georeferencing import ConstantParameters, GeorefRequest

EAST, NORTH = 386_000.0, 3_951_000.0  # of the world's zero, EPSG:32654


@pytest.mark.slow
def test_a_file_of_another_survey_is_refused_before_anything_is_made(
    tmp_path: Path, capsys: pytest.CaptureFixture[str]
) -> None:
    survey = worlds.make_survey(tmp_path / "images", passes=("up",), frames=2)
    gcp = tmp_path / "gcp_list.txt"
    gcp.write_text(f"EPSG:32654\n{EAST} {NORTH} 3 1 1 DJI_0042.jpg\n")
    out = tmp_path / "out"
    code = main(["run", str(survey.images), "-o", str(out), "--pool", "serial", "--gcp", str(gcp)])
    said = "".join(capsys.readouterr())
    assert code == 2 and "gcp_list.txt" in said and "line 2" in said and "DJI_0042.jpg" in said
    assert "up/cam0/000000.jpg" in said, "says how images are named here"
    assert not (out / "scene.json").exists() and not (out / "masks").exists()


@pytest.mark.slow
def test_marks_in_an_unknown_image_are_left_out_and_said_and_the_rest_is_used(tmp_path: Path) -> None:
    model, names = _photographs(tmp_path)
    points = sorted(model.points3D, key=lambda k: (-model.point3D(k).track.length(), k))[:6]
    rows = ["EPSG:32654"]
    for key in points:
        x, y, z = model.point3D(key).xyz
        for element in model.point3D(key).track.elements[:4]:
            image = model.image(element.image_id)
            u, v = image.points2D[element.point2D_idx].xy
            rows.append(f"{EAST + x:.5f} {NORTH + y:.5f} {z:.5f} {u:.3f} {v:.3f} {image.name} p{key}")
    wrong = len(rows) + 1
    rows.append(rows[1].replace(rows[1].split()[5], "another/survey.jpg"))
    (tmp_path / "gcp_list.txt").write_text("\n".join(rows) + "\n")
    settings = Settings()
    found = settings.georef.model_copy(update={"gcp": tmp_path / "gcp_list.txt"})
    run = SimpleNamespace(
        path=tmp_path.joinpath, settings=settings.model_copy(update={"georef": found}), log=tmp_path / "log.txt",
        inputs=SimpleNamespace(gnss=None, images=tmp_path), receipts=SimpleNamespace(read=lambda stage: {}),
    )  # fmt: skip
    outcome = georef.georef(run)
    said = f"gcp_list.txt, line {wrong}: image 'another/survey.jpg' is not in the survey; mark left out"
    assert said in outcome.notes and said in json.loads((tmp_path / "world.json").read_text())["notes"]
    table = outcome.tables["control and check points"]["rows"]
    assert [row[2] for row in table] == [4] * 6, "the marks in images that are here"
    assert all(abs(v) < 0.05 for row in table for v in row[3:6])
    placed = pycolmap.Reconstruction(str(tmp_path / "sparse/world"))
    assert placed.num_reg_images() == len(names)


def _photographs(folder: Path) -> tuple[pycolmap.Reconstruction, list[str]]:
    """The artefacts of a run up to sparse: loose photographs, a model that is right but for its place and scale."""
    pycolmap.set_random_seed(3)
    options = pycolmap.SyntheticDatasetOptions(
        num_rigs=1, num_cameras_per_rig=1, num_frames_per_rig=8, num_points3D=80, camera_has_prior_focal_length=True
    )
    truth = pycolmap.synthesize_dataset(options)
    names = sorted(truth.image(i).name for i in truth.reg_image_ids())
    camera = next(iter(truth.cameras.values()))
    count = len(names)
    rig = Rig("photographs", (Sensor("camera", camera),))
    scene = simple_scene(rig, names, np.arange(count), np.zeros(count, int), np.full(count, -1), sequences=())
    model = pycolmap.Reconstruction(truth)
    model.transform(pycolmap.Sim3d(0.3, pycolmap.Rotation3d(np.array([0.1, 0.2, 0.3, 0.9])), np.array([5.0, 1, 2])))
    (folder / "network").mkdir()
    (folder / "network/scene.json").write_text(scene.to_json())
    (folder / "sparse/0").mkdir(parents=True)
    model.write(str(folder / "sparse/0"))
    return truth, names


def test_orientations_are_those_of_the_marked_files_alone(tmp_path: Path) -> None:
    names = ["a/0.jpg", "a/1.jpg", "a/2.jpg", "a/3.jpg"]
    (tmp_path / "a").mkdir()
    for number, orientation in ((0, 8), (1, 1), (2, 6)):
        exif = Image.Exif()
        exif[0x0112] = orientation
        Image.new("RGB", (4, 3)).save(tmp_path / names[number], exif=exif)
    rows = [f"1 2 3 1 1 {image}" for image in ("0.jpg", "a/1.jpg", "a\\0.jpg", "3.jpg", "another.jpg")]
    (tmp_path / "gcp_list.txt").write_text("EPSG:32654\n" + "\n".join(rows))
    scene = simple_scene(Rig("lone", (Sensor("cam"),)), names, np.arange(4), np.zeros(4))
    run = SimpleNamespace(inputs=SimpleNamespace(images=tmp_path))
    found = orientations(run, scene, read_gcps(tmp_path / "gcp_list.txt"))  # type: ignore[arg-type]
    assert found == {0: 8, 1: 1}


def _request(target: Path) -> GeorefRequest:
    return GeorefRequest(
        folders=(),
        target=target,
        scene="",
        settings=GeorefSettings(adjust="yes"),
        measurements=None,  # type: ignore[arg-type]
        constant=ConstantParameters(),
        tuning=Tuning(),
        database=target,
    )


@pytest.mark.parametrize("deadly", [("yes",), ("yes", "no")])
def test_georef_is_tried_once_more_without_the_adjustment(tmp_path: Path, monkeypatch, deadly: tuple[str, ...]) -> None:
    run, tried = SimpleNamespace(log=tmp_path / "log.txt"), []

    def child(function, request, **how):
        assert not request.target.exists(), "nothing of the first try is left"
        request.target.mkdir()
        tried.append(request.settings.adjust)
        if request.settings.adjust in deadly:
            raise ChildDied("georeferencing: the native library ended its process (signal SIGSEGV)")
        return "the world"

    monkeypatch.setattr(georef, "run_in_child", child)
    if deadly == ("yes",):
        found, said = georef._georeferenced(run, _request(tmp_path / "world"))
        assert found == "the world" and "not adjusted" in said[0] and "SIGSEGV" in said[0]
    else:
        with pytest.raises(ChildDied):
            georef._georeferenced(run, _request(tmp_path / "world"))
    assert tried == ["yes", "no"]


@pytest.mark.parametrize("error", [InputError("none of its 4 coded targets is seen"), UnreadableArtefact("a", "b")])
def test_control_points_that_do_not_fit_are_not_used_and_said(monkeypatch, error: InputError) -> None:
    def fails(*arguments):
        raise error

    monkeypatch.setattr(georef, "control_file", lambda run: SimpleNamespace(targets=(), points=()))
    monkeypatch.setattr(georef, "target_marks", fails)
    if isinstance(error, UnreadableArtefact):
        with pytest.raises(UnreadableArtefact):
            georef._measured_in_images(None, None)  # type: ignore[arg-type]
        return
    found, _, unfit = georef._measured_in_images(None, None)  # type: ignore[arg-type]
    assert found.control is None and found.bars is None and "coded targets" in unfit[0]


def block(folder: Path, whole: bool) -> Block:
    scene = simple_scene(Rig("one", (Sensor("a", None),)), ["0.jpg", "1.jpg"], np.arange(2), np.zeros(2, int))
    run = Run(folder / "survey", Inputs(folder / "images"), merged())
    (folder / "block").mkdir()
    return Block(folder=folder / "block", run=run, scene=scene, whole=whole)


def test_a_run_that_goes_on_is_said_to_have_been_interrupted(tmp_path: Path) -> None:
    made = block(tmp_path, whole=False)
    assert interrupted_note(made, "conventional", STAGES) == ""  # not begun
    made.side("conventional").mkdir()
    for _ in range(2):  # also when it has gone on since
        assert "times are too short" in interrupted_note(made, "conventional", STAGES)
    made.side("meguro2024").mkdir()
    Receipts(made.side("meguro2024")).write("georef", {"began": "key", LOST: "it needs the stage match"})
    assert interrupted_note(made, "meguro2024", STAGES) == ""
    side = run_side(made, "meguro2024", STAGES)
    assert side.count == 0 and side.cpu_s == 0 and np.isnan(side.centres).all()


def test_a_block_in_an_outage_is_given_no_gnss(tmp_path: Path) -> None:
    made = block(tmp_path, whole=False)
    assert made.silent == ()  # the survey has none either
    run = Run(made.run.folder, replace(made.run.inputs, gnss=tmp_path / "gnss.csv"), made.run.settings)
    assert replace(made, run=run).silent == ("gnss",)
    poses, sigma = np.tile(np.eye(4), (2, 1, 1)), np.array([[0.1, 0.1, 0.1], [np.nan] * 3])
    fixed = made.scene.with_(prior="gnss", world_from_rig=poses, position_sigma_m=sigma)
    assert replace(made, run=run, scene=fixed).silent == ()


def test_a_whole_survey_is_its_own_side(tmp_path: Path) -> None:
    made = block(tmp_path, whole=True)
    assert made.side("tiegraph") == tmp_path / "survey" and made.images == tmp_path / "images"
    assert made.side("colmap") == tmp_path / "block" / "colmap"
    made.run.folder.mkdir()
    assert interrupted_note(made, "tiegraph", STAGES) == ""
