"""The rig in the mapping: how it is used, extrinsics derived from a model without it, sensors that have too few ties,
and how far a model moved them."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pycolmap
import scipy
from scipy.spatial.transform import Rotation

from tiegraph.errors import SettingsError
from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import Similarity, l1_mean_rotation, rms_length, robust_umeyama
from tiegraph.scene.colmapmodel import image_poses, rigid3d, sensor_id
from tiegraph.scene.evidence import LIMIT
from tiegraph.scene.rig import Rig
from tiegraph.scene.scene import Scene
from tiegraph.scene.sorting import evenly
from tiegraph.sfm.model import distances, relative_poses
from tiegraph.sfm.tuning.placement import ScaleTuning
from tiegraph.sfm.tuning.rig import DeriveTuning, RigTuning, SupportTuning
from tiegraph.sfm.verified import ViewGraph


def held_by_mapper(scene: Scene, modes: Mapping[int, str], tuning: RigTuning) -> tuple[int, ...]:
    """The rigs whose extrinsics a mapper keeps; those with larger sigmas are released in the final adjustment only."""
    tight = {k: all((s.sigma_deg or 0.0) <= tuning.tight_deg for s in scene.rigs[k].sensors[1:]) for k in modes}
    return tuple(k for k, mode in modes.items() if mode == "fixed" or (mode == "soft" and tight[k]))


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
class _Scatter:
    """One sensor relative to another over the frames that show both: their number, the MAD of the rotation angle to
    the robust average, and the share of frames far from it."""

    frames: int
    deg: float
    outliers: float

    @property
    def agreeing(self) -> int:
        """Number of frames that agree."""
        return round((1 - self.outliers) * self.frames)

    def few(self, tuning: DeriveTuning) -> bool:
        """Whether so few frames agree that the model is torn, if the cameras are rigid."""
        return self.outliers > tuning.max_outliers

    def why_not(self, tuning: DeriveTuning) -> str:
        """Why no mounting is known; "" if one is."""
        if self.frames < tuning.min_frames:
            return f"only {self.frames} frames show it together with the others"
        if self.deg <= tuning.max_scatter_deg and self.agreeing >= tuning.min_frames:
            return ""
        return (
            f"its rotation scatters by {self.deg:.2f} deg with {self.outliers:.0%} outliers over {self.frames} frames: "
            "it is not rigid, not synchronised, or the model without rig is bent there"
        )


def derive_rig(
    scene: Scene, index: int, poses: Sequence[np.ndarray], tuning: DeriveTuning
) -> tuple[Rig | None, str, bool]:
    """Extrinsics of rig ``index`` by robust averages over the frames of models made without it, of which ``poses`` are
    those (N, 4, 4) of their images; None if no two sensors are rigid. A remark; whether the models seem to be torn.

    R: Weiszfeld's L1 mean of R_c R_ref^T; t: median, each model scaled to the first by the median baseline
    (ALGORITHMS section 4). A sensor never seen together with the reference is connected through one that was, and one
    that no frame shows together with any, such as a camera that looks up, by its motion in a model of its own. Lengths
    are in units of the first model. The MAD of each sensor is the test of rigidity and synchronisation; a sensor that
    fails it is left out.
    """
    rig = scene.rigs[index]
    names = [s.name for s in rig.sensors]
    found: dict[int, np.ndarray] = {0: np.eye(4)}
    held: dict[int, _Scatter] = {}
    left_out: dict[int, str] = {}
    relative = relative_poses(scene, index, poses)
    while True:
        ready = {(a, b): t for (a, b), t in relative.items() if a in found and b not in found and b not in left_out}
        if not ready:
            break
        made = {pair: _mounting(stack, tuning) for pair, stack in ready.items()}
        a, b = max(sorted(made), key=lambda pair: _rank(*made[pair], tuning))
        average, scatter = made[a, b]
        if why := scatter.why_not(tuning):
            left_out[b] = why
        else:
            found[b], held[b] = average @ found[a], scatter
    for b in sorted(set(range(len(names))) - set(found) - set(left_out)) if len(found) > 1 else ():
        motions = [_motions(scene, index, found, b, poses[0], own) for own in poses[1:]]
        rig_poses, own = max(motions, key=lambda m: len(m[0]), default=(np.zeros(0),) * 2)
        arm = max(float(np.linalg.norm(transforms.centre(t))) for t in found.values())
        place = hand_eye(rig_poses, own, arm, tuning) if len(rig_poses) >= tuning.min_frames + 2 else None
        if place is not None:
            found[b], held[b] = place
    for b in range(len(names)):
        if b not in found:
            left_out.setdefault(b, "no frame shows it together with the others in one model")
    lost = "; ".join(f"{names[b]}: {why}" for b, why in sorted(left_out.items()))
    if not held:
        none = "its extrinsics could not be determined; the images were mapped without the rig"
        return None, f"rig {rig.name}: {none} ({lost})", False
    worst = max(held, key=lambda k: held[k].deg)
    few = [f"{names[k]}: {s.agreeing} of {s.frames} frames" for k, s in sorted(held.items()) if s.few(tuning)]
    said = (
        f"rig {rig.name}: extrinsics of {len(found)} of {len(names)} cameras found by their images and then "
        f"adjusted; largest scatter over frames {held[worst].deg:.2f} deg ({names[worst]}, {held[worst].frames} frames)"
    )
    torn = f"; the model is torn, so the shortest mounting that frames agree on is taken ({', '.join(few)})"
    said += (torn if few else "") + (f"; left out: {lost}" if lost else "")
    sensors = tuple(replace(s, sensor_from_rig=found.get(k)) for k, s in enumerate(rig.sensors))
    return replace(rig, sensors=sensors, fixed=False, nominal=True, derived=True), said, bool(few)


def _motions(
    scene: Scene, index: int, found: Mapping[int, np.ndarray], sensor: int, poses: np.ndarray, own: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """(K, 4, 4) rig_from_world of the frames of a rig in one model, by their sensors whose extrinsics are found, and
    sensor_from_world of another sensor at these frames in another model."""
    of_rig = np.flatnonzero(scene.rig[scene.frame] == index)
    there = {int(scene.frame[k]): k for k in of_rig if scene.sensor[k] == sensor and np.isfinite(own[k]).all()}
    known = [k for k in of_rig if int(scene.sensor[k]) in found and np.isfinite(poses[k]).all()]
    placed = {int(scene.frame[k]): transforms.invert(found[int(scene.sensor[k])]) @ poses[k] for k in known}
    both = sorted(there.keys() & placed.keys())
    both = [both[k] for k in evenly(len(both), 300)]  # frames tell it as well as thousands do
    rows = [placed[f] for f in both], [own[there[f]] for f in both]
    return tuple(np.array(r).reshape(-1, 4, 4) for r in rows)  # type: ignore[return-value]


def hand_eye(rig: np.ndarray, own: np.ndarray, arm: float, tuning: DeriveTuning) -> tuple[np.ndarray, _Scatter] | None:
    """Extrinsics (4, 4) of a sensor by K frames' poses rig_from_world (K, 4, 4) in one model and sensor_from_world in
    another, whose similarity to the first is unknown too; None where the motion does not determine its rotation, or
    contradicts a rigid mounting (robot-world calibration: Dornaika and Horaud 1998).

    Least squares over both, on the frames whose places agree: a camera that looks up has poses of its own only where it
    sees more than sky. A path that is nearly straight determines the roll of the similarity by rotations only, so
    several rolls are tried. What the motion leaves open of the lever arm, it has from its prior: zero, with the sigma
    ``arm``, how far the other sensors are from each other.
    """
    reach = rms_length(transforms.centre(rig) - transforms.centre(rig).mean(axis=0))
    if not reach > 1e-6 * np.abs(transforms.centre(rig)).max():  # it stands still
        return None
    noise, arm = 0.02 * reach, max(arm, 1e-3 * reach)
    start, near = robust_umeyama(transforms.centre(own), transforms.centre(rig), noise)
    rig, own = rig[near], own[near]
    if len(rig) < tuning.min_frames + 2:  # three frames give all that is unknown, two more confirm it
        return None
    centres, theirs = transforms.centre(rig), transforms.centre(own)
    middle = centres.mean(axis=0)
    axis = np.linalg.svd(centres - middle, full_matrices=False)[2][0]

    def mounted(x: np.ndarray, near: Similarity) -> tuple[np.ndarray, Similarity]:
        similarity = near.stepped(x[:7], middle)
        turns = own[:, :3, :3] @ similarity.rotation.T @ np.swapaxes(rig[:, :3, :3], 1, 2)
        return turns, similarity

    def residuals(x: np.ndarray, near: Similarity, turn: np.ndarray) -> np.ndarray:
        turns, similarity = mounted(x, near)
        off = Rotation.from_matrix(turns @ turn.T @ Rotation.from_rotvec(x[7:10]).as_matrix().T).as_rotvec()
        lever = np.einsum("kji,j->ki", rig[:, :3, :3], x[10:])
        apart = similarity(theirs) - centres - lever
        weak = np.r_[1e-3 * reach * x[7:10], noise / arm * x[10:]]  # what the motion leaves open stays, and is unsure
        return np.r_[(reach * off).ravel(), apart.ravel(), weak]

    best = None
    for roll in np.linspace(0, 2 * np.pi, 12, endpoint=False):  # starts
        turned = Rotation.from_rotvec(roll * axis).as_matrix()
        near = Similarity(start.scale, turned @ start.rotation, turned @ (start.translation - middle) + middle)
        turn = l1_mean_rotation(mounted(np.zeros(13), near)[0])
        fit = scipy.optimize.least_squares(residuals, np.zeros(13), loss="cauchy", f_scale=noise, args=(near, turn))
        if best is None or fit.cost < best[0].cost:
            best = fit, near, turn
    fit, near, turn = best  # type: ignore[misc]
    turns, _ = mounted(fit.x, near)
    rotation = Rotation.from_rotvec(fit.x[7:10]).as_matrix() @ turn
    angles = transforms.angle_deg(turns, rotation)
    scatter = _Scatter(len(rig), float(np.median(angles)), float(np.mean(angles > tuning.outlier_deg)))
    freedom = 6 * len(rig) - 13
    covariance = np.linalg.inv(fit.jac.T @ fit.jac) * 2 * fit.cost / freedom
    unsure = np.degrees(np.sqrt(np.diag(covariance)[7:10].max()))
    if scatter.few(tuning) or scatter.why_not(tuning) or not unsure < tuning.max_scatter_deg:
        return None
    return transforms.rigid(rotation, -rotation @ fit.x[10:]), scatter


def _rank(mounting: np.ndarray, scatter: _Scatter, tuning: DeriveTuning) -> tuple[bool, bool, float]:
    """Order of mountings: those of most frames by their number, then those of few frames, the shortest first."""
    few = scatter.few(tuning)
    return not scatter.why_not(tuning), not few, -float(np.linalg.norm(mounting[:3, 3])) if few else scatter.frames


def _mounting(stack: np.ndarray, tuning: DeriveTuning) -> tuple[np.ndarray, _Scatter]:
    """The mounting (4, 4) on which the relative poses (K, 4, 4) of frames agree, and their scatter.

    Where most frames agree: the L1 mean of their rotations, the median of their translations. Else the cameras are not
    rigid, or the model is torn. A model torn at a wall that repeats puts the cameras of a frame far from each other,
    where a rig is small: of the mountings on which several frames agree, the shortest is taken.
    """
    turns, length = stack[:, :3, :3], np.linalg.norm(stack[:, :3, 3], axis=1)
    rotation = l1_mean_rotation(turns)
    close = transforms.angle_deg(turns, rotation) < tuning.outlier_deg
    used = close if close.any() else np.ones(len(stack), bool)
    if np.mean(~close) > tuning.max_outliers:
        alike = transforms.angle_deg(turns, turns[evenly(len(stack), 300), None]) < tuning.outlier_deg
        alike = alike[alike.sum(axis=1) >= tuning.min_frames]
        near = [one & (length <= np.median(length[one])) for one in alike]
        if near:
            best = int(np.argmin([np.median(length[one]) for one in near]))
            close, used = alike[best], near[best]
            rotation = l1_mean_rotation(turns[used])
    angles = transforms.angle_deg(turns, rotation)
    scatter = _Scatter(len(stack), float(np.median(angles[close] if close.any() else angles)), float(np.mean(~close)))
    return transforms.rigid(rotation, np.median(stack[used, :3, 3], axis=0)), scatter


def unsupported_sensors(
    scene: Scene, graph: ViewGraph, modes: Mapping[int, str], tuning: SupportTuning
) -> tuple[int, ...]:
    """Keys of sensors of refined rigs most of whose images have fewer than two verified pairs; never a reference.

    A camera that looks at sky and bridge decks has few true ties and some false ones. Refined with the rig it
    diverges: on ``canal`` the up camera's focal length by a factor of four and its place by 24 m, and no residual
    shows it. So its place in the rig stays as given.
    """
    out = []
    for index, (first, rig) in enumerate(scene.keyed_rigs):
        for key in range(first + 1, first + len(rig.sensors)) if modes.get(index) == "refined" else ():
            degree = graph.degree[scene.sensor_key == key]
            if len(degree) and np.mean(degree >= tuning.min_ties) < tuning.min_share:
                out.append(key)
    return tuple(out)


def ties_of(scene: Scene, graph: ViewGraph, sensors: tuple[int, ...]) -> tuple[tuple[int, int], ...]:
    """Verified pairs (scene indices) with an image of these sensors."""
    of = np.isin(scene.sensor_key, sensors)
    rows = of[graph.pairs[:, 0]] | of[graph.pairs[:, 1]]
    return tuple((int(a), int(b)) for a, b in graph.pairs[rows])


def place_as_given(model: pycolmap.Reconstruction, scene: Scene, sensors: tuple[int, ...], tuning: ScaleTuning) -> None:
    """Set the extrinsics of sensors without observations as given, lengths in the model's units."""
    scale = units_per_metre(model, scene, tuning)
    for index, (first, rig) in enumerate(scene.keyed_rigs):
        held = model.rigs[index + 1] if index + 1 in model.rigs else None
        for place, sensor in enumerate(rig.sensors):
            identity = sensor_id(first + place + 1)
            if first + place in sensors and place and held is not None and held.has_sensor_from_rig(identity):
                extrinsics = np.array(sensor.sensor_from_rig, float)
                extrinsics[:3, 3] *= scale
                held.set_sensor_from_rig(identity, rigid3d(extrinsics))


def units_per_metre(model: pycolmap.Reconstruction, scene: Scene, tuning: ScaleTuning) -> float:
    """Model units per metre: from prior positions far enough apart, else from the median baseline
    of the rig, else 1."""
    centre, first = np.full((scene.frames, 3), np.nan), scene.sensor == 0
    centre[scene.frame[first]] = transforms.centre(image_poses(model, scene)[first])
    apart, own, noise = distances(scene, centre, tuning)
    far = apart > LIMIT * noise
    if far.sum() >= tuning.least_distances:
        return float(np.median(own[far] / apart[far]))
    return _by_baselines(model, scene)


def _by_baselines(model: pycolmap.Reconstruction, scene: Scene) -> float:
    ratios = []
    for index, (first, rig) in enumerate(scene.keyed_rigs):
        row = model.rigs[index + 1] if index + 1 in model.rigs else None
        for sensor, pose in row.non_ref_sensors.items() if row else ():
            given = rig.sensors[sensor.id - 1 - first].sensor_from_rig
            lever = 0.0 if given is None else float(np.linalg.norm(transforms.centre(given)))
            ratios += [float(np.linalg.norm(pose.translation)) / lever] if lever and pose is not None else []
    return float(np.median(ratios)) if ratios else 1.0
