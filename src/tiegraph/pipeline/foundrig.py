"""The rigs of a run folder as its model has them: for the next survey, for ``shots``, for COLMAP.

Where what from: cameras and places from ``sparse/world`` once ``georef`` has made it, before from ``sparse/0``. A rig
that was held as given keeps its own lengths: what the positions say of the scale of a survey does not change a measured
rig. A rig that was adjusted has the lengths of the world, and is refused where nothing told metres. Cameras that hang
on a wide one (``scene.hanging``) are in no model and stay as given.

How the model was made its receipt says: which rigs and lenses were held, and the constants. A line of tiegraph.toml
that was written since counts before a constant of the receipt, but never says that a rig was held that was not.
"""

from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tiegraph.errors import InputError, UnreadableArtefact
from tiegraph.pipeline.files import load_scene
from tiegraph.pipeline.foundrun import FoundRun, found_run, with_camera
from tiegraph.project.folder import names_run
from tiegraph.scan.rigfiles.rigfaults import SIGMA_DEG, SIGMA_M
from tiegraph.scan.rigfiles.rigfile import parse_rig_file
from tiegraph.scan.rigfiles.rigspec import rig_config, rig_toml
from tiegraph.scene.colmapmodel import model_rigs, sensor_id
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.sfm.covariance import INTERIOR_TABLE, MOUNTING
from tiegraph.sfm.mapping import believed_cameras
from tiegraph.sfm.rig.diagnostics import OFFSET
from tiegraph.sfm.rig.rig import rig_modes
from tiegraph.sfm.settings import SparseSettings
from tiegraph.text import command

TOML, CONFIG = "rig", "rig_config"
_DIGITS = 3  # of a sigma


@dataclass(frozen=True)
class RigFile:
    """A rig file as text, and what to say of it."""

    text: str
    said: tuple[str, ...]


def rig_file(folder: Path, form: str = TOML) -> RigFile:
    """The rig as the run in a folder found it, as a rig.toml or (``form`` = "rig_config") COLMAP's rig_config.json.

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
        # COLMAP's prefixes begin a name, and folders of passes come before them.
        folders = [s.folder for r in rigs for s in r.sensors]
        if any(f and not any(n.startswith(f"{f}/") for n in run.scene.names) for f in folders):
            said = "put the folder of a pass before each, or move the images"
            run.said.append(f"COLMAP's image_prefix begins a name: {said}")
        if len(set(folders)) < len(folders):
            raise InputError(
                f"{run.folder}: its cameras are told by EXIF and share folders, and a rig_config.json goes by folder: "
                "take the cameras of the COLMAP model in its folder sparse"
            )
        return RigFile(rig_config(rigs), tuple(run.said))
    if run.unscaled:
        raise InputError(
            f"{folder}: nothing in this run told metres, and the places of {run.unscaled[0]} would be in units of the "
            f"model: give positions, control points or a measured baseline ([[pairs]] of the rig file) and run "
            f"`{command('georef', folder)}`, or take --format {CONFIG}, which has no unit"
        )
    if len(rigs) > 1:
        raise InputError(
            f"{folder}: {len(rigs)} rigs ({', '.join(r.name for r in rigs[:4])}), and a rig.toml holds one; take "
            "--format rig_config, or the cameras of the COLMAP model in its folder sparse"
        )
    run.said += [f"contradicted in that run: {text}" for text in run.receipt.get("contradictions", ())]
    said = [f"As the run in {folder} found it.", *run.said]
    text = rig_toml(rigs[0], "\n".join(said))
    parse_rig_file(Path(folder), text, run.tuning.scan.rig)  # what cannot be read again must not be written
    return RigFile(text, tuple(run.said))


def rig_of_run(rig: str | None) -> RigFile | None:
    """The rig.toml of the run folder that ``--rig`` names, None if it names something else. Raises as ``rig_file``."""
    return rig_file(Path(rig)) if rig is not None and names_run(rig) else None


def _found(run: FoundRun, index: int) -> Rig:
    """A rig with the cameras, places and sigmas of the model."""
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
        run.said.append(f"{given.name}: its places are as given: the run did not use the rig (sparse.rig = absent)")
        found = given
    elif mode == "fixed":
        found = held.scaled(1 / held.units(given))
        pairs = [(s.name, s.sensor_from_rig, g.sensor_from_rig) for s, g in zip(found.sensors, given.sensors)]
        moved = [n for n, a, b in pairs if a is not None and b is not None and not np.allclose(a, b, rtol=0, atol=1e-6)]
        but = f" but for {', '.join(moved)}, which the images turned or moved"
        said = f"held by the run{but}" if moved else "as given: the run held them"
        run.said.append(f"{given.name}: its places {'were' if moved else 'are'} {said}")
    else:
        _say_scale(run, found)
        found = _with_sigmas(run, replace(found, fixed=False), index)
    sensors = tuple(
        replace(s, camera=c.camera, source=c.source, camera_sigma_px=c.camera_sigma_px)
        for s, c in zip(found.sensors, cameras)
    )
    return replace(found, sensors=sensors, antenna_m=run.antenna_m or given.antenna_m)


def _cameras(run: FoundRun, index: int, found: Rig) -> list[Sensor]:
    """The sensors of a rig with the cameras of the model."""
    settings = SparseSettings(refine_intrinsics=run.receipt.get("settings", {}).get("refine_intrinsics", "auto"))
    held = believed_cameras(run.scene, settings)
    first = 1 + run.scene.first_sensor(index)
    out = []
    for key, (given, new) in enumerate(zip(run.scene.rigs[index].sensors, found.sensors), start=first):
        sensor, said = with_camera(given, new.camera, key in held, run.rows(INTERIOR_TABLE), run.tuning.scan.rig.camera)
        out.append(sensor)
        run.said += said
    return out


def _with_hanging(run: FoundRun, found: Rig, whole: Rig) -> Rig:
    """The rig with the cameras that hang on it: no match says anything of these, so they stay as they were given."""
    own = {s.name for s in found.sensors}
    given, hung = (
        replace(whole, sensors=tuple(s for s in whole.sensors if (s.name in own) == of)) for of in (True, False)
    )
    if run.unscaled:  # rig_config.json has no unit, but one for all cameras
        hung = hung.scaled(found.units(given))
    sensors = []
    for sensor in hung.sensors:
        with_file, said = with_camera(sensor, sensor.camera, True, (), run.tuning.scan.rig.camera)
        sensors.append(with_file)
        run.said += said
    run.said.append(f"{found.name}: {', '.join(s.name for s in sensors)} hang on it: places and lenses are as given")
    pairs = tuple(p for p in whole.pairs if not set(p.sensors) <= own)
    return replace(found, sensors=(*found.sensors, *sensors), pairs=(*found.pairs, *pairs))


def _say_times(run: FoundRun, given: Rig) -> None:
    if late := _late_ms(run, given):
        told = ", ".join(f"{n} {ms:+g} ms" for n, ms in late.items())
        run.said.append(
            f"{given.name}: the cameras do not fire at one instant, and each has a time of its own in the model. Left "
            f"out, because a rig file cannot say it: {told}"
        )


def _late_ms(run: FoundRun, rig: Rig) -> dict[str, float]:
    """When each camera but the first fires against it, milliseconds; {} if the run has no times."""
    columns = run.receipt.get("tables", {}).get("rig diagnostics", {}).get("columns", [])
    at = columns.index(OFFSET) if OFFSET in columns else -1
    names = {s.name for s in rig.sensors[1:]}
    rows = run.rows("rig diagnostics") if at >= 0 else []
    return {r[0]: r[at] for r in rows if r[0] in names and r[at] is not None}


def _with_scale(run: FoundRun, sigma_m: float, length_m: float) -> float:
    """Sigma of a coordinate with that of the scale of all lengths."""
    return float(np.hypot(sigma_m, length_m * float(np.nan_to_num(run.metres.sigma)) / np.sqrt(3)))


def _say_scale(run: FoundRun, rig: Rig) -> None:
    metres = run.metres
    if np.isfinite(metres.scale):
        known = f", known to {100 * metres.sigma:.2g} %" if metres.sigma > 0 else ""
        run.said.append(f"{rig.name}: lengths are in metres by {metres.source}{known}")
    elif any(s.sensor_from_rig is not None and s.sensor_from_rig[:3, 3].any() for s in rig.sensors):
        run.unscaled.append(rig.name)
        run.said.append(f"{rig.name}: lengths are in units of the model, for nothing told metres")


def _with_sigmas(run: FoundRun, found: Rig, index: int) -> Rig:
    """Sigmas of the adjustment for each axis. Sensors that hardly a tie held stand as the rig file of the run had them,
    those of a drawing with what one is trusted with.

    What was measured between pairs is in the sigmas, and left away: it would count twice.
    """
    given = run.scene.rigs[index]
    table = {row[0]: row[1:] for row in run.rows(MOUNTING)}
    names = [s.name for s in found.sensors[1:]]
    untold = [n for n in names if n not in table]
    if untold:
        run.said.append(f"{found.name}: the run has no sigmas of the places of {', '.join(untold)}")
        return found
    sensors, kept = [found.sensors[0]], []
    scale = float(np.nan_to_num(run.metres.scale, nan=1.0))
    for place, sensor in enumerate(found.sensors[1:], start=1):
        before = given.sensors[place]
        *xyz, sigma, turn = table[sensor.name][:5]
        metres = _with_scale(run, scale * sigma / np.sqrt(3), scale * float(np.linalg.norm(xyz)))
        sigma_deg, sigma_m = min(turn / np.sqrt(3), SIGMA_DEG[1]), min(metres, SIGMA_M[1])  # of an axis, a coordinate
        looks = [s.sensor_from_rig[:3, :3] for s in (sensor, before) if s.sensor_from_rig is not None]
        if len(looks) == 2 and np.allclose(*looks, rtol=0, atol=1e-12):  # exactly where it was given
            kept.append(sensor.name)
            sigma_deg, sigma_m = before.sigma_deg or sigma_deg, before.sigma_m or sigma_m
            if given.nominal:  # the coarse model may have turned it by ties that did not hold
                trusted = run.tuning.sfm.rig
                sigma_deg, sigma_m = trusted.nominal_deg, trusted.nominal_m
                sensor = replace(sensor, sensor_from_rig=run.drawn(index).sensors[place].sensor_from_rig)
        sensors.append(replace(sensor, sigma_deg=_short(sigma_deg), sigma_m=_short(sigma_m)))
    if kept:
        run.said.append(f"{found.name}: {', '.join(kept)} stands as given: too few ties told its place in the rig")
    return replace(found, sensors=tuple(sensors), nominal=False, pairs=())


def _short(value: float) -> float:
    return float(f"{value:.{_DIGITS}g}")
