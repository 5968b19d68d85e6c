"""COLMAP goes to a GPU only where there is one, and is never left to decide."""

import subprocess
from pathlib import Path
from types import SimpleNamespace

import numpy as np
import pycolmap
import pytest

from tiegraph import gpu
from tiegraph.features import matchblocks
from tiegraph.features.settings import MatchSettings


@pytest.fixture
def asked(monkeypatch):
    """What the driver is said to answer: an exit code and a count."""
    answer = SimpleNamespace(returncode=0, stdout="1\n")
    monkeypatch.setattr(pycolmap, "has_cuda", True)
    monkeypatch.setattr(subprocess, "run", lambda *a, **k: answer)
    gpu.on_gpu.cache_clear()
    yield answer
    gpu.on_gpu.cache_clear()


def test_a_gpu_that_answers_is_used(asked):
    assert gpu.on_gpu() and gpu.device() == pycolmap.Device.cuda


@pytest.mark.parametrize(("code", "said"), [(0, "0\n"), (1, "")])
def test_a_build_with_cuda_on_a_machine_without_a_gpu_works_on_the_cpu(asked, code, said):
    asked.returncode, asked.stdout = code, said
    assert not gpu.on_gpu() and gpu.device() == pycolmap.Device.cpu


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
    matchblocks.match_blocks("database.db", blocks, MatchSettings(), lambda message: None)
    assert told[0]["device"] == (pycolmap.Device.cuda if there else pycolmap.Device.cpu)
    assert told[0]["matching_options"].use_gpu is there
