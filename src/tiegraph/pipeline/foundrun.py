"""What of a run folder its rigs are read from: the models, the receipts, the constants they were made with."""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from tiegraph.errors import InputError, SettingsError, UnreadableArtefact
from tiegraph.pipeline.files import load_json, load_model, load_scene
from tiegraph.project.folder import SETTINGS, check_format, names_run
from tiegraph.project.receipts import Receipts
from tiegraph.project.settings import Tunings, merged, read_settings
from tiegraph.scan.prepare import crop_camera
from tiegraph.scan.rigfiles.rigfaults import lens_fault
from tiegraph.scan.tuning import CameraTuning
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene
from tiegraph.sfm.adjustment.lens import difference_px
from tiegraph.text import command


@dataclass(frozen=True)
class Metres:
    """What a unit of ``sparse/0`` is in metres (NaN = nothing told), the sigma of that (a share), and who told."""

    scale: float = np.nan
    sigma: float = np.nan
    source: str = "none"


@dataclass
class FoundRun:
    """What of a run folder the rigs are read from; ``said`` and ``unscaled`` are added to."""

    folder: Path
    scene: Scene
    receipt: dict[str, Any]  # of sparse
    mapped: pycolmap.Reconstruction  # as sparse left it
    world: pycolmap.Reconstruction  # as georef left it; the same without
    metres: Metres
    antenna_m: tuple[float, float, float] | None
    tuning: Tunings
    said: list[str] = field(default_factory=list)
    unscaled: list[str] = field(default_factory=list)  # rigs whose lengths are in units of the model

    def drawn(self, index: int) -> Rig:
        """A rig as candidates left it, before the coarse model turned cameras."""
        return load_scene(self.folder / "candidates" / "scene.json").rigs[index]

    def rows(self, table: str) -> list[list]:
        """Rows of a table of the receipt of sparse."""
        return list(self.receipt.get("tables", {}).get(table, {}).get("rows", ()))


def found_run(folder: Path) -> FoundRun:
    """The models of a run folder and what is said of them. Raises InputError for a folder that is no run, has no sparse
    model, or whose cameras are views; UnreadableArtefact for what is damaged; SettingsError for its tiegraph.toml."""
    if not names_run(str(folder)):
        raise InputError(f"{folder} is no run folder: give one that `tiegraph run IMAGES -o FOLDER` made")
    check_format(folder)
    receipts = Receipts(folder)
    receipt, placed = receipts.read("sparse"), receipts.read("georef")
    first, world = folder / "sparse" / "0", folder / "sparse" / "world"
    if not receipt.get("finished") or not (first / "cameras.bin").exists():
        raise InputError(f"{folder}: this run has no sparse model yet; `{command('sparse', folder)}` makes it")
    scene = load_scene(folder / "network" / "scene.json")
    if any(s.source is not None and s.source.panorama for s in scene.all_sensors):
        raise InputError(f"{folder}: its cameras are views of panoramas, which need no rig file: give --rig panorama")
    if any(s.source is not None and s.source.view is not None for s in scene.all_sensors):
        raise InputError(
            f"{folder}: its cameras are views of fisheye images, whose lenses it used as they were given: give the rig "
            "file of that run, or calibrate them in a run with --scan.fisheye whole"
        )
    mapped = load_model(first)
    run = FoundRun(
        folder=folder,
        scene=scene,
        receipt=receipt,
        mapped=mapped,
        world=mapped,
        metres=Metres(),
        antenna_m=None,
        tuning=_constants(folder, receipts),
    )
    current = placed.get("finished") and placed.get("from", {}).get("sparse") == receipt.get("made")
    if not current or not (world / "cameras.bin").exists():
        return run
    told = load_json(folder / "world.json")
    scale = float("nan") if told["scale_source"] == "none" else float(told["scale"])
    sigma = told.get("sigma", {}).get("scale", receipt.get("counts", {}).get("scale_sigma", 0.0))
    arm = told.get("antenna_m")
    return replace(
        run,
        world=load_model(world),
        metres=Metres(scale, sigma, told["scale_source"]),
        antenna_m=None if arm is None else tuple(arm),
    )


def _constants(folder: Path, receipts: Receipts) -> Tunings:
    """Those that scan read the rig and sparse made the model with; before them count those of tiegraph.toml."""
    made: dict[str, Any] = {}
    for stage in ("scan", "sparse"):
        own = receipts.read(stage).get("tuning", {})
        try:
            merged({"tuning": own})
        except SettingsError as error:
            raise UnreadableArtefact(receipts.path(stage), error) from None
        made |= own
    return read_settings(folder / SETTINGS, {"tuning": made}).tuning


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
    if source is not None and source.camera is not None:
        own, cropped = given.camera, crop_camera(source.camera, *source.crop_px)
        alike = cropped.model == own.model and (cropped.width, cropped.height) == (own.width, own.height)
    if source is not None and source.camera is not None and not alike:
        return given, [f"{given.name}: its images were undistorted by the camera given, which stands here"]
    if held:
        off = difference_px(given.camera, camera)
        text = f"{given.name}: its calibration is as given, though the images wanted it {off:.1f} px otherwise (median)"
        return given, [] if _same(camera, given.camera) else [text]
    left, top, right, bottom = (0, 0, 0, 0) if source is None else source.crop_px
    camera, said = crop_camera(camera, -left, -top, -right, -bottom), []
    if wrong := lens_fault(camera, tuning):
        said = [f"{given.name}: only the focal length is written, for {wrong}"]
        model = "SIMPLE_RADIAL_FISHEYE" if "FISHEYE" in camera.model.name else "SIMPLE_RADIAL"
        size = camera.width, camera.height
        made = pycolmap.Camera.create_from_model_name(0, model, camera.mean_focal_length(), *size)
        camera = pycolmap.Camera(model=model, width=size[0], height=size[1], params=made.params)
        camera.has_prior_focal_length = True
    else:
        rows = [r for r in sigmas if r[0] == given.name]
        sigma_px = next((r[3] for r in rows if r[1] in ("f", "fx")), given.camera_sigma_px)
        given = replace(given, camera_sigma_px=sigma_px)
        told = ", ".join(f"{r[1]} {r[3]:.2g}" for r in rows)
        said = [f"{given.name}: sigmas of its camera: {told}"] if rows else []
    return replace(given, camera=camera, source=None if source is None else replace(source, camera=camera)), said


def _same(a: pycolmap.Camera, b: pycolmap.Camera) -> bool:
    return a.model == b.model and np.array_equal(a.params, b.params)
