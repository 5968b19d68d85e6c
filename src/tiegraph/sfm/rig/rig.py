"""The rig in the mapping: how it is used, extrinsics derived from a model without it, and how far a
model moved them."""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
import pycolmap

from tiegraph.errors import SettingsError
from tiegraph.geometry import transforms
from tiegraph.geometry.align import l1_mean_rotation
from tiegraph.scene.colmapmodel import image_poses, matrix
from tiegraph.scene.rig import Rig
from tiegraph.scene.scene import Scene
from tiegraph.sfm.tuning.rig import DeriveTuning, RigTuning


def held_by_mapper(rig: Rig, mode: str, tuning: RigTuning) -> bool:
    """Whether a mapper keeps the extrinsics as given; those with sigmas are released in the final adjustment only."""
    if mode == "soft":
        return all((s.sigma_deg or 0.0) <= tuning.tight_deg for s in rig.sensors[1:])
    return mode == "fixed"


def rig_modes(scene: Scene, choice: str) -> dict[int, str]:
    """How each rig with several sensors is used: "fixed", "soft", "refined" or "derived"; an absent rig has no entry.

    ``choice`` is the setting; "auto": soft if values are given with a sigma, fixed if it was calibrated, refined if
    the extrinsics are given in another way (nominal), else derived from a first model. A calibrated rig that is
    refined diverges where the vehicle hardly turns: PandaSet's positions by 0.44 m (0.06 m fixed), its cameras by 1
    m.

    Raises SettingsError for "fixed" without extrinsics.
    """
    modes: dict[int, str] = {}
    for index, rig in enumerate(scene.rigs):
        if len(rig.sensors) < 2 or choice == "absent":
            continue
        if choice == "fixed":
            if not rig.known():
                raise SettingsError(
                    f"sparse.rig = 'fixed', but rig {rig.name!r} has sensors without extrinsics: "
                    f"give them in the rig file, or choose auto, refined or absent"
                )
            modes[index] = "fixed"
        elif not rig.known():
            modes[index] = "derived"
        elif rig.soft():
            modes[index] = "soft"
        else:
            modes[index] = "fixed" if rig.measured() and choice == "auto" else "refined"
    return modes


@dataclass(frozen=True)
class SensorScatter:
    """One sensor relative to its rig, over the frames that show both: robust average and scatter over the frames."""

    sensor: str
    frames: int
    scatter_deg: float  # MAD of the rotation angle to the average
    outliers: float  # share of frames farther than 5 degrees from the average

    def rigid(self, tuning: DeriveTuning) -> bool:
        """Whether the frames agree on one mounting."""
        enough = self.frames >= tuning.min_frames
        return enough and self.scatter_deg <= tuning.max_scatter_deg and self.outliers <= tuning.max_outliers

    def why_not(self, tuning: DeriveTuning) -> str:
        """Why ``rigid`` says no."""
        if self.frames < tuning.min_frames:
            return f"only {self.frames} frames show it together with the others"
        return (
            f"its rotation scatters by {self.scatter_deg:.2f} deg with {self.outliers:.0%} outliers over "
            f"{self.frames} frames: it is not rigid, not synchronised, or the model without rig is bent there"
        )


@dataclass(frozen=True)
class DerivedRig:
    """Extrinsics from a model made without the rig; sensors that are not rigid relative to it are left out."""

    rig: Rig | None  # None: no two sensors are rigid
    scatter: tuple[SensorScatter, ...]
    left_out: tuple[tuple[str, str], ...]  # sensor name, why it is not in the rig


def derive_rig(scene: Scene, index: int, models: Sequence[pycolmap.Reconstruction], tuning: DeriveTuning) -> DerivedRig:
    """Extrinsics of rig ``index`` by robust averages over the frames of models made without it.

    R: Weiszfeld's L1 mean of R_c R_ref^T; t: median, each model scaled to the first by the median baseline
    (ALGORITHMS section 4). A sensor never seen together with the reference is connected through one that was. Lengths
    are in units of the first model. The MAD of each sensor is the test of rigidity and synchronisation; a sensor that
    fails it is left out.
    """
    poses = [image_poses(m, scene) for m in models]
    rig = scene.rigs[index]
    found: dict[int, np.ndarray] = {0: np.eye(4)}
    rows: list[SensorScatter] = []
    left_out: dict[int, str] = {}
    relative = _relative_poses(scene, index, poses)
    while True:
        ready = {(a, b): t for (a, b), t in relative.items() if a in found and b not in found and b not in left_out}
        if not ready:
            break
        (a, b), stack = max(ready.items(), key=lambda item: (len(item[1]), -item[0][0], -item[0][1]))
        average, scatter = _average(stack, rig.sensors[b].name, tuning.outlier_deg)
        rows.append(scatter)
        if scatter.rigid(tuning):
            found[b] = average @ found[a]
        else:
            left_out[b] = scatter.why_not(tuning)
    for b in range(len(rig.sensors)):
        if b not in found:
            left_out.setdefault(b, "no frame shows it together with the others in one model")
    names = tuple((rig.sensors[b].name, why) for b, why in sorted(left_out.items()))
    if len(found) < 2:
        return DerivedRig(None, tuple(rows), names)
    sensors = tuple(replace(s, sensor_from_rig=found.get(k)) for k, s in enumerate(rig.sensors))
    return DerivedRig(replace(rig, sensors=sensors, fixed=False, nominal=True), tuple(rows), names)


def _relative_poses(scene: Scene, index: int, poses: Sequence[np.ndarray]) -> dict[tuple[int, int], np.ndarray]:
    """b_from_a (K, 4, 4) of every pair of sensors over all frames and models, baselines scaled to the first model's."""
    of_rig = np.flatnonzero(scene.rig[scene.frame] == index)
    by_frame: dict[int, list[int]] = {}
    for k in of_rig:
        by_frame.setdefault(int(scene.frame[k]), []).append(int(k))
    out: dict[tuple[int, int], list[np.ndarray]] = {}
    unit = np.nan
    for model in poses:
        pairs = [(a, b) for members in by_frame.values() for a in members for b in members if a != b]
        steps = [(a, b, model[b] @ transforms.invert(model[a])) for a, b in pairs if np.isfinite(model[[a, b]]).all()]
        if not steps:
            continue
        length = float(np.median([np.linalg.norm(step[:3, 3]) for _, _, step in steps]))
        unit = length if np.isnan(unit) else unit
        for a, b, step in steps:
            scaled = step.copy()
            scaled[:3, 3] *= unit / length if length > 0 else 1.0
            out.setdefault((int(scene.sensor[a]), int(scene.sensor[b])), []).append(scaled)
    return {key: np.stack(steps) for key, steps in out.items()}


def _average(stack: np.ndarray, name: str, outlier_deg: float) -> tuple[np.ndarray, SensorScatter]:
    rotation = l1_mean_rotation(stack[:, :3, :3])
    angles = transforms.angle_deg(stack[:, :3, :3], rotation)
    close = angles < outlier_deg
    translations = stack[close if close.any() else slice(None), :3, 3]
    translation = np.median(translations, axis=0)
    scatter = SensorScatter(
        sensor=name,
        frames=len(stack),
        scatter_deg=float(np.median(angles)),
        outliers=float(np.mean(~close)),
    )
    return transforms.rigid(rotation, translation), scatter


def model_extrinsics(reconstruction: pycolmap.Reconstruction, scene: Scene, index: int) -> list[np.ndarray | None]:
    """sensor_from_rig (4, 4) of each sensor of rig ``index`` as the model has it; None = not in the model's rig.

    Re-expressed to the scene's rig frame when the model had to take another sensor as reference.
    """
    rig = scene.rigs[index]
    first_key = scene.first_sensor(index)
    camera_of = {int(scene.sensor_key[scene.image_index[i.name]]): i.camera_id
                 for i in reconstruction.images.values() if i.name in scene.image_index}  # fmt: skip
    out: list[np.ndarray | None] = [None] * len(rig.sensors)
    cameras = {s: camera_of[first_key + s] for s in range(len(rig.sensors)) if first_key + s in camera_of}
    for row in reconstruction.rigs.values():
        if row.num_sensors() < 2 or row.ref_sensor_id.id not in cameras.values():
            continue
        reference = next(s for s, c in cameras.items() if c == row.ref_sensor_id.id)
        back = rig.sensors[reference].sensor_from_rig
        back = np.eye(4) if reference == 0 or back is None else back
        out[reference] = back
        by_camera = {key.id: pose for key, pose in row.non_ref_sensors.items()}
        for s, camera in cameras.items():
            if by_camera.get(camera) is not None:
                out[s] = matrix(by_camera[camera]) @ back
    return out


def rig_table(scene: Scene, reconstruction: pycolmap.Reconstruction, metres_per_unit: float = 1.0) -> dict:
    """Table of each sensor's rotation and shift relative to the given rig; empty rows without a given rig."""
    rows = []
    for index, rig in enumerate(scene.rigs):
        extrinsics = model_extrinsics(reconstruction, scene, index)
        for sensor, adjusted in zip(rig.sensors[1:], extrinsics[1:]):
            if adjusted is None:
                continue
            baseline = float(np.linalg.norm(transforms.centre(adjusted))) * metres_per_unit
            turn, shift = float("nan"), float("nan")
            if sensor.sensor_from_rig is not None:
                turn = float(transforms.angle_deg(adjusted[:3, :3], sensor.sensor_from_rig[:3, :3]))
                moved = transforms.centre(adjusted) * metres_per_unit - transforms.centre(sensor.sensor_from_rig)
                shift = float(np.linalg.norm(moved))
            rows.append([rig.name, sensor.name, _finite(turn, 3), _finite(shift, 4), _finite(baseline, 4)])
    return {"columns": ["rig", "camera", "turned deg", "moved", "baseline"], "rows": rows}


def _finite(value: float, digits: int) -> float | None:
    return round(value, digits) if np.isfinite(value) else None
