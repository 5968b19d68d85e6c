"""The camera of a sensor: from the rig file, from EXIF, from a preset's field of view, or guessed and said so."""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pycolmap

from tiegraph.errors import InputError
from tiegraph.scan.folders import words
from tiegraph.scan.prepare import crop_camera, pinhole_camera
from tiegraph.scan.rigfiles.rigfaults import focal_fault, lens_fault
from tiegraph.scan.rigfiles.rigspec import SensorSpec
from tiegraph.scan.settings import ScanSettings
from tiegraph.scan.tuning import CameraTuning
from tiegraph.scene.decoding import EIGHT_BIT, Levels
from tiegraph.scene.rig import Source


@dataclass(frozen=True)
class FileFacts:
    """What the probes say about the images of one sensor."""

    size: tuple[int, int]  # width, height of most of them, upright if ``upright``
    focal_px: float  # median of EXIF, NaN = none
    upright: bool
    levels: Levels
    loose: bool
    radius_px: float = float("nan")  # of the circle that a fisheye lens lights of most of them, NaN = none shows


def calibrate(
    spec: SensorSpec, facts: FileFacts, file: str, settings: ScanSettings, tuning: CameraTuning
) -> tuple[pycolmap.Camera, Source | None, str]:
    """Camera of a sensor's prepared images, how to prepare them, and where the focal length comes from (for people);
    ``file`` is the rig file, "" for presets and guesses.

    Raises InputError if the rig file's camera does not fit the images, if cropping leaves nothing, or if undistortion
    is asked for a camera that is not calibrated.
    """
    camera, how = _file_camera(spec, facts, file, settings, tuning)
    crop = spec.crop_px or settings.crop_px
    crop = (crop[0], crop[1], crop[2], crop[3])
    prepared = camera
    if any(crop):
        left, top, right, bottom = crop
        if min(crop) < 0 or min(camera.width - left - right, camera.height - top - bottom) < tuning.min_side_px:
            raise InputError(
                f"crop_px = {list(crop)} of sensor {spec.name!r} leaves less than {tuning.min_side_px} px of "
                f"{camera.width} x {camera.height}: left, top, right, bottom are the pixels to cut off"
            )
        prepared = crop_camera(camera, *crop)
    if settings.undistort:
        if spec.params is None:
            raise InputError(
                f"undistort: sensor {spec.name!r} has no calibrated camera; give its model and params in a rig file, "
                "or leave undistort off: the distortion is then estimated with the model"
            )
        if not prepared.is_undistorted():
            prepared = pinhole_camera(prepared)
    deep = facts.levels != EIGHT_BIT
    if deep:
        how += "; pixels deeper than 8 bits: {:g} to {:g} become 0 to 255".format(*facts.levels)
    changed = spec.view_of_panorama or any(crop) or prepared.model != camera.model or not facts.upright or deep
    source = Source(camera=camera, crop_px=crop, upright=facts.upright, levels=facts.levels, part=spec.part)
    source = replace(source, panorama=spec.view_of_panorama)
    return prepared, source if changed or spec.part is not None else None, how


def _file_camera(
    spec: SensorSpec, facts: FileFacts, file: str, settings: ScanSettings, tuning: CameraTuning
) -> tuple[pycolmap.Camera, str]:
    if spec.params is not None and spec.model is not None:
        return _from_params(spec.model, spec.params, spec, facts, spec.at if spec.started else file, tuning)
    model = spec.model or _default_model(spec, facts, settings)
    fisheye, named = "FISHEYE" in model, Path(file).name  # where it lies on this machine is nobody's
    width, height = facts.size
    if spec.focal_px is not None:
        scale = _scale(spec, facts, file, tuning)
        wrong = focal_fault(spec.focal_px * scale, width, fisheye, tuning)
        if wrong:
            raise InputError(f"{spec.at or file}: sensor {spec.name!r}: {wrong}")
        return _camera(model, spec.focal_px * scale, facts, True), f"focal length from {named}{_scaled(scale)}"
    if spec.hfov_deg is not None and file:
        if not fisheye and not tuning.min_fov_deg <= spec.hfov_deg <= tuning.max_fov_deg:
            raise InputError(
                f"{spec.at or file}: sensor {spec.name!r}: hfov_deg = {spec.hfov_deg:g}: a {model} image sees "
                f"{tuning.min_fov_deg:g} to {tuning.max_fov_deg:g} degrees; give a fisheye model?"
            )
        return _camera(model, _from_hfov(spec.hfov_deg, width, fisheye), facts, True), f"field of view from {named}"
    if np.isfinite(facts.focal_px):
        return _camera(model, facts.focal_px, facts, True), "focal length from EXIF"
    if spec.hfov_deg is not None:
        how = f"focal length from the preset's nominal field of view of {spec.hfov_deg:g} degrees"
        return _camera(model, _from_hfov(spec.hfov_deg, width, fisheye), facts, False), how
    if fisheye and np.isfinite(facts.radius_px):
        across = tuning.guessed_circle_deg
        how = f"focal length guessed: a fisheye of {across:g} degrees across its circle"
        return _camera(model, _from_hfov(across, 2 * facts.radius_px, fisheye), facts, False), how
    if fisheye:
        across = tuning.guessed_fisheye_deg
        how = f"focal length guessed: a fisheye of {across:g} degrees across"
        return _camera(model, _from_hfov(across, width, fisheye), facts, False), how
    guess = tuning.guessed_focal * max(width, height)
    how = f"focal length guessed as {tuning.guessed_focal} x the longer side (no EXIF, no rig file with a camera)"
    return _camera(model, guess, facts, False), how


def _from_params(
    model: str, params: tuple[float, ...], spec: SensorSpec, facts: FileFacts, file: str, tuning: CameraTuning
) -> tuple[pycolmap.Camera, str]:
    scale = _scale(spec, facts, file, tuning)
    width, height = spec.size or facts.size
    camera = pycolmap.Camera(model=model, width=width, height=height, params=list(params))
    wrong = lens_fault(camera, tuning)
    if wrong:
        raise InputError(f"{spec.at or file}: sensor {spec.name!r}: {wrong}")
    if (width, height) != facts.size:
        camera.rescale(*facts.size)
    camera.has_prior_focal_length = True
    named = Path(file).name or "its circle, a guess"
    origin = "an exact view of the panoramas" if spec.view_of_panorama else f"camera from {named}"
    return camera, f"{origin}{_scaled(scale)}"


def _scale(spec: SensorSpec, facts: FileFacts, file: str, tuning: CameraTuning) -> float:
    """Images' width over the width the rig file speaks of."""
    if spec.size is None or spec.size == facts.size:
        return 1.0
    across, down = facts.size[0] / spec.size[0], facts.size[1] / spec.size[1]
    if abs(across / down - 1) > tuning.same_shape:
        raise InputError(
            f"{file}: the camera of sensor {spec.name!r} is for {spec.size[0]} x {spec.size[1]} images, but its images "
            f"have {facts.size[0]} x {facts.size[1]}: another shape, so the parameters cannot be rescaled. Give the "
            "parameters of these images, or leave the camera away"
        )
    return across


def _scaled(scale: float) -> str:
    return "" if scale == 1 else f", rescaled by {scale:.4g} to the size of the images"


def _from_hfov(hfov_deg: float, width: float, fisheye: bool) -> float:
    half = np.radians(hfov_deg) / 2
    return float(width / 2 / (half if fisheye else np.tan(half)))


def _default_model(spec: SensorSpec, facts: FileFacts, settings: ScanSettings) -> str:
    if settings.camera_model != "auto":
        return settings.camera_model
    if "fisheye" in words(spec.folder or spec.name) or np.isfinite(facts.radius_px):
        return "OPENCV_FISHEYE"
    # Loose photographs: few images of a camera, so one distortion parameter. Rigs and sequences: wide lenses need two,
    # but on the nearly straight tracks of a survey fy and the tangential terms of OPENCV are hardly observable (they
    # trade against the rotations) and bend the model; the final adjustment adds them with priors (sfm.adjustment.lens).
    return "SIMPLE_RADIAL" if facts.loose else "RADIAL"


def _camera(model: str, focal_px: float, facts: FileFacts, prior: bool) -> pycolmap.Camera:
    made = pycolmap.Camera.create_from_model_name(0, model, float(focal_px), *facts.size)
    camera = pycolmap.Camera(model=model, width=facts.size[0], height=facts.size[1], params=made.params)
    camera.has_prior_focal_length = prior
    return camera
