"""The rigs of a run folder by its model: for the next survey, for ``shots``, for COLMAP.

Sources: cameras and poses from ``sparse/world`` once ``georef`` has made it, before from ``sparse/0``. A rig
that was held as given keeps its own lengths: the scale of a survey by its positions does not change a measured
rig. An adjusted rig has the lengths of the world, and is refused if these are not metric. Cameras that depend
on a wide one (``scene.composed``) are in no model and stay as given.

The receipt records how the model was made: which rigs and lenses were held, and the constants. A line of tiegraph.toml
that was written later precedes a constant of the receipt, but never turns an adjusted rig into a held one.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from tiegraph.errors import InputError, SettingsError, UnreadableArtefact
from tiegraph.pipeline.files import load_json, load_model, load_scene
from tiegraph.project.folder import SETTINGS, check_format, names_run
from tiegraph.project.settings import Tunings, merged, read_settings
from tiegraph.project.stages import Receipts
from tiegraph.scan.prepare import crop_camera
from tiegraph.scan.rigfiles.rigfaults import SIGMA_DEG, SIGMA_M, lens_fault
from tiegraph.scan.rigfiles.rigfile import parse_rig_file
from tiegraph.scan.rigfiles.rigspec import rig_config, rig_toml
from tiegraph.scene.colmapmodel import model_rigs, sensor_id
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene
from tiegraph.sfm.adjustment.lens import difference_px
from tiegraph.sfm.covariance import INTERIOR_TABLE, MOUNTING
from tiegraph.sfm.mapping import believed_cameras
from tiegraph.sfm.rig.diagnostics import OFFSET
from tiegraph.sfm.rig.rig import rig_modes
from tiegraph.sfm.settings import SparseSettings
from tiegraph.text import command

TOML, CONFIG = "rig", "rig_config"


@dataclass(frozen=True)
class Metres:
    """Metres in a unit of ``sparse/0`` (NaN = unknown), the sigma of that (a share), and its source."""

    scale: float = np.nan
    sigma: float = np.nan
    source: str = "none"


@dataclass
class FoundRun:
    """The parts of a run folder from which the rigs are read; ``said`` and ``unscaled`` are added to."""

    folder: Path
    scene: Scene
    receipt: dict[str, Any]  # of sparse
    mapped: pycolmap.Reconstruction  # as written by sparse
    world: pycolmap.Reconstruction  # as written by georef; the same without
    metres: Metres
    antenna_m: tuple[float, float, float] | None
    tuning: Tunings
    said: list[str] = field(default_factory=list)
    unscaled: list[str] = field(default_factory=list)  # rigs whose lengths are in model units

    def drawn(self, index: int) -> Rig:
        """A rig as written by candidates, before the coarse model rotated cameras."""
        return load_scene(self.folder / "candidates" / "scene.json").rigs[index]

    def rows(self, table: str) -> list[list]:
        """Rows of a table of the receipt of sparse."""
        return list(self.receipt.get("tables", {}).get(table, {}).get("rows", ()))


def found_run(folder: Path) -> FoundRun:
    """The models of a run folder and notes. Raises InputError for a folder that is no run, has no sparse
    model, or whose cameras are views; UnreadableArtefact for damaged files; SettingsError for its tiegraph.toml."""
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
            f"{folder}: its cameras are views of fisheye images, whose lenses were used as given: give the rig "
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
    run.world, run.metres = load_model(world), Metres(scale, sigma, told["scale_source"])
    run.antenna_m = None if arm is None else tuple(arm)
    return run


def _constants(folder: Path, receipts: Receipts) -> Tunings:
    """Constants with which scan read the rig and sparse made the model; those of tiegraph.toml precede them."""
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
    given: Sensor, found: pycolmap.Camera | None, held: bool, sigmas: Sequence[Sequence]
) -> tuple[Sensor, list[str]]:
    """A sensor with the camera of the model, and notes.

    ``held``: the run kept its calibration. If that gave way to the images of one survey, it is written nevertheless:
    it was measured, and a lens by 25 frames of a car at rest bent the next survey when it was held
    there (PandaSet's second half: 70 mm for 37). The next run can release it by itself. ``sigmas``: rows of the table
    of the interior orientation of all cameras.
    """
    camera, source = found, given.source
    if camera is None or given.camera is None:
        return given, []
    if not given.camera.has_prior_focal_length and _same(camera, given.camera):
        text = f"{given.name}: its camera was guessed and not adjusted: omitted"
        return replace(given, camera=None, source=None if source is None else replace(source, camera=None)), [text]
    if source is not None and source.camera is not None:
        own, cropped = given.camera, crop_camera(source.camera, *source.crop_px)
        if (cropped.model, cropped.width, cropped.height) != (own.model, own.width, own.height):
            return given, [f"{given.name}: its images were undistorted by the given camera, which is written here"]
    if held:
        off = difference_px(given.camera, camera)
        text = f"{given.name}: its calibration is as given, though the images differ from it by {off:.1f} px (median)"
        return given, [] if _same(camera, given.camera) else [text]
    left, top, right, bottom = (0, 0, 0, 0) if source is None else source.crop_px
    camera, said = crop_camera(camera, -left, -top, -right, -bottom), []
    if wrong := lens_fault(camera):
        said = [f"{given.name}: only the focal length is written, because {wrong}"]
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


@dataclass(frozen=True)
class RigFile:
    """A rig file as text, and notes."""

    text: str
    said: tuple[str, ...]


def rig_file(folder: Path, form: str = TOML) -> RigFile:
    """The rig found by the run in a folder, as a rig.toml or (``form`` = "rig_config") COLMAP's rig_config.json.

    Raises InputError for a folder without a sparse model, for a rig.toml whose lengths would not be metres, for several
    rigs in one rig.toml, and for panoramas; SettingsError for its tiegraph.toml.
    """
    try:
        run = found_run(Path(folder))
    except UnreadableArtefact as error:
        raise InputError(f"{error}; finish that run again") from None
    rigs = [_found(run, index) for index in range(len(run.scene.rigs))]
    if (whole := run.folder / "whole.json").exists():
        rigs = [_with_hanging(run, rigs[0], load_scene(whole).rigs[0])]
    if form == CONFIG:
        # COLMAP's prefixes begin a name, and folders of passes precede them.
        folders = [s.folder for r in rigs for s in r.sensors]
        if any(f and not any(n.startswith(f"{f}/") for n in run.scene.names) for f in folders):
            said = "put the folder of a pass before each, or move the images"
            run.said.append(f"COLMAP's image_prefix begins a name: {said}")
        if len(set(folders)) < len(folders):
            raise InputError(
                f"{run.folder}: its cameras are distinguished by EXIF and share folders, but a rig_config.json needs "
                "folders: take the cameras of the COLMAP model in its folder sparse"
            )
        return RigFile(rig_config(rigs), tuple(run.said))
    if run.unscaled:
        raise InputError(
            f"{folder}: this run has no metric scale, and the positions of {run.unscaled[0]} would be in units of the "
            f"model: give positions, control points or a measured baseline ([[pairs]] of the rig file) and run "
            f"`{command('georef', folder)}`, or take --format {CONFIG}, which has no unit"
        )
    if len(rigs) > 1:
        raise InputError(
            f"{folder}: {len(rigs)} rigs ({', '.join(r.name for r in rigs[:4])}), but a rig.toml has one; take "
            "--format rig_config, or the cameras of the COLMAP model in its folder sparse"
        )
    run.said += [f"contradicted in that run: {text}" for text in run.receipt.get("contradictions", ())]
    said = [f"As found by the run in {folder}.", *run.said]
    text = rig_toml(rigs[0], "\n".join(said))
    parse_rig_file(Path(folder), text, run.tuning.scan.rig)  # an unreadable file must not be written
    return RigFile(text, tuple(run.said))


def rig_of_run(rig: str | None) -> RigFile | None:
    """The rig.toml of the run folder that ``--rig`` names, None if it names something else. Raises as ``rig_file``."""
    return rig_file(Path(rig)) if rig is not None and names_run(rig) else None


def _found(run: FoundRun, index: int) -> Rig:
    given, several = run.scene.rigs[index], len(run.scene.rigs[index].sensors) > 1
    mode = rig_modes(run.scene.measured(), run.receipt.get("settings", {}).get("rig", "auto")).get(index, "")
    reference = sensor_id(1 + run.scene.first_sensor(index))
    in_model = index + 1 in run.mapped.rigs and run.mapped.rigs[index + 1].is_ref_sensor(reference)
    rigid = several and bool(mode) and in_model
    held = model_rigs(run.mapped, run.scene)[index]
    found = model_rigs(run.world, run.scene)[index]
    cameras = _cameras(run, index, found)
    _say_times(run, given)
    if not several:
        found = given
    elif not rigid:
        run.said.append(f"{given.name}: its poses are as given: the run did not use the rig (sparse.rig = absent)")
        found = given
    elif mode == "fixed":
        found = held.scaled(1 / held.units(given))
        pairs = [(s.name, s.sensor_from_rig, g.sensor_from_rig) for s, g in zip(found.sensors, given.sensors)]
        moved = [n for n, a, b in pairs if a is not None and b is not None and not np.allclose(a, b, rtol=0, atol=1e-6)]
        but = f" except for {', '.join(moved)}, which the images rotated or moved"
        said = f"held by the run{but}" if moved else "as given: the run held them"
        run.said.append(f"{given.name}: its poses {'were' if moved else 'are'} {said}")
    else:
        _say_scale(run, found)
        found = _with_sigmas(run, replace(found, fixed=False), index)
    sensors = tuple(
        replace(s, camera=c.camera, source=c.source, camera_sigma_px=c.camera_sigma_px)
        for s, c in zip(found.sensors, cameras)
    )
    return replace(found, sensors=sensors, antenna_m=run.antenna_m or given.antenna_m)


def _cameras(run: FoundRun, index: int, found: Rig) -> list[Sensor]:
    settings = SparseSettings(refine_intrinsics=run.receipt.get("settings", {}).get("refine_intrinsics", "auto"))
    held = believed_cameras(run.scene, settings)
    first = 1 + run.scene.first_sensor(index)
    out = []
    for key, (given, new) in enumerate(zip(run.scene.rigs[index].sensors, found.sensors), start=first):
        sensor, said = with_camera(given, new.camera, key in held, run.rows(INTERIOR_TABLE))
        out.append(sensor)
        run.said += said
    return out


def _with_hanging(run: FoundRun, found: Rig, whole: Rig) -> Rig:
    """The rig with its dependent cameras: no match constrains these, so they stay as given."""
    own = {s.name for s in found.sensors}
    given, hung = (
        replace(whole, sensors=tuple(s for s in whole.sensors if (s.name in own) == of)) for of in (True, False)
    )
    if run.unscaled:  # rig_config.json has no unit, but one for all cameras
        hung = hung.scaled(found.units(given))
    sensors = []
    for sensor in hung.sensors:
        with_file, said = with_camera(sensor, sensor.camera, True, ())
        sensors.append(with_file)
        run.said += said
    run.said.append(f"{found.name}: {', '.join(s.name for s in sensors)} depend on it: poses and lenses are as given")
    pairs = tuple(p for p in whole.pairs if not set(p.sensors) <= own)
    return replace(found, sensors=(*found.sensors, *sensors), pairs=(*found.pairs, *pairs))


def _say_times(run: FoundRun, given: Rig) -> None:
    columns = run.receipt.get("tables", {}).get("rig diagnostics", {}).get("columns", [])
    if OFFSET not in columns:
        return
    at, names = columns.index(OFFSET), {s.name for s in given.sensors[1:]}
    late = [f"{r[0]} {r[at]:+g} ms" for r in run.rows("rig diagnostics") if r[0] in names and r[at] is not None]
    if late:
        run.said.append(
            f"{given.name}: the cameras do not fire at one instant, and each has a time offset in the model. Left "
            f"out, because a rig file cannot contain it: {', '.join(late)}"
        )


def _say_scale(run: FoundRun, rig: Rig) -> None:
    metres = run.metres
    if np.isfinite(metres.scale):
        known = f", known to {100 * metres.sigma:.2g} %" if metres.sigma > 0 else ""
        run.said.append(f"{rig.name}: lengths are in metres by {metres.source}{known}")
    elif any(s.sensor_from_rig is not None and s.sensor_from_rig[:3, 3].any() for s in rig.sensors):
        run.unscaled.append(rig.name)
        run.said.append(f"{rig.name}: lengths are in model units, because the scale is unknown")


def _with_sigmas(run: FoundRun, found: Rig, index: int) -> Rig:
    """Sigmas of the adjustment for each axis. Sensors with too few ties stay as in the rig file of the run,
    nominal ones with the sigma of a drawing.

    Measurements between pairs are part of the sigmas, and omitted: they would count twice.
    """
    given = run.scene.rigs[index]
    table = {row[0]: row[1:] for row in run.rows(MOUNTING)}
    names = [s.name for s in found.sensors[1:]]
    untold = [n for n in names if n not in table]
    if untold:
        run.said.append(f"{found.name}: the run has no sigmas of the poses of {', '.join(untold)}")
        return found
    sensors, kept = [found.sensors[0]], []
    scale = float(np.nan_to_num(run.metres.scale, nan=1.0))
    for place, sensor in enumerate(found.sensors[1:], start=1):
        before = given.sensors[place]
        *xyz, sigma, turn = table[sensor.name][:5]
        # Of a coordinate, with the sigma of the scale of all lengths
        by_scale = scale * float(np.linalg.norm(xyz)) * float(np.nan_to_num(run.metres.sigma)) / np.sqrt(3)
        metres = float(np.hypot(scale * sigma / np.sqrt(3), by_scale))
        sigma_deg, sigma_m = min(turn / np.sqrt(3), SIGMA_DEG[1]), min(metres, SIGMA_M[1])  # of an axis, a coordinate
        looks = [s.sensor_from_rig[:3, :3] for s in (sensor, before) if s.sensor_from_rig is not None]
        if len(looks) == 2 and np.allclose(*looks, rtol=0, atol=1e-12):  # exactly as given
            kept.append(sensor.name)
            sigma_deg, sigma_m = before.sigma_deg or sigma_deg, before.sigma_m or sigma_m
            if given.nominal:  # the coarse model may have rotated it by ties that did not hold
                trusted = run.tuning.sfm.rig
                sigma_deg, sigma_m = trusted.nominal_deg, trusted.nominal_m
                sensor = replace(sensor, sensor_from_rig=run.drawn(index).sensors[place].sensor_from_rig)
        sensors.append(replace(sensor, sigma_deg=float(f"{sigma_deg:.3g}"), sigma_m=float(f"{sigma_m:.3g}")))
    if kept:
        run.said.append(f"{found.name}: {', '.join(kept)} as given: too few ties determine the pose in the rig")
    return replace(found, sensors=tuple(sensors), nominal=False, derived=False, pairs=())
