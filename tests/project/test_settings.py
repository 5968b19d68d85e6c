"""Settings are strict, layered and come back from their file; others are refused before anything is stored."""

import os
import re
from typing import get_args

import pytest

from said import refused
from tiegraph.api import open_project
from tiegraph.cli.main import main
from tiegraph.cli.run import preparsed
from tiegraph.errors import InputError, SettingsError
from tiegraph.pipeline import STAGES
from tiegraph.project.folder import SETTINGS
from tiegraph.project.inputs import Stamps
from tiegraph.project.settings import (
    PRESETS,
    Settings,
    Tunings,
    VerbTunings,
    changed,
    merged,
    preset,
    read_file,
    read_tunings,
    sections,
)
from tiegraph.project.stages import stage_keys
from tiegraph.scene.atomic import MARK


def test_every_preset_is_valid_and_changes_what_it_says():
    for name in PRESETS:
        settings = merged(preset(name))
        for section, values in preset(name).items():
            for key, value in values.items():
                own = getattr(getattr(settings, section), key)
                assert own == (type(own).model_validate(value) if isinstance(value, dict) else value)


@pytest.mark.parametrize(
    ("given", "words"),
    [
        ({"masks": {"sorce": "none"}}, r"unknown setting 'masks.sorce'; perhaps you meant 'source'"),
        ({"mask": {"source": "none"}}, r"unknown setting 'mask'; perhaps you meant 'masks'"),
        ({"masks": {"difference": 999}}, r"masks.difference = 999.*254"),
        ({"tuning": {"sfm": {"start_check": {"of": 3}}}}, r"'tuning.sfm.start_check.of'; perhaps you meant 'off'"),
        ({"tuning": {"network": {"coarse": {"most_focal": 0.5}}}}, r"tuning.network.coarse.most_focal = 0.5"),
        ({"tuning": {"netwrok": {}}}, r"'tuning.netwrok'; perhaps you meant 'network'"),
    ],
)
def test_typos_are_refused_with_the_nearest_name(given, words):
    with pytest.raises(SettingsError, match=words):
        merged(given)


def test_about_seventy_settings_at_most():
    count = sum(len(fields) for _, fields in sections())
    # One more for products.objects_m: how wide the halls of a survey are no constant can know. Four for the mesh: how
    # large and fine a mesh somebody's viewer takes no constant can know either.
    assert count <= 108, "a constant that nobody should change is a constant"


def test_the_constants_of_an_engine_are_in_reach_and_in_the_keys_of_its_stages(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / SETTINGS).write_text("[tuning.targets]\nlooked_at = 9\n[tuning.sfm.mapping]\nclearly_fewer = 0.7\n")
    project = open_project(tmp_path, out, settings={"tuning": {"sfm": {"mapping": {"roughly_fewer": 0.4}}}})
    tuning = project.settings.tuning
    mapping = tuning.sfm.mapping
    assert (tuning.targets.looked_at, mapping.clearly_fewer, mapping.roughly_fewer) == (9, 0.7, 0.4)
    assert mapping.rough_tracks == 100
    project.save()
    assert open_project(out=out).settings == project.settings
    changed_values = {"targets": {"looked_at": 9}, "sfm": {"mapping": {"clearly_fewer": 0.7, "roughly_fewer": 0.4}}}
    assert read_file(out / SETTINGS)["tuning"] == changed_values == changed(project.settings)["tuning"]
    only = open_project(tmp_path, out / "targets", settings={"tuning": {"targets": {"looked_at": 9}}}).settings
    before, after = (stage_keys(STAGES, s, {"images": 1}, Stamps(out)) for s in (Settings(), only))
    needs_targets = {"georef", "refine", "dense", "cloud", "products", "evaluate", "report"}
    assert {name for name in before if before[name] != after[name]} == needs_targets


def test_precedence_defaults_preset_file_call(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / SETTINGS).write_text('[masks]\nsource = "sky"\n[dense]\npartners = 2\n')
    project = open_project(tmp_path, out, preset="conventional", settings={"dense": {"partners": 3}})
    assert project.settings.candidates.sources == ("exhaustive",)
    assert project.settings.masks.source == "sky"
    assert project.settings.dense.partners == 3


def test_a_project_remembers_inputs_preset_and_settings(tmp_path):
    out = tmp_path / "out"
    first = open_project(tmp_path, out, preset="meguro2024", rig="ladybug5", settings={"masks": {"source": "none"}})
    first.save()
    again = open_project(out=out)
    assert again.settings == first.settings
    assert again.inputs == first.inputs
    assert again.preset == "meguro2024"
    assert set(changed(again.settings)) >= {"masks", "network", "sparse"} or again.settings.masks.source == "none"
    before = (out / SETTINGS).stat().st_mtime_ns
    again.save()
    assert (out / SETTINGS).stat().st_mtime_ns == before
    (out / MARK).touch()
    in_place_of_the_images = open_project(out)
    assert (in_place_of_the_images.folder, in_place_of_the_images.inputs) == (out, first.inputs)


def test_misuse(tmp_path):
    with pytest.raises(SettingsError, match="unknown preset 'meguro2O24'.*meguro2024"):
        preset("meguro2O24")
    with refused("not a run folder"):
        open_project(out=tmp_path)
    with pytest.raises(SettingsError, match="unknown input 'gps'"):
        open_project(tmp_path, gps="a.csv")
    for text, words in (("[masks\n", "not valid TOML"), ("masks = 3\n", "'masks' must be a section")):
        (tmp_path / SETTINGS).write_text(text)
        with pytest.raises(SettingsError, match=words):
            open_project(tmp_path, tmp_path)


def test_what_is_unset_holds_no_more(tmp_path):
    (tmp_path / "images").mkdir()
    (tmp_path / "g.csv").write_text("")
    out, given = tmp_path / "out", tmp_path / "g.csv"
    settings = {"masks": {"source": "folder", "folder": str(tmp_path), "water": "on"}}
    stored = open_project(tmp_path / "images", out, rig="ladybug5", gnss=given, gcp=given, settings=settings)
    stored.save()
    project = open_project(out=out, unset=("gnss", "gcp", "masks.folder", "masks.source", "candidates.pairs-file"))
    assert project.inputs.gnss is None and project.inputs.rig == "ladybug5"
    assert changed(project.settings) == {"masks": {"water": "on"}}
    assert open_project(out=out).inputs.gnss == given, "not before the project is saved"
    project.save()
    assert open_project(out=out).inputs == project.inputs and open_project(out=out).settings == project.settings
    assert open_project(out=out, gnss=given, unset=("gnss",)).inputs.gnss == given, "what is given anew holds"
    for name, message in (("masks.foldr", "perhaps you meant .masks.folder"), ("images", "neither one of rig, ca")):
        with pytest.raises(SettingsError, match=f"--unset {name}: .*{message}"):
            open_project(out=out, unset=(name,))


def test_control_points_and_a_tolerance_are_inputs_and_settings(tmp_path):
    images, out, points = tmp_path / "images", tmp_path / "out", tmp_path / "gcp_list.txt"
    images.mkdir()
    points.write_text("EPSG:32654\n")
    project = open_project(images, out, gcp=points, tolerance=0.05)
    project.save()
    for found in (project.settings, open_project(out=out).settings):
        assert found.georef.gcp == points.resolve() and found.evaluate.tolerance_m == 0.05
    with pytest.raises(SettingsError, match="known are rig, .*gcp, marks"):
        open_project(images, out, gcps=points)


NUMBERS = [
    (section, name, field)
    for section, fields in sections()
    for name, field in fields.items()
    if any(kind in str(field.annotation) for kind in ("int'", "float'", "[int", "[float"))
]


@pytest.mark.parametrize("section, name, field", NUMBERS, ids=[f"{s}.{n}" for s, n, _ in NUMBERS])
def test_no_number_is_without_bounds(section, name, field):
    for value in (1e30, -1e30, float("nan"), float("inf"), float("-inf")):
        if "tuple" in str(field.annotation):
            parts = next(a for a in (field.annotation, *get_args(field.annotation)) if str(a).startswith("tuple"))
            value = [value] * (1 if Ellipsis in get_args(parts) else len(get_args(parts)))
        given = {"folder": ".", name: value} if section == "masks" else {name: value}
        with pytest.raises(SettingsError, match=rf"{section}.{name}"):
            merged({section: given})


@pytest.mark.parametrize(
    "text, message",
    [
        ("run = 5", r"run = 5 must be a section \[run\]"),
        ("[[run]]\nimages = 'x'", r"run = \[.* must be a section"),
        ("[run]\nimages = 5", "run.images = 5: give a path"),
        ("[run]\nimages = ''", "run.images = '': give a path"),
        ("[run]\nimges = 'x'", "unknown name 'imges' in .run.; perhaps you meant 'images'"),
        ("[run]\ngcp = 'x'", "unknown name 'gcp' in .run.: it is the setting gcp of .georef."),
        ("[run]\nvoxel_size = 1", "it is the setting voxel_size of .cloud."),
        ("[[masks]]\nsource = 'sky'", "'masks' must be a section such as .masks."),
        ("cloud = 'x'", "'cloud' must be a section such as .cloud., and is 'x'"),
        ("[cloud]\nvoxel_size = inf", "cloud.voxel_size = inf: Input should be a finite number"),
        ("[cloud]\nvoxel_size = nan", "cloud.voxel_size = nan"),
        ("[cloud]\nvoxel_size = 2020-01-01", "cloud.voxel_size = datetime.date"),
        ("[cloud]\nvoxel_size = true", "voxel_size = true: give a number"),
        ("[sparse]\nreadout_ms = true", "readout_ms = true: give a number"),
        ("[match]\nguided = 1", "guided = 1: give true or false"),
        ("[match]\nguided = 'no'", "guided = 'no': give true or false"),
        ("[dense]\npartners = [4]", "dense.partners = .4."),
        ("[masks]\nfolder = 5", "masks.folder = 5"),
        ("[candidates]\nsources = []", "candidates.sources"),
        ("[candidates]\npairs_file = 'p.txt'", "pairs_file is given, but sources = auto does not use it"),
        ("[evaluate]\nreference_origin = [139, 35, 0]", "evaluate.reference_origin.0 = 139"),
        ("a = " + "[" * 99999, "not valid TOML"),
    ],
)
def test_files_of_settings_that_cannot_be_used(tmp_path, text, message):
    (tmp_path / SETTINGS).write_text(text)
    with pytest.raises(SettingsError, match=message) as error:
        open_project(tmp_path, tmp_path)
    assert str(tmp_path / SETTINGS) in str(error.value) and len(str(error.value)) < 1000


@pytest.mark.parametrize("data", [b"\xff\xfe[\0r\0", b"\x89PNG\r\n\x1a\n", b"[masks]\n# \xe9\n", b"\0\0\0"])
def test_a_settings_file_that_is_no_text(tmp_path, data):
    (tmp_path / SETTINGS).write_bytes(data)
    with pytest.raises(SettingsError, match="tiegraph.toml: not"):
        open_project(tmp_path, tmp_path)
    (tmp_path / SETTINGS).write_bytes(b"\xef\xbb\xbf[masks]\r\nsource = 'sky'\r\n")  # Notepad's
    assert open_project(tmp_path, tmp_path).settings.masks.source == "sky"
    (tmp_path / SETTINGS).unlink()
    (tmp_path / SETTINGS).mkdir()
    with pytest.raises(SettingsError, match="cannot be read"):
        open_project(tmp_path, tmp_path)


PATHS = [
    ("masks", "folder", "folder", {}),
    ("masks", "model", "file", {"source": "model"}),
    ("candidates", "pairs_file", "file", {"sources": ["file"]}),
    ("features", "model", "file", {"engine": "onnx"}),
    ("georef", "gcp", "file", {}),
    ("georef", "marks", "file", {}),
    ("evaluate", "reference", "file or folder", {}),
    ("evaluate", "reference_cloud", "file", {}),
]


def test_every_path_is_checked():
    found = {(s, n) for s, fields in sections() for n, field in fields.items() if "Path" in str(field.annotation)}
    assert found == {(section, name) for section, name, _, _ in PATHS}


@pytest.mark.parametrize("section, name, kind, more", PATHS, ids=[f"{s}.{n}" for s, n, _, _ in PATHS])
def test_a_file_of_the_settings_that_is_not_there_is_refused_before_anything_runs(tmp_path, section, name, kind, more):
    (tmp_path / "images").mkdir()
    (tmp_path / "file").write_text("x")
    os.mkfifo(tmp_path / "pipe")
    wrong = [("nowhere", "no such"), ("pipe", "a named pipe")]
    wrong += [("file", "is a file.* give a folder")] if kind == "folder" else []
    wrong += [("images", "is a folder.* give a file")] if kind == "file" else []
    for path, message in wrong:
        settings = {section: {**more, name: str(tmp_path / path)}}
        project = open_project(tmp_path / "images", tmp_path / "out", settings=settings)
        with refused(rf"--.*{name.split('_')[-1]} {tmp_path / path}.*{message}"):
            project.run()
    assert not (tmp_path / "out").exists(), "nothing is stored of what was refused"


@pytest.mark.parametrize(
    "inputs, settings, message",
    [
        ({"rig": "nosuch"}, {}, "--rig nosuch: no such file, and no preset"),
        ({"rig": "ring:nan"}, {}, "--rig ring:nan: expected a number"),
        ({}, {"scan": {"crs": "foo"}}, "unknown CRS 'foo'"),
        ({}, {"candidates": {"sources": ["file"]}}, "candidates.pairs_file names none"),
        ({"trajectory": "text"}, {}, "text: no rows below its header"),
        ({"trajectory": "nowhere"}, {}, "--trajectory .*nowhere: no such file or folder"),
        ({"times": "images"}, {}, "--times .*images is a folder; give a file"),
        ({"gcp": "text"}, {}, "text, line 1: 'nonsense' is no coordinate system"),
        ({"gnss": "text"}, {}, "text"),
        ({}, {"candidates": {"sources": ["file"], "pairs_file": "text"}}, "text, line 1: expected two image names"),
        ({}, {"evaluate": {"reference": "text"}}, "text: no rows below its header"),
        ({}, {"evaluate": {"reference": "images"}}, "neither a COLMAP model"),
        ({}, {"evaluate": {"reference_cloud": "text"}}, "text: clouds are read from .las, .laz, .ply or .e57"),
        ({}, {"masks": {"source": "model", "model": "text"}}, "text: not valid TOML"),
    ],
)
def test_what_is_refused_is_not_stored(tmp_path, monkeypatch, inputs, settings, message):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "images").mkdir()
    (tmp_path / "text").write_text("nonsense\n")
    with pytest.raises((InputError, SettingsError), match=message):
        open_project(tmp_path / "images", tmp_path / "out", settings=settings, **inputs).run()
    assert not (tmp_path / "out").exists()


def test_a_distance_of_shots_that_is_none_is_a_setting_that_is_refused(tmp_path):
    (tmp_path / "images").mkdir()
    with pytest.raises(SettingsError, match=r"shots.near_m = -3.0: .*greater than 0"):
        open_project(tmp_path / "images", tmp_path / "out").shots(near_m=-3.0)
    assert not (tmp_path / "out").exists()


@pytest.mark.slow
def test_arguments_in_any_order():
    for arguments in (
        ["im", "-o", "o"],
        ["--gnss", "g.csv", "im", "-o=o"],
        ["--json", "--out", "o", "im"],
        ["--candidates.sources", "offsets", "poses", "--no-quiet", "im", "--out=o"],
        ["--coarse.method", "off", "im", "-o", "o"],
        ["--scan.crop_px", "1", "2", "3", "4", "im", "-o", "o"],
        ["--evaluate.reference-origin", "-33.9", "-70", "5", "--match.guided", "im", "-o", "o"],
    ):
        folder, known = preparsed(arguments)
        assert (str(folder), str(known.out)) == ("im", "o"), arguments


@pytest.mark.slow
def test_what_is_to_be_unset_is_known_before_the_options_are_read():
    folder, known = preparsed(["im", "--unset", "gnss", "-o", "o", "--unset=masks.folder"])
    assert known.unset == ("gnss", "masks.folder") and (str(folder), str(known.out)) == ("im", "o")


@pytest.mark.slow
def test_an_output_without_a_name(tmp_path, monkeypatch, capsys):
    monkeypatch.chdir(tmp_path)
    (tmp_path / "im").mkdir()
    for arguments in (["im", "-o"], ["im", "-o", "--rig", "x"], ["im", "--out", ""], ["im", "--out="], ["", "-o", "o"]):
        assert main(["run", *arguments]) == 2
        said = capsys.readouterr().err
        assert "name of a folder is empty" in said or "-o" in said, arguments
        assert [p.name for p in tmp_path.iterdir()] == ["im"], arguments


def test_a_file_changes_what_it_names(tmp_path):
    path = tmp_path / "tuning.toml"
    path.write_text("[tuning.stations.precision]\nbands = 4\n[tuning.scene.blocks]\nown = 300\n")
    found = read_tunings(path)
    assert found.stations.precision.bands == 4 != VerbTunings().stations.precision.bands
    assert found.lidar == VerbTunings().lidar
    assert found.changed() == {"stations": {"precision": {"bands": 4}}, "scene": {"blocks": {"own": 300}}}
    assert found.of_stages() == {"scene": {"blocks": {"own": 300}}}
    assert read_tunings(None).changed() == {}


def test_every_engine_with_constants_is_in_reach():
    """Of the stages by a run's tiegraph.toml, of the others by --tuning."""
    from pathlib import Path

    import tiegraph

    rooms = {p.parent.name for p in Path(tiegraph.__file__).parent.glob("*/tuning.py")}
    rooms |= {p.parent.parent.name for p in Path(tiegraph.__file__).parent.glob("*/tuning/__init__.py")}
    assert len(rooms) > 15 and rooms == set(VerbTunings.model_fields)
    assert set(Tunings.model_fields) < rooms


@pytest.mark.parametrize(
    "text, said",
    [
        ("[tuning.stations.precision]\nband = 4\n", "unknown setting 'tuning.stations.precision.band'; .*'bands'"),
        ("[tuning.station]\n", "unknown setting 'tuning.station'; .*'stations'"),
        ("[masks]\nsource = 'none'\n", "unknown setting 'masks'"),
        ("[tuning.stations.precision]\nbands = 0\n", "tuning.stations.precision.bands = 0: "),
        ("[tuning.stations", "not valid TOML"),
    ],
)
def test_what_is_wrong_is_named(tmp_path, text, said):
    path = tmp_path / "tuning.toml"
    path.write_text(text)
    with pytest.raises(SettingsError, match=f"{re.escape(str(path))}: {said}"):
        read_tunings(path)
    with pytest.raises(SettingsError, match="--tuning .*there.toml: not there"):
        read_tunings(tmp_path / "there.toml")
