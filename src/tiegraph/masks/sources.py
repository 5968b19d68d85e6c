"""Mask sources by name: each prepares once a camera, then makes the mask of one image after another.

The papers' own are added by the glue (``tiegraph.papers``).
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tiegraph.errors import InputError
from tiegraph.masks import USE
from tiegraph.masks.classification import Classifier, classes_of
from tiegraph.masks.folder import check_folder, read_folder_mask
from tiegraph.masks.frames import full_size, image_size, read_small, small_shape
from tiegraph.masks.learnt import Map, learn
from tiegraph.masks.plugin import Model, model_classes, read_model
from tiegraph.masks.settings import MasksSettings
from tiegraph.masks.tuning import Tuning
from tiegraph.scene.scene import Scene


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

    ``auto`` masks the cameras of a rig on a path, learnt from them. Loose photographs and single cameras are
    not masked: they share no platform, and a single camera cannot distinguish water from a road.
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
    if (scene.sequence < 0).any():
        return "none", "loose photographs share no platform that could be masked"
    if all(len(r.sensors) < 2 for r in scene.rigs):
        return "none", "a single camera: name a mask source if its platform is in view"
    fewest = int(np.bincount(scene.sensor_key, minlength=len(scene.all_sensors)).min())
    if fewest < tuning.auto_frames:
        return "none", f"a camera has only {fewest} frames, fewer than {tuning.auto_frames}"
    return "learnt", "a rig that moves along a path"


def check_shape(image: Path, size: tuple[int, int], prepared: np.ndarray | None, tuning: Tuning) -> None:
    """Raises InputError for an image whose shape is not that of the mask of its camera, if there is one."""
    if prepared is not None and prepared.shape != small_shape(size, tuning.frames.work_px):
        raise InputError(
            f"{image}: {size[1]} x {size[0]} pixels, not the shape of the other images of its camera, which share "
            "a mask; put images of another camera into another folder, or set masks.source = sky or none"
        )


def _folder(image: Path, prepared: None, settings: MasksSettings, tuning: Tuning, name: str) -> np.ndarray:
    if settings.folder is None:
        raise InputError("masks.source = folder needs masks.folder: where the masks are")
    return read_folder_mask(settings.folder, name, image_size(image), settings.keep_labels)


def _prepare_learnt(
    cameras: Mapping[int, Camera], settings: MasksSettings, tuning: Tuning, apply: Map = map
) -> dict[int, Classifier]:
    upward = [key for key, camera in cameras.items() if camera.upward]
    lenses = {camera.lens or key for key, camera in cameras.items() if not camera.upward}
    if settings.water == "auto" and len(lenses) < tuning.water.least_cameras:  # views of one lens are one witness
        settings = settings.model_copy(update={"water": "off"})
    return learn({key: camera.images for key, camera in cameras.items()}, settings, tuning, upward, apply)


def _learnt(image: Path, prepared: Classifier, settings: MasksSettings, tuning: Tuning, name: str) -> np.ndarray:
    size = image_size(image)
    check_shape(image, size, prepared.platform, tuning)
    return classes_of(image, prepared, settings, small_shape(size, tuning.frames.work_px), tuning)


def _read_model(images: Sequence[Path], settings: MasksSettings, tuning: Tuning) -> Model:
    if settings.model is None:
        raise InputError("masks.source = model needs masks.model: the TOML file of your segmentation model")
    return read_model(settings.model)


def _by_model(image: Path, prepared: Model, settings: MasksSettings, tuning: Tuning, name: str) -> np.ndarray:
    return model_classes(read_small(image, tuning.frames.work_px), prepared)


SOURCES: dict[str, MaskSource] = {
    "learnt": MaskSource(_prepare_learnt, _learnt),
    "model": MaskSource(each(_read_model), _by_model),
    "folder": MaskSource(each(nothing), _folder),
    "none": MaskSource(each(nothing), lambda image, *_: np.ones(image_size(image), bool)),
}
