"""Glue of `tiegraph calibrate --from OUT`: the calibration that a run found, beside one of a board."""

from pathlib import Path

import numpy as np
import pycolmap

from tiegraph.calibrate.difference import Calibration, Difference, differences
from tiegraph.calibrate.tuning import JudgeTuning
from tiegraph.errors import InputError
from tiegraph.pipeline.calibrate import Outputs
from tiegraph.pipeline.foundrig import rig_file
from tiegraph.project.progress import Reporter
from tiegraph.project.stages import write_atomic
from tiegraph.project.verbtunings import VerbTunings
from tiegraph.scan.rigfiles.rigfile import parse_rig_file, read_rig_file
from tiegraph.scan.rigfiles.rigspec import RigSpec, SensorSpec


def self_calibration(
    folder: Path,
    out: Path,
    against: Path | None = None,
    reporter: Reporter | None = None,
    tunings: VerbTunings | None = None,
) -> tuple[Difference, ...]:
    """Write the rig of a run folder as ``out``; how it differs from the rig file ``against``, camera by camera.

    Raises InputError as ``foundrig.rig_file`` does, for a rig file that cannot be read, has several rigs or other
    cameras, and for outputs that are there.
    """
    reporter, tunings = reporter or Reporter("quiet"), tunings or VerbTunings()
    tuning = tunings.scan.rig
    made = Outputs.beside(out)
    other = None if against is None else _only(against, read_rig_file(against, tuning))
    found = rig_file(folder)
    said = [f"the run says: {text}" for text in found.said]
    rows: tuple[Difference, ...] = ()
    if other is not None:
        (own,) = parse_rig_file(folder, found.text, tuning)
        rows = differences(_calibrations(other), _calibrations(own))
        said += [sentence(row, tunings.calibrate.judge) for row in rows]
    write_atomic(made.rig, found.text)
    for text in (*said, f"written: {made.rig}"):
        reporter.say(text)
    return rows


def sentence(row: Difference, tuning: JudgeTuning) -> str:
    """What the calibrations of a camera have in common, in words."""
    parts = []
    if np.isfinite(row.focal):
        parts.append(f"focal length {100 * row.focal:+.3f} %{_sigmas(row.focal_sigmas)}")
        parts.append(f"lens {row.lens_px:.2f} px otherwise (RMS)")
    if np.isfinite(row.turn_deg):
        parts.append(f"turned by {row.turn_deg:.3f} deg{_sigmas(row.turn_sigmas)}")
        parts.append(f"moved by {1000 * row.place_m:.1f} mm{_sigmas(row.place_sigmas)}")
    worst = row.worst_sigmas()
    if np.isfinite(worst):
        parts.append("they agree" if worst <= tuning.agree_sigmas else "they contradict each other")
    return f"{row.name}, against the board: {', '.join(parts) or 'nothing to compare'}"


def _sigmas(value: float) -> str:
    return f" ({value:.1f} sigmas)" if np.isfinite(value) else ""


def _only(path: Path, rigs: tuple[RigSpec, ...]) -> RigSpec:
    if len(rigs) != 1:
        raise InputError(f"--against {path}: {len(rigs)} rigs in it, and a run's rig is compared with one")
    return rigs[0]


def _calibrations(rig: RigSpec) -> list[Calibration]:
    return [_calibration(s) for s in rig.sensors]


def _calibration(sensor: SensorSpec) -> Calibration:
    camera = None
    if sensor.model is not None and sensor.params is not None and sensor.size is not None:
        width, height = sensor.size
        camera = pycolmap.Camera(model=sensor.model, width=width, height=height, params=list(sensor.params))
    pose = sensor.body_from_sensor
    return Calibration(
        name=sensor.name,
        camera=camera,
        sensor_from_rig=None if pose is None else np.linalg.inv(pose),
        focal_sigma_px=sensor.camera_sigma_px,
        sigma_deg=sensor.sigma_deg,
        sigma_m=sensor.sigma_m,
    )
