"""COLMAP goes to a GPU only where there is one, and is never left to decide."""

import ctypes
import subprocess
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pycolmap
import pytest

from tiegraph.features import matchblocks
from tiegraph.features import matchers as gpu
from tiegraph.features.settings import MatchSettings
from tiegraph.scene.colmapmodel import repeatable
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import simple_scene
from tiegraph.sfm import run
from tiegraph.sfm.tuning import Tuning
from tiegraph.sfm.verified import MatchSource


@pytest.fixture
def asked(monkeypatch):
    """What the driver is said to answer: 0 where it has a GPU."""
    answer = SimpleNamespace(returncode=0)
    monkeypatch.setattr(pycolmap, "has_cuda", True)
    monkeypatch.setattr(subprocess, "run", lambda *a, **k: answer)
    gpu.on_gpu.cache_clear()
    yield answer
    gpu.on_gpu.cache_clear()


def test_a_gpu_that_answers_is_used(asked):
    assert gpu.on_gpu() and gpu.device() == pycolmap.Device.cuda


@pytest.mark.parametrize("code", [1, -11])
def test_a_build_with_cuda_on_a_machine_without_a_gpu_works_on_the_cpu(asked, code):
    asked.returncode = code
    assert not gpu.on_gpu() and gpu.device() == pycolmap.Device.cpu


@pytest.mark.parametrize(("status", "count", "there"), [(0, 2, True), (0, 0, False), (100, 2, False)])
def test_the_driver_is_asked_for_its_gpus(monkeypatch, status, count, there):
    class Driver:
        def __init__(self, name):
            self.name = name

        def cuInit(self, flags):
            return status

        def cuDeviceGetCount(self, number):
            number._obj.value = count
            return status

    monkeypatch.setattr(ctypes, "CDLL", Driver)
    with pytest.raises(SystemExit) as ended:
        exec(gpu._PROBE, {})
    assert (not ended.value.code) is there


def test_a_driver_that_hangs_is_not_used(asked, monkeypatch):
    def hangs(*arguments, **more):
        raise subprocess.TimeoutExpired("python", more["timeout"])

    monkeypatch.setattr(subprocess, "run", hangs)
    assert not gpu.on_gpu()


def test_a_build_without_cuda_does_not_ask(asked, monkeypatch):
    monkeypatch.setattr(pycolmap, "has_cuda", False)
    monkeypatch.setattr(subprocess, "run", None)
    assert not gpu.on_gpu()


@pytest.mark.parametrize("there", [True, False])
def test_matching_is_told_where(monkeypatch, tmp_path: Path, there):
    told = []
    monkeypatch.setattr(matchblocks, "on_gpu", lambda: there)
    monkeypatch.setattr(matchblocks, "device", lambda: pycolmap.Device.cuda if there else pycolmap.Device.cpu)
    monkeypatch.setattr(matchblocks, "copy_features", lambda *a: None)
    monkeypatch.setattr(pycolmap, "match_image_pairs", lambda name, **options: told.append(options))
    blocks = [(str(tmp_path / "0.db"), np.array([[0, 1]]))]
    matchblocks.match_blocks(
        "database.db", blocks, matchblocks.Rules(MatchSettings(guided=not there)), lambda message: None
    )
    assert told[0]["device"] == (pycolmap.Device.cuda if there else pycolmap.Device.cpu)
    assert told[0]["matching_options"].use_gpu is there


def test_adjustments_stay_on_the_cpu_where_their_bits_are_the_same_everywhere():
    options = pycolmap.BundleAdjustmentOptions()
    ceres = options.ceres
    ceres.use_gpu = True
    options.ceres = ceres
    repeatable(options)
    assert not options.ceres.use_gpu


def test_a_mapper_is_told_to_adjust_and_place_on_the_cpu(monkeypatch, tmp_path):
    told = []
    monkeypatch.setattr(pycolmap, "global_mapping", lambda database, images, out, options: told.append(options) or {})
    monkeypatch.setattr(run, "sizes", lambda database: (2, 2))
    matches = MatchSource(tmp_path / "a.db", least=15)
    rig = Rig("one", (Sensor("cam0"),))
    scene, tuning = simple_scene(rig, ["a.jpg"], np.zeros(1, int), np.zeros(1, int)), Tuning()
    request = run.Request(run.Method("global"), matches, run.RigsUsed(), None, tmp_path, scene, tuning)
    run._global(request, tmp_path / "a.db", tmp_path)
    assert not told[0].mapper.global_positioning.use_gpu and not told[0].mapper.bundle_adjustment.ceres.use_gpu
    assert not run._options(request, True).ba_use_gpu
