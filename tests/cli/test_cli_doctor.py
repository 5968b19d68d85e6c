"""`tiegraph doctor`: what it names, and that its hints are printed letter by letter."""

from importlib.metadata import version
from pathlib import Path
from types import SimpleNamespace

import pyproj
import pytest

from tiegraph.cli import doctor
from tiegraph.cli.main import main


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
        "not installed (pip install 'tiegraph[onnx]' for --masks.source model)",
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
