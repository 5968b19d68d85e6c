import sys

import numpy as np
import pytest

from masks_world import write
from tiegraph.errors import EngineMissing, InputError
from tiegraph.masks import EGO, SKY, USE, plugin
from tiegraph.masks.settings import MasksSettings
from tiegraph.masks.sources import SOURCES, Camera
from tiegraph.masks.tuning import Tuning

TOML = 'onnx = "tiny.onnx"\nsize = [32, 24]\n[classes]\nsky = [2]\nplatform = [0]\n'


def _field(number, value):
    """One field of a protocol buffer: bytes, text or a number."""

    def varint(n):
        out = bytearray()
        while n > 127:
            out.append(n & 127 | 128)
            n >>= 7
        return bytes([*out, n])

    if isinstance(value, int):
        return varint(number << 3) + varint(value)
    data = value.encode() if isinstance(value, str) else value
    return varint(number << 3 | 2) + varint(len(data)) + data


def tiny_model():
    """ONNX bytes of Identity: the three colours of the image are the scores of three classes."""

    def value(name):
        dims = b"".join(_field(1, _field(1, n)) for n in (1, 3, 24, 32))
        return _field(1, name) + _field(2, _field(1, _field(1, 1) + _field(2, dims)))

    node = _field(1, "image") + _field(2, "scores") + _field(4, "Identity")
    graph = _field(1, node) + _field(2, "tiny") + _field(11, value("image")) + _field(12, value("scores"))
    return _field(1, 8) + _field(7, graph) + _field(8, _field(1, "") + _field(2, 13))


@pytest.fixture
def model(tmp_path):
    (tmp_path / "tiny.onnx").write_bytes(tiny_model())
    (tmp_path / "model.toml").write_text(TOML)
    return tmp_path / "model.toml"


def test_a_model_of_the_users_makes_masks(model, tmp_path):
    pytest.importorskip("onnxruntime")
    image = np.zeros((240, 320, 3), np.uint8)
    image[:80], image[80:160], image[160:] = (255, 0, 0), (0, 255, 0), (0, 0, 255)  # blue, green, red
    path = write(tmp_path / "a.png", image)
    settings = MasksSettings(source="model", model=model)
    source = SOURCES["model"]
    prepared = source.prepare({0: Camera((path,))}, settings, Tuning(), map)[0]
    classes = source.look(path, prepared, settings, Tuning(), "a.png")
    assert (classes[:75] == SKY).all() and (classes[85:155] == USE).all() and (classes[165:] == EGO).all()
    mask = source.mask(path, prepared, settings, Tuning(), "a.png")
    assert mask.shape == (240, 320) and not mask[:75].any() and mask[85:155].all()
    (tmp_path / "tiny.onnx").write_bytes(b"nonsense")
    plugin._session.cache_clear()
    with pytest.raises(InputError, match="not a model ONNX Runtime can load"):
        source.mask(path, prepared, settings, Tuning(), "a.png")


def test_without_onnx_runtime_it_says_what_to_install(model, monkeypatch):
    monkeypatch.setitem(sys.modules, "onnxruntime", None)
    plugin._session.cache_clear()
    with pytest.raises(EngineMissing, match=r"tiegraph\[onnx\]"):
        plugin.model_classes(np.zeros((24, 32, 3), np.uint8), plugin.read_model(model))


@pytest.mark.parametrize(
    "text, said",
    [
        ("onnx = 3 =", "not valid TOML"),
        ("size = [32, 24]\n[classes]\nsky = [1]\n", "needs onnx"),
        (TOML.replace("tiny", "absent"), "no model .*absent"),
        (TOML.replace("sky", "heaven"), "no class 'heaven'"),
        (TOML.replace("[32, 24]", "[0, 24]"), "make no sense"),
    ],
)
def test_wrong_tables_are_refused_by_name(model, text, said):
    model.write_text(text)
    with pytest.raises(InputError, match=said):
        plugin.read_model(model)
    with pytest.raises(InputError, match="cannot be read"):
        plugin.read_model(model.with_name("nowhere.toml"))
