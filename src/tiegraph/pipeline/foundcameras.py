"""The cameras of a run's model as a rig file has them: as the files of the user are, before cropping."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np
import pycolmap

from tiegraph.scan.prepare import crop_camera
from tiegraph.scan.rigfiles.rigfaults import lens_fault
from tiegraph.scan.tuning import CameraTuning
from tiegraph.scene.rig import Sensor
from tiegraph.sfm.adjustment.lens import difference_px


def with_camera(
    given: Sensor, found: pycolmap.Camera | None, held: bool, sigmas: Sequence[Sequence], tuning: CameraTuning
) -> tuple[Sensor, list[str]]:
    """A sensor with the camera of the model, and what to say of it.

    ``held``: the run believed its calibration. Where that gave way to the images of one survey, it stands here all the
    same: it was measured, and what 25 frames of a car that stands make of a lens bent the next survey when it was held
    there (PandaSet's second half: 70 mm for 37). That one can let go of it by itself. ``sigmas``: rows of the table of
    the interior orientation of all cameras.
    """
    camera, source = found, given.source
    if camera is None or given.camera is None:
        return given, []
    if not given.camera.has_prior_focal_length and _same(camera, given.camera):
        text = f"{given.name}: its camera was guessed and not adjusted: left away"
        return replace(given, camera=None, source=None if source is None else replace(source, camera=None)), [text]
    if source is not None and source.camera is not None and not _as_cropped(given, source.camera):
        return given, [f"{given.name}: its images were undistorted by the camera given, which stands here"]
    if held:
        off = difference_px(given.camera, camera)
        text = f"{given.name}: its calibration is as given, though the images wanted it {off:.1f} px otherwise (median)"
        return given, [] if _same(camera, given.camera) else [text]
    left, top, right, bottom = (0, 0, 0, 0) if source is None else source.crop_px
    camera, said = crop_camera(camera, -left, -top, -right, -bottom), []
    if wrong := lens_fault(camera, tuning):
        said = [f"{given.name}: only the focal length is written, for {wrong}"]
        camera = _undistorted(camera, camera.mean_focal_length())
    else:
        rows = [r for r in sigmas if r[0] == given.name]
        sigma_px = next((r[3] for r in rows if r[1] in ("f", "fx")), given.camera_sigma_px)
        given = replace(given, camera_sigma_px=sigma_px)
        told = ", ".join(f"{r[1]} {r[3]:.2g}" for r in rows)
        said = [f"{given.name}: sigmas of its camera: {told}"] if rows else []
    return replace(given, camera=camera, source=None if source is None else replace(source, camera=camera)), said


def _same(a: pycolmap.Camera, b: pycolmap.Camera) -> bool:
    return a.model == b.model and np.array_equal(a.params, b.params)


def _as_cropped(sensor: Sensor, whole: pycolmap.Camera) -> bool:
    """Whether the images of a sensor are those of its files but for what was cut off."""
    assert sensor.source is not None and sensor.camera is not None
    made = crop_camera(whole, *sensor.source.crop_px)
    return made.model == sensor.camera.model and (made.width, made.height) == (
        sensor.camera.width,
        sensor.camera.height,
    )


def _undistorted(camera: pycolmap.Camera, focal_px: float) -> pycolmap.Camera:
    fisheye = "FISHEYE" in camera.model.name
    model = "SIMPLE_RADIAL_FISHEYE" if fisheye else "SIMPLE_RADIAL"
    made = pycolmap.Camera.create_from_model_name(0, model, focal_px, camera.width, camera.height)
    out = pycolmap.Camera(model=model, width=camera.width, height=camera.height, params=made.params)
    out.has_prior_focal_length = True
    return out
