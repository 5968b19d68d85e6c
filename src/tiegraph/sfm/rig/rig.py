"""The rig in the mapping: how it is used, extrinsics derived from a model without it, sensors that have too few ties,
and how far a model moved them."""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pycolmap
import scipy
from scipy.spatial.transform import Rotation

from tiegraph.errors import SettingsError
from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import l1_mean_rotation
from tiegraph.scene.colmapmodel import image_poses, rigid3d, sensor_id
from tiegraph.scene.evidence import LIMIT
from tiegraph.scene.rig import Rig, rays_or_axis
from tiegraph.scene.scene import Scene
from tiegraph.scene.sorting import evenly
from tiegraph.sfm.model import distances, relative_poses
from tiegraph.sfm.tuning.placement import ScaleTuning
from tiegraph.sfm.tuning.rig import DeriveTuning, RigTuning, SupportTuning
from tiegraph.sfm.verified import VerifiedMatches, ViewGraph


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
    scene: Scene, index: int, poses: Sequence[np.ndarray], matched: Callable[[], VerifiedMatches], tuning: DeriveTuning
) -> tuple[Rig | None, str, bool]:
    """Extrinsics of rig ``index`` by robust averages over the frames of models made without it, of which ``poses`` are
    those (N, 4, 4) of their images; None if no two sensors are rigid. A remark; whether the models seem to be torn.

    R: Weiszfeld's L1 mean of R_c R_ref^T; t: median, each model scaled to the first by the median baseline
    (ALGORITHMS section 4). A sensor never seen together with the reference is connected through one that was, and one
    that no frame shows together with any, such as a camera that looks up, by the verified matches of its own images.
    Lengths are in units of the first model. The MAD of each sensor is the test of rigidity and synchronisation; a
    sensor that fails it is left out.
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
        rays = _rays(scene, index, found, b, poses[0], matched())
        place = None if rays is None else mounted_by_pairs(*rays, tuning)
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


def _rays(
    scene: Scene, index: int, found: Mapping[int, np.ndarray], sensor: int, poses: np.ndarray, verified: VerifiedMatches
) -> tuple[np.ndarray, np.ndarray, int] | None:
    """Matches between a sensor's images at frames that a model places by the sensors whose extrinsics are found: the
    pose of the rig at the second frame from that at the first (K, 4, 4), the two rays (2, K, 3) in the sensor, and the
    number of frames; None if there are none."""
    of_rig = np.flatnonzero(scene.rig[scene.frame] == index)
    known = [k for k in of_rig if int(scene.sensor[k]) in found and np.isfinite(poses[k]).all()]
    rig = {int(scene.frame[k]): transforms.invert(found[int(scene.sensor[k])]) @ poses[k] for k in known}
    arm = max(float(np.linalg.norm(transforms.centre(t))) for t in found.values())
    camera = scene.rigs[index].sensors[sensor].camera
    motion, rays, frames = [], [], set()
    for (i, j), matches in zip(verified.pairs, verified.matches):
        first, second = (int(scene.frame[k]) for k in (i, j))
        own = scene.rig[first] == index and scene.sensor[i] == scene.sensor[j] == sensor
        if camera is None or not own or first not in rig or second not in rig:
            continue
        moved = rig[second] @ transforms.invert(rig[first])
        if np.linalg.norm(moved[:3, 3]) > arm:  # else the lever arm, which is not known, counts
            some = matches[evenly(len(matches), 30)]
            rays.append(np.stack([rays_or_axis(camera, verified.xy[int(k)][some[:, e]]) for e, k in enumerate((i, j))]))
            motion += [moved] * len(some)
            frames |= {first, second}
    if not rays:
        return None
    return np.array(motion), np.concatenate(rays, axis=1), len(frames)


def mounted_by_pairs(
    motion: np.ndarray, rays: np.ndarray, frames: int, tuning: DeriveTuning
) -> tuple[np.ndarray, _Scatter] | None:
    """Extrinsics (4, 4) of a sensor, at the place of its rig, by K matches of its images: the pose of the rig at the
    second frame from that at the first (K, 4, 4) and the rays (2, K, 3) in the sensor, from so many frames. None where
    they do not determine one rotation, as on a straight path, or contradict a rigid mounting.

    The rotation is that with which the rays meet (epipolar constraint), by the best of many starts.
    """
    turn, base = motion[:, :3, :3], motion[:, :3, 3] / np.linalg.norm(motion[:, :3, 3], axis=1, keepdims=True)

    def off(x: np.ndarray, use: np.ndarray | slice = slice(None)) -> np.ndarray:
        """Angles (K,) between the second rays and the planes of the first rays and the bases, radians."""
        a, b = rays[:, use] @ Rotation.from_rotvec(x).as_matrix()
        plane = np.cross(base[use], np.einsum("kij,kj->ki", turn[use], a))
        length = np.linalg.norm(plane, axis=1)  # along the base there is no plane
        return np.sum(b * plane, axis=1) / np.maximum(length, 0.05)

    if frames < tuning.min_frames + 2:  # three frames give all that is unknown, two more confirm it
        return None
    near, some = np.radians(tuning.max_scatter_deg), evenly(len(base), 300)
    starts = Rotation.random(2000, random_state=0).as_rotvec()
    rough = [float(np.mean(np.minimum(np.abs(off(x, some)), 10 * near))) for x in starts]
    fits = [scipy.optimize.least_squares(off, x, loss="cauchy", f_scale=near) for x in starts[np.argsort(rough)[:12]]]
    best = min(fits, key=lambda f: f.cost)
    rotation = Rotation.from_rotvec(best.x)
    others = [f.cost for f in fits if (Rotation.from_rotvec(f.x) * rotation.inv()).magnitude() > 10 * near]
    covariance = np.linalg.pinv(best.jac.T @ best.jac) * 2 * best.cost / max(1, len(base) - 3)
    angles = np.degrees(np.abs(off(best.x)))
    scatter = _Scatter(frames, float(np.median(angles)), float(np.mean(angles > tuning.outlier_deg)))
    unsure = np.sqrt(covariance.diagonal().max()) > near or min(others, default=np.inf) < 2 * best.cost
    if unsure or scatter.few(tuning) or scatter.why_not(tuning):
        return None
    return transforms.rigid(rotation.as_matrix(), np.zeros(3)), scatter


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
