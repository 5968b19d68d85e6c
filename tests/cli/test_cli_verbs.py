"""The door: what the command line loads, the table of verbs, verbs that do more than their stage, and `doctor`."""

import json
import shutil
import signal
import subprocess
import sys
from collections import namedtuple
from importlib.metadata import version
from pathlib import Path
from types import SimpleNamespace

import cv2
import numpy as np
import pyproj
import pytest

import tiegraph
from boat_world import photos
from tiegraph.cli import doctor, forms
from tiegraph.cli.main import main
from tiegraph.cli.verbs import VERBS, wants_page
from tiegraph.errors import EngineMissing
from tiegraph.pipeline import MESH, SHOTS, STAGES
from tiegraph.pipeline import plan as forecast
from tiegraph.scene.pairs import Pairs, PreviewMatches

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


def test_the_package_can_be_run():
    done = python("-m", "tiegraph", "--version")
    assert (done.returncode, done.stdout, done.stderr) == (0, f"tiegraph {tiegraph.__version__}\n", "")
    wrong = python("-m", "tiegraph", "rum")
    assert wrong.returncode == 2 and "Perhaps you meant 'run'" in wrong.stderr


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


def test_coverage_judges_the_chosen_pairs_too(judged):
    code, said = judged(RING, RING)
    assert code == 0 and said.count("no place depends on a single link") == 2
    code, said = judged(RING, CHAIN)
    assert code == 1 and "candidate pairs: 4 pairs connect 4 images" in said
    assert "pairs that the design chose: 3 single links" in said
    assert "weak links of the pairs that the design chose" in said and "weak links of the candidate" not in said


def test_coverage_as_json(judged):
    code, said = judged(RING, CHAIN, "--json")
    told = json.loads(said)
    assert code == 1 and told["sound"] is False and told["bridges"] == 0 and told["pairs"] == 4
    assert told["chosen"]["sound"] is False and told["chosen"]["bridges"] == 3
    assert len(told["chosen"]["weak_links"]["rows"]) == 5 and told["weak_links"]["rows"] == []


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
