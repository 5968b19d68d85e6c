"""The door: what the command line loads, its verbs, `doctor`, help pages, and `tiegraph evaluate CLOUD REFERENCE`."""

import json
import re
import shutil
import signal
import subprocess
import sys
from collections import namedtuple
from dataclasses import fields
from importlib.metadata import version
from pathlib import Path
from types import SimpleNamespace

import cv2
import laspy
import numpy as np
import pyproj
import pytest

import tiegraph
from boat_world import photos
from clouds_world import ground
from tiegraph.cli import doctor, forms
from tiegraph.cli.main import main
from tiegraph.cli.run import RunOptions
from tiegraph.cli.verbs import RUN_PAGE, VERBS, Verb, wants_page
from tiegraph.errors import EngineMissing
from tiegraph.geometry.geodesy import Origin, crs_coordinates, geodetic_from_world, world_from_geodetic
from tiegraph.pipeline import MESH, SHOTS, STAGES
from tiegraph.pipeline import plan as forecast
from tiegraph.project.settings import PRESETS, sections
from tiegraph.scene.cloudchunks import Measured, write_measured
from tiegraph.scene.pairs import Pairs, PreviewMatches
from tiegraph.settings import Section

# Libraries that take a tenth of a second or more to load, and what of ours brings them.
HEAVY = {"pycolmap", "cv2", "scipy", "numpy", "matplotlib", "pyproj", "laspy", "pydantic", "tyro", "rich", "PIL"}
HEAVY |= {"tiegraph.api", "tiegraph.pipeline", "tiegraph.project.settings"}


def python(*arguments: str) -> subprocess.CompletedProcess:
    """A fresh interpreter."""
    return subprocess.run([sys.executable, *arguments], capture_output=True, text=True, check=False, timeout=120)


def loaded(*arguments: str) -> set[str]:
    """The modules that are loaded when the command line has answered."""
    code = "import sys\nfrom tiegraph.cli.main import main\ncode = main(sys.argv[1:])\n"
    code += "print(*sorted(sys.modules), file=sys.stderr)\nsys.exit(code)"
    done = python("-c", code, *arguments)
    assert done.returncode in (0, 2), done.stderr
    return set(done.stderr.split())


@pytest.mark.slow
@pytest.mark.parametrize("arguments", ["--help", "--version", "rum", "run --help"])
def test_what_needs_no_engine_loads_none(arguments):
    assert not loaded(*arguments.split()) & HEAVY


@pytest.mark.slow
def test_a_verb_that_computes_loads_engines():
    """The other side: the test above would see them."""
    assert {"pycolmap", "numpy", "tyro"} <= loaded("compare", "--help")


def test_help_names_every_verb(capsys):
    assert main(["--help"]) == 0
    said = capsys.readouterr().out
    for name, verb in VERBS.items():
        assert f"  {name:<15} {verb.about}\n" in said


def test_the_table_knows_the_stages():
    """The table repeats what stages make, for loading them takes seconds."""
    stages = {s.name: s for s in STAGES}
    assert [name for name in VERBS if name in stages] == list(stages)
    for name, stage in stages.items():
        files = VERBS[name].about.removeprefix("stage: makes ").split(";")[0].split(", ")
        assert files == list(stage.makes), name
    assert {SHOTS.name, MESH.name} <= set(VERBS)


@pytest.mark.parametrize("name", VERBS)
def test_every_verb_can_be_loaded(name):
    assert callable(VERBS[name].load(name))


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGTERM"), reason="no such signal")
@pytest.mark.parametrize("caught", ["ZeroDivisionError", "BaseException"])
def test_a_verb_is_stopped_in_one_line_after_pycolmap_is_loaded(caught):
    """pycolmap has handlers of its own that print stack traces: the signals are taken back after a verb is loaded. A
    library (pydantic) may make an error of its own of the KeyboardInterrupt."""
    code = f"""
import os, signal, sys, time
from tiegraph.cli import main, verbs
load = verbs.Verb.load
def loaded(*of):
    load(*of)
    return stopped
def stopped(arguments):
    try:
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(20)
    except {caught} as error:
        raise ValueError("KeyboardInterrupt: ")
verbs.Verb.load = loaded
sys.argv = ["tiegraph", "doctor"]
sys.exit(main.main())
"""
    done = python("-c", code)
    said = "tiegraph: stopped; finished work is kept: run the same command again to go on\n"
    assert (done.returncode, done.stdout, done.stderr) == (1, "", said)


def test_which_arguments_ask_for_the_page():
    assert wants_page(["--help"]) and wants_page(["images", "-h"])
    assert not wants_page([]) and not wants_page(["images"]) and not wants_page(["--help-all"])
    assert not wants_page(["--help", "--help-all"])


@pytest.mark.slow
def test_the_package_can_be_run():
    done = python("-m", "tiegraph", "--version")
    assert (done.returncode, done.stdout, done.stderr) == (0, f"tiegraph {tiegraph.__version__}\n", "")
    wrong = python("-m", "tiegraph", "rum")
    assert wrong.returncode == 2 and "perhaps you meant 'run'" in wrong.stderr


def test_the_package_shows_its_names():
    """Before any was used: in a fresh interpreter, without loading what is behind them."""
    done = python("-c", "import sys, tiegraph; print(*dir(tiegraph)); print('tiegraph.api' in sys.modules)")
    names, used = done.stdout.splitlines()
    assert {"open", "Project", "Scene", "Pairs", "Cloud", "__version__"} <= set(names.split()) and used == "False"
    assert set(tiegraph.__all__) <= set(dir(tiegraph))
    for name in tiegraph.__all__:
        assert getattr(tiegraph, name) is not None
    assert tiegraph.open is tiegraph.api.open_project
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = tiegraph.nothing


@pytest.fixture
def asked(monkeypatch):
    """What the stage is run with, and what is printed."""
    calls = []
    monkeypatch.setattr(forms.run, "main_stage", lambda stage, arguments, *_: calls.append((stage, arguments)) or 0)
    monkeypatch.setattr(forms, "find_browser", lambda: "chromium")
    monkeypatch.setattr(forms, "print_pdf", lambda page, target: calls.append((page.name, target)))
    return calls


@pytest.mark.slow
def test_language_is_the_setting_and_pdf_prints_after_the_stage(asked, tmp_path, capsys):
    assert forms.report([str(tmp_path), "--language", "ja", "--pdf"]) == 0
    assert asked == [
        ("report", [str(tmp_path), "--report.language", "ja"]),
        ("report.html", tmp_path / "report.pdf"),
    ]
    assert f"printed: {tmp_path / 'report.pdf'}" in capsys.readouterr().out
    forms.report([str(tmp_path), "--language=en"])
    assert asked[2:] == [("report", [str(tmp_path), "--report.language=en"])]


def test_what_is_missing_is_said_before_the_work(asked, monkeypatch, tmp_path):
    def none():
        raise EngineMissing("no browser")

    monkeypatch.setattr(forms, "find_browser", none)
    with pytest.raises(EngineMissing, match="no browser"):
        forms.report([str(tmp_path), "--pdf"])
    assert asked == []


RING, CHAIN = Pairs.make([0, 1, 2, 0], [1, 2, 3, 3], "file"), Pairs.make([0, 1, 2], [1, 2, 3], "file")


@pytest.fixture
def judged(tmp_path, monkeypatch, capsys):
    """What --coverage says of candidate pairs and of chosen ones, and its exit code."""
    asked = []
    monkeypatch.setattr(forms.run, "main_stage", lambda stage, arguments, *_: asked.append(stage))
    (tmp_path / "tiegraph.toml").write_text("[run]\nimages = '.'\n")
    for name, folder in (("scene.json", tmp_path), ("scene.json", tmp_path / "network")):
        folder.mkdir(exist_ok=True)
        (folder / name).write_text(photos(4).to_json())

    def say(candidates, chosen, *more, previews=None):
        for folder, ties in (("coarse", previews or PreviewMatches.empty()), ("design", PreviewMatches.empty())):
            (tmp_path / folder).mkdir(exist_ok=True)
            np.savez(tmp_path / folder / "matches.npz", **ties.to_npz())
        for name, pairs in (("network", candidates), ("pairs", chosen)):
            np.savez(tmp_path / f"{name}.npz", **pairs.to_npz())
        code = forms.network(["--coverage", str(tmp_path), *more])
        assert asked[-1] == "design", "else the pairs that it chose may be those of another network"
        return code, capsys.readouterr().out

    return say


@pytest.mark.slow
def test_coverage_judges_the_chosen_pairs_too(judged):
    code, said = judged(RING, RING)
    assert code == 0 and said.count("no place depends on a single link") == 2
    code, said = judged(RING, CHAIN)
    assert code == 1 and "candidate pairs: 4 pairs connect 4 images" in said
    assert "pairs that the design chose: 3 single links" in said
    assert "weak links of the pairs that the design chose" in said and "weak links of the candidate" not in said


@pytest.mark.slow
def test_coverage_as_json(judged):
    code, said = judged(RING, CHAIN, "--json")
    told = json.loads(said)
    assert code == 1 and told["sound"] is False and told["bridges"] == 0 and told["pairs"] == 4
    assert told["chosen"]["sound"] is False and told["chosen"]["bridges"] == 3
    assert len(told["chosen"]["weak_links"]["rows"]) == 5 and told["weak_links"]["rows"] == []


@pytest.mark.slow
def test_coverage_judges_by_the_matches_of_previews_too(judged):
    """All pairs of four photographs are sound by themselves; the last one shares 40 points with the first and what
    noise has with the others. Of the pairs that the design chose the one of the 40 is not: these are worse.
    """
    ends = np.array([[0, 0, 1, 0, 1, 2], [1, 2, 2, 3, 3, 3]])
    every, matches = np.stack([np.arange(400)] * 2, axis=1), [400, 400, 400, 40, 20, 20]
    looks = PreviewMatches.make(*ends, [every[:n] for n in matches])
    code, said = judged(
        Pairs.make(*ends, "file"), Pairs.make(*ends[:, np.array(matches) != 40], "file"), previews=looks
    )
    first, second = said.split("pairs that the design chose", 1)
    assert code == 1 and "candidate pairs: hardly tied to the others" in first and "003.jpg: 40" in first
    assert "003.jpg: 0" in second and "000.jpg" not in said and "few points" in first
    assert judged(RING, RING)[0] == 0  # without previews only pairs can be judged
    whole = PreviewMatches.make(*ends, [every] * 6)
    assert judged(RING, RING, previews=whole)[0] == 0


@pytest.fixture
def images(tmp_path):
    folder = tmp_path / "images"
    folder.mkdir()
    for k in range(6):
        cv2.imwrite(str(folder / f"{k}.png"), np.full((300, 400, 3), k, np.uint8))
    return folder


def plan(images, capsys, *more):
    code = main(["run", str(images), "-o", str(images.parent / "out"), "--plan", *more])
    return code, "".join(capsys.readouterr())


@pytest.mark.slow
def test_images_disk_and_time_are_said_and_nothing_is_made(images, capsys):
    code, said = plan(images, capsys)
    assert code == 0 and "images: 6" in said and "enough" in said and not (images.parent / "out").exists()
    row = json.loads(plan(images, capsys, "--json")[1].splitlines()[-1])
    assert row["images"] == 6 and 6 * 400 * 300 * 4 < row["dense_bytes"] < 6 * 400 * 300 * 9
    assert 6 * 150e3 < row["model_bytes"] < 6 * 500e3 and row["there_bytes"] == 0
    bare = json.loads(plan(images, capsys, "--json", "--products.make", "none")[1].splitlines()[-1])
    assert 6 * 400 * 300 * 3 < 1e6 * (row["dense_cpu_s"] - bare["dense_cpu_s"]) < 6 * 400 * 300 * 3.5
    assert 0.3 < (row["dense_bytes"] - bare["dense_bytes"]) / (6 * 400 * 300) < 1.5
    more = json.loads(plan(images, capsys, "--json", "--features.max-features", "64")[1].splitlines()[-1])
    assert more["model_bytes"] < row["model_bytes"] and more["dense_bytes"] == row["dense_bytes"]


@pytest.mark.slow
def test_a_disk_that_is_too_small_is_said(images, capsys, monkeypatch):
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage(10**9, 10**9 - 10**6, 10**6))
    code, said = plan(images, capsys)
    assert code == 1 and "NOT ENOUGH" in said


def test_what_is_there_already_counts(images, capsys):
    run = images.parent / "out"
    run.mkdir()
    (run / "tiegraph.toml").write_text("")
    (run / "database.db").write_bytes(b"x" * 10**6)
    assert forecast._size(run) == 10**6
    (run / "link").symlink_to(run / "database.db")
    assert forecast._size(run) == 10**6


@pytest.mark.slow
def test_frames_of_videos_are_counted_by_scan(images, capsys):
    (images / "drive.mp4").write_bytes(b"none is looked at")
    code, said = plan(images, capsys)
    assert code == 0 and "counted by the stage scan" in said and not (images.parent / "out").exists()


@pytest.fixture
def lines(capsys, monkeypatch):
    """{what: how it is} as printed; columns of a narrow terminal change nothing."""
    monkeypatch.setenv("COLUMNS", "40")

    def run() -> dict[str, str]:
        assert main(["doctor"]) == 0
        rows = capsys.readouterr().out.splitlines()
        return {row[:24].rstrip(): row[25:] for row in rows}

    return run


def test_what_doctor_names(lines):
    said = lines()
    names = "tiegraph|python|pycolmap|numpy|cores|memory|disk|native kernels|descriptor kernels|ONNX Runtime|PROJ grids"
    assert {*names.split("|"), "dask", "pycolmap with CUDA", "disk, temporary files"} <= set(said)
    assert all(said.values())


def test_what_is_installed_has_its_version_and_hints_for_the_rest_keep_their_brackets(lines, monkeypatch):
    names = ("ONNX Runtime", "dask", "rosbags")
    monkeypatch.setattr(doctor, "version", lambda name: f"0.11 of {name}")
    assert [lines()[name] for name in names] == ["0.11 of onnxruntime", "0.11 of distributed", "0.11 of rosbags"]
    monkeypatch.setattr(doctor, "version", lambda name: version(f"no-{name}"))
    assert [lines()[name] for name in names] == [
        "not installed (pip install 'tiegraph[onnx]' for --masks.source model, --features.engine onnx)",
        "not installed (pip install 'tiegraph[dask]' for --pool dask:<address>)",
        "not installed (pip install 'tiegraph[ros]' for bags of ROS)",
    ]


def test_native_kernels_there_and_not(lines, monkeypatch):
    monkeypatch.setattr(doctor, "kernels", lambda: ["avx2", "plain"])
    assert lines()["native kernels"] == "avx2, plain (the fastest first)"
    monkeypatch.setattr(doctor, "kernels", lambda: [])
    said = lines()["native kernels"]
    assert said.startswith("not built") and "C++ compiler" in said


@pytest.mark.parametrize("online", [False, True])
@pytest.mark.parametrize("files", [(), ("us_noaa_g2012bu0.tif", "egm96_15.gtx", "proj.db")])
def test_grids(lines, monkeypatch, tmp_path: Path, online: bool, files: tuple[str, ...]):
    for name in files:
        (tmp_path / name).touch()
    monkeypatch.setattr(pyproj.datadir, "get_data_dir", lambda: str(tmp_path))
    monkeypatch.setattr(pyproj.datadir, "get_user_data_dir", lambda: str(tmp_path / "none"))
    monkeypatch.setattr(pyproj.network, "is_network_enabled", lambda: online)
    said = lines()["PROJ grids"]
    assert said.startswith("2 installed" if files else "none")
    assert ("downloaded when needed" in said) == online
    assert ("PROJ_NETWORK=ON, or pyproj sync" in said) == (not files and not online)


def test_disk_is_that_of_the_working_folder_also_when_that_has_gone(lines, monkeypatch, tmp_path: Path):
    folder = tmp_path / "a [b] c"
    folder.mkdir()
    monkeypatch.chdir(folder)
    asked = []
    room = SimpleNamespace(free=3 << 30, total=8 << 30)
    with monkeypatch.context() as patch:
        patch.setattr(doctor.shutil, "disk_usage", lambda path: asked.append(Path(path)) or room)
        assert lines()["disk"] == f"3.0 GiB free of 8.0 GiB ({folder})" and asked[0] == folder
    folder.rmdir()
    assert "cannot be read" in lines()["disk"]


SCREEN = (24, 80)


@pytest.fixture
def said(capsys):
    """What a command line that must succeed prints."""

    def run(*arguments: str) -> str:
        assert main(list(arguments)) == 0
        return capsys.readouterr().out

    return run


def options(text: str) -> set[str]:
    """Every option that a text names."""
    return set(re.findall(r"--[a-z][a-z0-9.-]*[a-z0-9]", text))


def settings(*only: str) -> set[str]:
    """The options of the settings of some stages, or of all."""
    chosen = [(s, f, field.default) for s, named in sections() if not only or s in only for f, field in named.items()]
    tables = {(s, f"{f}.{n}") for s, f, table in chosen if isinstance(table, Section) for n in type(table).model_fields}
    names = {(s, f) for s, f, value in chosen if not isinstance(value, Section)} | tables
    return {f"--{section}.{name.replace('_', '-')}" for section, name in names}


def own() -> set[str]:
    return {f"--{f.name}" for f in fields(RunOptions)}


def test_help_of_run_is_one_screen(said):
    text = said("run", "--help")
    assert text == RUN_PAGE + "\n" == said("run", "-h") == said("run", "nowhere", "--help")
    assert len(text.splitlines()) < SCREEN[0] and max(map(len, text.splitlines())) <= SCREEN[1]
    assert "--help-all" in text and "IMAGES" in text


def test_help_of_run_names_every_input_and_option_and_no_other():
    examples = {"--scan.crs", "--masks.folder"}
    assert options(RUN_PAGE) == own() | examples | {"--help", "--help-all"}
    assert examples <= settings() and not own() & settings()
    for name in set(PRESETS) - {"default"}:
        assert name in RUN_PAGE


@pytest.mark.slow
def test_help_all_of_run_has_every_option(said):
    text = said("run", "--help-all")
    assert own() | settings() <= options(text)
    assert len(text.splitlines()) > 4 * SCREEN[0] and text == said("run", "--help-all", "--help")


@pytest.mark.slow
def test_help_of_a_stage_has_its_own_settings_and_help_all_those_of_all(said):
    text = said("dense", "--help")
    assert settings("dense") <= options(text) and "tiegraph dense --help-all" in text
    assert not (settings() - settings("dense")) & options(text)
    assert {"--pool", "--json", "--quiet"} <= options(text)
    assert settings() <= options(said("dense", "--help-all"))


@pytest.mark.slow
@pytest.mark.parametrize(
    ("verb", "option", "more", "given", "other"),
    [
        ("network", "--coverage", {"--coverage"}, (), "design"),
        ("masks", "--compare", {"--beside", "--classes", "--keep-labels"}, ("x",), "refine"),
    ],
)
def test_help_shows_the_other_form_of_a_verb(said, verb, option, more, given, other):
    for argument in ("--help", "--help-all"):
        assert option in options(said(verb, argument))
    assert more <= options(said(verb, option, *given, "--help"))
    assert option not in options(said(other, "--help"))


@pytest.mark.slow
def test_help_of_evaluate_shows_both_forms(said):
    assert "tiegraph evaluate CLOUD REFERENCE" in said("evaluate", "--help")
    assert "--distances-m" in options(said("evaluate", "a.laz", "b.laz", "--help"))


@pytest.mark.slow
@pytest.mark.parametrize("name", [name for name, verb in VERBS.items() if verb.of != Verb.of])
def test_verbs_of_one_page_take_help_all_too(name, said):
    first = said(name, "--help-all")
    assert first.startswith(f"usage: tiegraph {name} ")


@pytest.mark.slow
def test_help_keeps_square_brackets(said):
    """Libraries that colour text take [words] for orders of theirs."""
    for arguments in (("masks", "--help"), ("run", "--help-all")):
        text = " ".join(said(*arguments).replace("│", " ").replace("|", " ").split())
        assert "'tiegraph[onnx]'" in text and "[width, height]" in text and "[classes]" in text


@pytest.mark.slow
def test_wrong_options_name_the_page_that_lists_all(capsys, tmp_path):
    for verb, page in (("run", "--help-all"), ("dense", "--help-all"), ("compare", "--help")):
        assert main([verb, "--nonsense", "5"]) == 2
        assert f"(`tiegraph {verb} {page}` lists all options)" in capsys.readouterr().err
    assert main(["run", "images", "survey"]) == 2
    assert "one argument too many, or the name of its option is missing: survey" in capsys.readouterr().err
    assert main(["dense", "--scan.crs", "auto", "--help"]) == 0  # of another stage, but help is asked for


NORTH = Origin(lat_deg=35.7, lon_deg=139.7, height_m=37.0, crs="EPSG:32654", shift_m=(382300.0, 3951500.0, 30.0))


def las(path: Path, xyz: np.ndarray, origin: Origin | None = NORTH) -> str:
    write_measured([Measured(xyz, {"height": xyz[:, 2]}, (0.0, 1.0))], path, origin, 0.01)
    return str(path)


@pytest.mark.slow
def test_two_clouds_are_judged_and_written(tmp_path: Path, capsys) -> None:
    cloud = las(tmp_path / "cloud.laz", ground(4000, 0) + [0, 0, 0.1])
    inverse = geodetic_from_world(ground(4000, 1), NORTH)  # the reference counts in the neighbouring zone
    other = Origin(lat_deg=35.7, lon_deg=139.7, height_m=0.0, crs="EPSG:32653", shift_m=(0.0, 0.0, 0.0))
    reference = las(tmp_path / "reference.las", crs_coordinates(world_from_geodetic(inverse, other), other), other)
    out = tmp_path / "judged"
    assert main(["evaluate", cloud, reference, "--distances-m", "0.2", "0.5", "-o", str(out)]) == 0
    said = capsys.readouterr().out
    assert "fscore_0.5m" in said and "brought from EPSG:32653 into EPSG:32654" in said
    result = json.loads((out / "metrics.json").read_text())
    values = {m["name"]: m["value"] for m in result["metrics"]}
    assert values["m3c2_median"] == pytest.approx(0.1, abs=0.01) and values["fscore_0.5m"] > 99
    made = laspy.read(out / "distances.laz")
    assert np.median(made["distance_m"]) == pytest.approx(values["cloud_to_cloud_median"], abs=1e-3)
    assert np.abs(np.median(made.x) - 382300) < 5 and (out / "m3c2.laz").exists() and (out / "m3c2.png").exists()
    assert sorted(p.name for p in tmp_path.iterdir()) == ["cloud.laz", "judged", "reference.las"]  # no scratch left
    assert main(["evaluate", cloud, reference, "-o", str(out)]) == 2
    assert "exists already" in capsys.readouterr().err


@pytest.mark.slow
@pytest.mark.parametrize(("crs", "said"), [("EPSG:32654", True), ("EPSG:32654+6695", False)])
def test_heights_from_another_level_are_said(tmp_path: Path, capsys, crs: str, said: bool) -> None:
    xyz = np.random.default_rng(0).uniform(0, 20, (400, 3)) + [382300.0, 3951500.0, 0.0]
    files = []
    for name, stated in ("own.las", crs), ("reference.las", "EPSG:32654+6695"):  # above the geoid of Japan
        header = laspy.LasHeader(point_format=6, version="1.4")
        header.scales, header.offsets = np.full(3, 0.001), np.round(xyz.mean(axis=0))
        header.add_crs(pyproj.CRS(stated))
        cloud = laspy.LasData(header)
        cloud.xyz = xyz
        cloud.write(tmp_path / name)
        files.append(str(tmp_path / name))
    assert main(["evaluate", *files]) == 0
    assert ("heights refer to another level (EPSG:6695)" in capsys.readouterr().out) == said


@pytest.mark.slow
def test_a_registration_is_part_of_the_result(tmp_path: Path, capsys) -> None:
    bumps = [ground(6000, seed) for seed in (0, 1)]
    for one in bumps:
        one[:, 2] += np.sin(one[:, 0]) + np.cos(one[:, 1])
    files = [las(tmp_path / "a.laz", bumps[0] + [0.2, -0.1, 0.3]), las(tmp_path / "b.laz", bumps[1])]
    assert main(["evaluate", *files, "--register", "rigid", "-o", str(tmp_path / "out")]) == 0
    assert "registration of the cloud on the reference" in capsys.readouterr().out
    result = json.loads((tmp_path / "out" / "metrics.json").read_text())
    rows = {r[0]: r[1:] for r in result["tables"]["registration of the cloud on the reference"]["rows"]}
    assert rows["shift in z at the middle, m"][0] == pytest.approx(-0.3, abs=0.02)
    assert {m["name"]: m["value"] for m in result["metrics"]}["m3c2_median"] == pytest.approx(0, abs=0.01)


@pytest.mark.slow
def test_what_does_not_meet_is_refused_with_a_remedy(tmp_path: Path, capsys) -> None:
    cloud, reference = las(tmp_path / "a.laz", ground(300, 0)), las(tmp_path / "b.laz", ground(300, 1), None)
    assert main(["evaluate", cloud, reference, "-o", str(tmp_path / "out")]) == 2
    said = capsys.readouterr().err
    assert "b.laz: the cloud (x, y, z from (3822" in said and "do not meet: are both in one CRS" in said
    assert main(["evaluate", cloud, las(tmp_path / "one.laz", np.zeros((1, 3)))]) == 2
    assert "one.laz (EPSG:32654 by its header): half of the points" in capsys.readouterr().err
    assert not (tmp_path / "out").exists()
    assert main(["evaluate", cloud, cloud, "--distances-m", "-1"]) == 2
    assert "--distances-m -1: give metres above 0" in capsys.readouterr().err
    assert main(["evaluate", cloud, las(tmp_path / "c.laz", ground(300, 1) + 500), "--register", "rigid"]) == 2
    assert "c.laz (EPSG:32654 by its header): only 0 of" in capsys.readouterr().err


@pytest.mark.slow
def test_constants_of_a_file_reach_the_comparison(tmp_path: Path, capsys) -> None:
    files = [las(tmp_path / "a.laz", ground(2000, 0)), las(tmp_path / "b.laz", ground(2000, 1))]
    (tmp_path / "own.toml").write_text("[tuning.evaluate.m3c2]\nleast_points = 2000\n")
    for name, more, known in (("a", (), True), ("b", ("--tuning", str(tmp_path / "own.toml")), False)):
        assert main(["evaluate", *files, "-o", str(tmp_path / name), *more]) == 0
        metrics = json.loads((tmp_path / name / "metrics.json").read_text())["metrics"]
        assert (next(m["value"] for m in metrics if m["name"] == "m3c2_median") is not None) == known
    assert main(["evaluate", *files, "--tuning", str(tmp_path / "none.toml")]) == 2
    assert "none.toml: not there" in capsys.readouterr().err


def test_a_reference_that_is_cut_short_or_no_cloud_is_named_once(tmp_path: Path, capsys) -> None:
    cloud = las(tmp_path / "a.las", ground(300, 0))
    whole = (tmp_path / "a.las").read_bytes()
    (tmp_path / "cut.las").write_bytes(whole[: len(whole) // 2])
    header = "ply\nformat ascii 1.0\nelement vertex 1\n" + "".join(f"property float {a}\n" for a in "xyz")
    (tmp_path / "hole.ply").write_text(f"{header}end_header\nnan 0 0\n")
    for name, why in (("cut.las", "is cut off"), ("hole.ply", "1 points have no coordinates"), ("a.xyz", "convert it")):
        assert main(["evaluate", cloud, str(tmp_path / name)]) == 2
        said = capsys.readouterr().err
        assert why in said and said.count(name) == 1
    assert main(["evaluate", cloud]) == 2
    assert "The cloud that counts as true" in capsys.readouterr().err


@pytest.mark.slow
def test_a_setting_out_of_range_is_said_without_the_words_of_pydantic(tmp_path: Path, capsys) -> None:
    assert main(["run", str(tmp_path), "--evaluate.reference-origin", "95", "0", "0"]) == 2
    said = capsys.readouterr().err
    assert "evaluate.reference_origin.0 Input should be less than or equal to 90 (given: 95.0)" in said
    assert "pydantic" not in said and "type=" not in said
