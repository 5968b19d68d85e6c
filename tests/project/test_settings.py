"""Settings are strict, layered, and come back from their file."""

import pytest

from tiegraph.api import open_project
from tiegraph.errors import InputError, SettingsError
from tiegraph.pipeline import STAGES
from tiegraph.project.folder import SETTINGS
from tiegraph.project.inputs import Stamps
from tiegraph.project.settings import PRESETS, Settings, changed, merged, preset, read_file, sections
from tiegraph.project.stages import stage_keys


def test_every_preset_is_valid_and_changes_what_it_says():
    for name in PRESETS:
        settings = merged(preset(name))
        for section, values in preset(name).items():
            for key, value in values.items():
                own = getattr(getattr(settings, section), key)
                assert own == (type(own).model_validate(value) if isinstance(value, dict) else value)


def test_typos_are_refused_with_the_nearest_name():
    with pytest.raises(SettingsError, match=r"unknown setting 'masks.sorce': perhaps you meant 'source'"):
        merged({"masks": {"sorce": "none"}})
    with pytest.raises(SettingsError, match=r"unknown setting 'mask': perhaps you meant 'masks'"):
        merged({"mask": {"source": "none"}})
    with pytest.raises(SettingsError, match=r"masks.difference = 999.*254"):
        merged({"masks": {"difference": 999}})
    with pytest.raises(SettingsError, match="unknown preset 'meguro2O24'.*meguro2024"):
        preset("meguro2O24")


def test_about_seventy_settings_at_most():
    count = sum(len(fields) for _, fields in sections())
    assert count <= 103, "a constant that nobody should change is a constant"


def test_the_constants_of_an_engine_are_in_reach_and_in_the_keys_of_its_stages(tmp_path):
    out = tmp_path / "out"
    out.mkdir()
    (out / SETTINGS).write_text("[tuning.filter]\nmatches_a_pair = 9\n[tuning.filter.loops]\ntrials = 300\n")
    project = open_project(tmp_path, out, settings={"tuning": {"filter": {"loops": {"rounds": 4}}}})
    tuning = project.settings.tuning.filter
    assert (tuning.matches_a_pair, tuning.loops.trials, tuning.loops.rounds, tuning.loops.directions) == (
        9,
        300,
        4,
        200,
    )
    project.save()
    assert open_project(out=out).settings == project.settings
    changed_values = {"filter": {"matches_a_pair": 9, "loops": {"trials": 300, "rounds": 4}}}
    assert read_file(out / SETTINGS)["tuning"] == changed_values == changed(project.settings)["tuning"]
    before, after = (stage_keys(STAGES, s, {"images": 1}, Stamps(out)) for s in (Settings(), project.settings))
    needs_filter = {"filter", "sparse", "georef", "refine", "dense", "cloud", "products", "evaluate", "report"}
    assert {name for name in before if before[name] != after[name]} == needs_filter


def test_typos_of_constants_are_refused_with_the_nearest_name():
    with pytest.raises(SettingsError, match=r"'tuning.filter.loops.trails': perhaps you meant 'trials'"):
        merged({"tuning": {"filter": {"loops": {"trails": 3}}}})
    with pytest.raises(SettingsError, match=r"tuning.filter.prior.margin = 0.5"):
        merged({"tuning": {"filter": {"prior": {"margin": 0.5}}}})
    with pytest.raises(SettingsError, match=r"'tuning.fliter': perhaps you meant 'filter'"):
        merged({"tuning": {"fliter": {}}})


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


def test_misuse(tmp_path):
    with pytest.raises(InputError, match="not a run folder"):
        open_project(out=tmp_path)
    with pytest.raises(SettingsError, match="unknown input 'gps'"):
        open_project(tmp_path, gps="a.csv")
    (tmp_path / SETTINGS).write_text("[masks\n")
    with pytest.raises(SettingsError, match="not valid TOML"):
        open_project(tmp_path, tmp_path)
    (tmp_path / SETTINGS).write_text("masks = 3\n")
    with pytest.raises(SettingsError, match="'masks' must be a section"):
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


def test_control_points_are_an_input_and_a_setting(tmp_path):
    from tiegraph.api import open_project

    (tmp_path / "images").mkdir()
    points = tmp_path / "gcp_list.txt"
    points.write_text("EPSG:32654\n")
    project = open_project(tmp_path / "images", tmp_path / "out", gcp=points)
    assert project.settings.georef.gcp == points.resolve()
    project.save()
    again = open_project(None, tmp_path / "out")
    assert again.settings.georef.gcp == points.resolve()
    with pytest.raises(SettingsError, match="known are rig, .*gcp, marks"):
        open_project(tmp_path / "images", tmp_path / "out", gcps=points)


def test_a_tolerance_is_an_input_and_a_setting(tmp_path):
    (tmp_path / "images").mkdir()
    project = open_project(tmp_path / "images", tmp_path / "out", tolerance=0.05)
    assert project.settings.evaluate.tolerance_m == 0.05
    project.folder.mkdir()
    project.save()
    assert open_project(out=tmp_path / "out").settings.evaluate.tolerance_m == 0.05
    assert open_project(out=tmp_path / "out", unset=["tolerance"]).settings.evaluate.tolerance_m is None
    for wrong in (-0.05, 0, float("nan"), "5 cm"):
        with pytest.raises(SettingsError, match="--tolerance: evaluate.tolerance_m = "):
            open_project(tmp_path / "images", tmp_path / "out", tolerance=wrong)
