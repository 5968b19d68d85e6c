"""Learned features: bytes that match as the network's numbers do, places, masks, files that cannot be used, a run.

The network is a tiny one that is made here (``tinyonnx.corners``).
"""

import json
import sys

import cv2
import numpy as np
import pycolmap
import pytest

import tiegraph
from tiegraph.errors import EngineMissing, InputError
from tiegraph.features import matchers
from tiegraph.features.settings import FeaturesSettings
from tiegraph.features.sift import as_bytes, detected, extract_onnx, network
from tiegraph.features.tuning import SiftTuning
from tiegraph.scene.colmapdatabase import Rows
from tiegraph.scene.onnxfile import session
from tinyonnx import corners, model, node
from worlds import make_survey

pytestmark = pytest.mark.slow


@pytest.fixture
def tiny(tmp_path):
    pytest.importorskip("onnxruntime")
    (tmp_path / "tiny.onnx").write_bytes(corners())
    return tmp_path / "tiny.onnx"


def texture(height, width, seed=1):
    noise = np.random.default_rng(seed).random((height, width)).astype(np.float32)
    return cv2.normalize(cv2.GaussianBlur(noise, (0, 0), 2.5), None, 0, 255, cv2.NORM_MINMAX).astype(np.uint8)


def units(count, length, seed):
    found = np.random.default_rng(seed).normal(size=(count, length))
    return found / np.linalg.norm(found, axis=1, keepdims=True)


@pytest.mark.parametrize("length", [64, 128])
def test_bytes_match_as_the_numbers_of_the_network_do(length):
    one = units(300, length, 0)
    other = one[:200] + 0.06 * np.random.default_rng(1).normal(size=(200, length))
    other = np.concatenate([other / np.linalg.norm(other, axis=1, keepdims=True), units(100, length, 2)])
    a, b = as_bytes(one), as_bytes(other)
    assert a.dtype == np.uint8 and a.shape == (300, 128)
    assert np.abs(np.linalg.norm(a.astype(float), axis=1) - 512).max() < 4
    true = np.linalg.norm(one[:, None] - other, axis=2)
    ratio = np.linalg.norm(a[:, None].astype(float) - b, axis=2) / true
    assert ratio.std() < 0.02 * ratio.mean()  # one number, nearly
    best, second = np.sort(true, axis=1)[:, :2].T
    mutual = true.argmin(axis=0)[true.argmin(axis=1)] == np.arange(300)
    of_other = np.sort(true, axis=0)[:2]
    clear = mutual & (best < 0.8 * second) & (of_other[0] < 0.8 * of_other[1])[true.argmin(axis=1)]
    want = {(int(k), int(true[k].argmin())) for k in np.flatnonzero(clear)}
    got = {(int(i), int(j)) for i, j in matchers.matches(a, b, pycolmap.SiftMatchingOptions())}
    assert len(want) > 100 and len(want ^ got) < 0.03 * len(want)


def test_places_are_of_the_image_in_the_corner_convention(tiny):
    whole = texture(230, 300)
    one, first = detected(whole[:201, :247], tiny, 4000, 0.2)
    other, second = detected(whole[20:221, 37:284], tiny, 4000, 0.2)
    i, j = matchers.matches(first, second, pycolmap.SiftMatchingOptions()).T
    assert len(i) > 60
    right = np.abs(one[i] - other[j] - [37, 20]).max(axis=1) < 0.01
    assert right.mean() > 0.95
    x, y = np.floor(one).astype(int).T  # of bright pixels, in the middle of each, in order of their brightness
    assert (np.diff(whole[y, x].astype(int)) <= 0).all() and (x < 247).all() and (y < 201).all()
    assert np.abs(one % 1 - 0.5).max() < 0.001


def test_masks_limits_and_the_size_that_the_network_sees(tiny):
    image, mask = texture(240, 320), np.ones((240, 320), bool)
    mask[:, 160:] = False
    settings = FeaturesSettings(engine="onnx", model=tiny, max_features=64)
    keypoints, descriptors = extract_onnx(image, mask, settings, SiftTuning(enough_free=0))
    assert 5 < len(keypoints) == len(descriptors) <= 64 and keypoints[:, 0].max() < 157
    assert len(extract_onnx(image, None, settings, SiftTuning())[0]) == 21  # a third: it is small
    small, _ = extract_onnx(image, None, settings, SiftTuning(network_px=160))
    assert (small[:, 2] == 2).all() and small[:, 0].max() > 160
    blank, none = extract_onnx(np.zeros((50, 60), np.uint8), None, settings, SiftTuning())
    assert blank.shape == (0, 4) and none.shape == (0, 128)


def test_files_that_cannot_be_used_are_refused(tmp_path, tiny, monkeypatch):
    other = tmp_path / "other.onnx"
    other.write_bytes(
        model([node("Identity", "image", "y")], {"image": ("f4", (1, 3, 8, 8))}, {"y": ("f4", (1, 3, 8, 8))})
    )
    with pytest.raises(InputError, match="other.onnx: its inputs are image, but .* max_keypoints"):
        network(other)
    other.write_bytes(b"nonsense")
    with pytest.raises(InputError, match="other.onnx: not a model ONNX Runtime can load"):
        network(other)
    with pytest.raises(ValueError, match="129 numbers"):
        as_bytes(units(3, 129, 0))
    with pytest.raises(ValueError, match="engine = onnx needs the setting model"):
        FeaturesSettings(engine="onnx")
    with pytest.raises(ValueError, match="engine = opencv does not read it"):
        FeaturesSettings(model=tiny)
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    session.cache_clear()
    with pytest.raises(
        EngineMissing,
        match=r"features.engine = onnx needs onnxruntime, which is not installed: pip install 'tiegraph\[onnx\]'",
    ):
        network(tiny)


def test_a_run_with_a_network(tmp_path, tiny):
    survey = make_survey(tmp_path / "images", passes=("up",), frames=3)
    broken = tmp_path / "broken.onnx"
    settings = {"masks": {"source": "none"}, "features": {"engine": "onnx", "model": broken}}
    with pytest.raises(InputError, match="features.model .*broken.onnx: no such file"):
        tiegraph.open(survey.images, tmp_path / "out", settings=settings, pool="serial").run(until="match")
    broken.write_bytes(b"nonsense")
    with pytest.raises(InputError, match="not a model ONNX Runtime can load"):  # before the work
        tiegraph.open(survey.images, tmp_path / "out", settings=settings, pool="serial").run(until="preview")
    settings["features"]["model"] = tiny
    project = tiegraph.open(survey.images, tmp_path / "out", settings=settings, pool="serial")
    project.run(until="features")
    with Rows(project.folder / "database.db") as rows:
        one, other = (rows.descriptors_of(k) for k in (1, 2))  # of one camera, one after the other
    assert len(matchers.matches(one, other, pycolmap.SiftMatchingOptions())) > 15
    receipt = project.folder / "receipts" / "features.json"
    before = receipt.read_bytes()
    project.run(until="features")
    assert receipt.read_bytes() == before  # nothing to do
    tiny.write_bytes(corners(seed=1))
    project.run(until="features")
    assert json.loads(receipt.read_text())["key"] != json.loads(before)["key"]  # another network of that name
