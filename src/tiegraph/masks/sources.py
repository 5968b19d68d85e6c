"""Mask sources by name: each prepares once a camera, then makes the mask of one image after another.

The papers' own are added by the glue (``tiegraph.papers``). A segmentation model of the user's is an ONNX file and a
table of its classes, run by ONNX Runtime.
"""

import sys
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tiegraph.errors import InputError
from tiegraph.masks import NAMES, USE
from tiegraph.masks.classification import Classifier, classes_of
from tiegraph.masks.folder import check_folder, read_folder_mask
from tiegraph.masks.frames import full_size, image_size, read_small, small_shape
from tiegraph.masks.learnt import Map, learn
from tiegraph.masks.platform import learn_marks
from tiegraph.masks.settings import MasksSettings
from tiegraph.masks.tuning import Tuning
from tiegraph.scene.atomic import regular
from tiegraph.scene.onnxfile import session
from tiegraph.scene.scene import Scene

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib


@dataclass(frozen=True)
class Camera:
    """The images of one sensor, paths in order; ``upward``: it looks up; ``lens``: whose views they are, if any's."""

    images: tuple[Path, ...]
    upward: bool = False
    lens: str = ""


Look = Callable[[Path, Any, MasksSettings, Tuning, str], np.ndarray]


@dataclass(frozen=True)
class MaskSource:
    """One way to make masks.

    ``prepare(cameras, settings, tuning, apply)`` is called once for all sensors and returns the common data of masks
    of each, which may have a ``note``; ``apply`` maps a function over items. ``look(image, prepared,
    settings, tuning, name)`` returns for an image, by the data prepared for its sensor, either (h, w) bool, True = use,
    or the class (h, w) u1 of each pixel (``masks``), both at any size; ``name`` is that of the user's file.
    """

    prepare: Callable[[Mapping[int, Camera], MasksSettings, Tuning, Map], dict[int, Any]]
    look: Look

    def mask(self, image: Path, prepared: Any, settings: MasksSettings, tuning: Tuning, name: str) -> np.ndarray:
        """(H, W) bool, True = use, at the size of the image."""
        found = self.look(image, prepared, settings, tuning, name)
        return full_size(found if found.dtype == bool else found == USE, image_size(image))


def each(prepare: Callable[[Sequence[Path], MasksSettings, Tuning], Any]) -> Callable[..., dict[int, Any]]:
    """``MaskSource.prepare`` by a function of the images of one camera."""

    def prepare_all(
        cameras: Mapping[int, Camera], settings: MasksSettings, tuning: Tuning, apply: Map = map
    ) -> dict[int, Any]:
        return {key: prepare(camera.images, settings, tuning) for key, camera in cameras.items()}

    return prepare_all


def nothing(images: Sequence[Path], settings: MasksSettings, tuning: Tuning) -> None:
    """The common data of images whose masks share nothing."""


def explain_source(scene: Scene, settings: MasksSettings, tuning: Tuning) -> tuple[str, str]:
    """(name of the source, why) for a scene.

    ``auto`` masks the cameras of a rig on a path, learnt from them. In loose photographs and single cameras only what
    stands still is masked: they share no platform, and a single camera cannot distinguish water from a road.
    Raises InputError if a folder of masks lacks one of the images.
    """
    automatic = settings.source == "auto"
    name, why = _automatic(scene, settings, tuning) if automatic else (settings.source, "by the setting")
    if name == "folder" and settings.folder is not None:
        check_folder(settings.folder, [scene.mask_name(k) for k in range(len(scene))])
    return name, why


def _automatic(scene: Scene, settings: MasksSettings, tuning: Tuning) -> tuple[str, str]:
    if settings.folder is not None:
        return "folder", "a folder of masks is given"
    still = "only what stands still in all images of a camera is masked"
    if (scene.sequence < 0).any():
        return "marks", f"loose photographs share no platform; {still}"
    if all(len(r.sensors) < 2 for r in scene.rigs):
        return "marks", f"a single camera: name another source if its platform is in view; {still}"
    fewest = int(np.bincount(scene.sensor_key, minlength=len(scene.all_sensors)).min())
    if fewest < tuning.platform.min_frames:
        return "marks", f"a camera has only {fewest} frames, fewer than {tuning.platform.min_frames}; {still}"
    return "learnt", "a rig that moves along a path"


def check_shape(image: Path, size: tuple[int, int], prepared: np.ndarray | None, tuning: Tuning) -> None:
    """Raises InputError for an image whose shape is not that of the mask of its camera, if there is one."""
    if prepared is not None and prepared.shape != small_shape(size, tuning.work_px):
        raise InputError(
            f"{image}: {size[1]} x {size[0]} pixels, not the shape of the other images of its camera, which share "
            "a mask; put images of another camera into another folder, or set masks.source = sky or none"
        )


def _folder(image: Path, prepared: None, settings: MasksSettings, tuning: Tuning, name: str) -> np.ndarray:
    assert settings.folder is not None  # by the settings
    return read_folder_mask(settings.folder, name, image_size(image), settings.keep_labels)


def _prepare_learnt(
    cameras: Mapping[int, Camera], settings: MasksSettings, tuning: Tuning, apply: Map = map
) -> dict[int, Classifier]:
    upward = [key for key, camera in cameras.items() if camera.upward]
    lenses = {camera.lens or key for key, camera in cameras.items() if not camera.upward}
    if settings.water == "auto" and len(lenses) < tuning.witnesses:  # views of one lens are one witness
        settings = settings.model_copy(update={"water": "off"})
    return learn({key: camera.images for key, camera in cameras.items()}, settings, tuning, upward, apply)


def _learnt(image: Path, prepared: Classifier, settings: MasksSettings, tuning: Tuning, name: str) -> np.ndarray:
    size = image_size(image)
    check_shape(image, size, prepared.platform, tuning)
    return classes_of(image, prepared, settings, small_shape(size, tuning.work_px), tuning)


@dataclass(frozen=True, eq=False)
class Marks:
    """What stands still in the images of a camera, (h, w) bool, None if nothing does."""

    marks: np.ndarray | None

    @property
    def note(self) -> str:
        """For people; "" if there is none."""
        share = 0.0 if self.marks is None else 100 * self.marks.mean()
        return f"{share:.1f} % of the image stands still in all (text, scale, dirt): masked" if share else ""


def _find_marks(images: Sequence[Path], settings: MasksSettings, tuning: Tuning) -> Marks:
    return Marks(learn_marks(images, tuning))


def _without_marks(image: Path, prepared: Marks, settings: MasksSettings, tuning: Tuning, name: str) -> np.ndarray:
    size = image_size(image)
    if prepared.marks is None or prepared.marks.shape != small_shape(size, tuning.work_px):
        return np.ones(size, bool)
    return ~prepared.marks


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
    network = session(model.onnx, "masks.source = model")
    small = cv2.resize(image, model.size, interpolation=cv2.INTER_AREA)[..., ::-1].astype(np.float32) / 255
    small = (small - np.array(model.mean, np.float32)) / np.array(model.deviation, np.float32)
    try:
        out = network.run(None, {network.get_inputs()[0].name: np.ascontiguousarray(small.transpose(2, 0, 1)[None])})[0]
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


def _read_model(images: Sequence[Path], settings: MasksSettings, tuning: Tuning) -> Model:
    assert settings.model is not None  # by the settings
    return read_model(settings.model)


def _by_model(image: Path, prepared: Model, settings: MasksSettings, tuning: Tuning, name: str) -> np.ndarray:
    return model_classes(read_small(image, tuning.work_px), prepared)


SOURCES: dict[str, MaskSource] = {
    "learnt": MaskSource(_prepare_learnt, _learnt),
    "model": MaskSource(each(_read_model), _by_model),
    "folder": MaskSource(each(nothing), _folder),
    "marks": MaskSource(each(_find_marks), _without_marks),
    "none": MaskSource(each(nothing), lambda image, *_: np.ones(image_size(image), bool)),
}
