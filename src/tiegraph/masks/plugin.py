"""Masks by a user's segmentation model: an ONNX file and a table of its classes, run by ONNX Runtime."""

import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tiegraph.errors import EngineMissing, InputError
from tiegraph.masks import NAMES, USE
from tiegraph.scene.atomic import cached_by_file, regular

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


@dataclass(frozen=True)
class Model:
    """A segmentation model: input (1, 3, h, w) f4 RGB = (pixel / 255 - mean) / deviation, output (1, classes, h', w')
    scores or (1, h', w') labels; ``table`` (n,) u1: the class of ``masks`` for each of its labels."""

    onnx: Path
    size: tuple[int, int]  # (width, height) of the input
    mean: tuple[float, float, float]
    deviation: tuple[float, float, float]
    table: np.ndarray


def read_model(path: Path) -> Model:
    """A model from its TOML file.

    ``onnx`` = file beside it; ``size`` = [width, height]; ``mean`` and ``deviation`` of RGB in 0..1 (default 0 and 1);
    ``[classes]`` sky = [10], water = [21, 60], ...: labels of the model for our classes, all others are used. Raises
    InputError naming the fault.
    """
    try:
        data = tomllib.loads(regular(path).read_text())
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror or error})") from None
    except (tomllib.TOMLDecodeError, UnicodeDecodeError) as error:
        raise InputError(
            f"{path}: not valid TOML: {error}; masks.model is a TOML file that names the ONNX file"
        ) from None
    try:
        width, height = (int(v) for v in data["size"])
        mean = tuple(float(v) for v in data.get("mean", (0, 0, 0)))
        deviation = tuple(float(v) for v in data.get("deviation", (1, 1, 1)))
        onnx = Path(path).parent / data["onnx"]
        classes = {str(n): [int(v) for v in labels] for n, labels in data["classes"].items()}
    except (KeyError, TypeError, ValueError, AttributeError) as error:
        raise InputError(f"{path}: needs onnx, size = [width, height] and a table [classes]: {error!r}") from None
    unknown = [n for n in classes if n not in NAMES[1:]]
    if unknown or not classes or min(width, height) < 1 or len(mean) != 3 or len(deviation) != 3 or 0 in deviation:
        wrong = f"there is no class {unknown[0]!r}" if unknown else "size, mean, deviation or [classes] make no sense"
        raise InputError(f"{path}: {wrong}; the classes are {', '.join(NAMES[1:])}")
    if not onnx.is_file():
        raise InputError(f"{path}: there is no model {onnx}")
    table = np.zeros(1 + max((v for labels in classes.values() for v in labels), default=0), np.uint8)
    for name, labels in classes.items():
        table[labels] = NAMES.index(name)
    return Model(onnx=onnx, size=(width, height), mean=mean, deviation=deviation, table=table)  # type: ignore[arg-type]


def model_classes(image: np.ndarray, model: Model) -> np.ndarray:
    """Classes (h, w) u1 of an image (h, w, 3) u1 BGR. Raises InputError for unsuitable input or output of the model,
    EngineMissing without ONNX Runtime."""
    session = _session(model.onnx)
    small = cv2.resize(image, model.size, interpolation=cv2.INTER_AREA)[..., ::-1].astype(np.float32) / 255
    small = (small - np.array(model.mean, np.float32)) / np.array(model.deviation, np.float32)
    try:
        out = session.run(None, {session.get_inputs()[0].name: np.ascontiguousarray(small.transpose(2, 0, 1)[None])})[0]
    except Exception as error:  # ONNX Runtime raises classes of its own that share no base
        raise InputError(
            f"{model.onnx}: the model does not take a (1, 3, {model.size[1]}, {model.size[0]}) image: {error}"
        ) from None
    labels = np.asarray(out)[0]
    labels = labels.argmax(axis=0) if labels.ndim == 3 else labels
    if labels.ndim != 2:
        raise InputError(f"{model.onnx}: output {np.shape(out)}, not (1, classes, h, w) scores or (1, h, w) labels")
    labels = labels.astype(np.int64)
    known = (labels >= 0) & (labels < len(model.table))
    classes = np.where(known, model.table[np.where(known, labels, 0)], USE).astype(np.uint8)
    return cv2.resize(classes, image.shape[1::-1], interpolation=cv2.INTER_NEAREST)


@cached_by_file(maxsize=2)
def _session(onnx: Path) -> Any:
    try:
        import onnxruntime
    except ImportError:
        raise EngineMissing("masks.source = model needs ONNX Runtime: pip install 'tiegraph[onnx]'") from None
    options = onnxruntime.SessionOptions()
    options.intra_op_num_threads = 1  # images run side by side already
    try:
        return onnxruntime.InferenceSession(str(onnx), options, providers=["CPUExecutionProvider"])
    except Exception as error:
        raise InputError(f"{onnx}: not a model ONNX Runtime can load: {error}") from None
