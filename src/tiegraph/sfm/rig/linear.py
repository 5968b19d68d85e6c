"""The rig's unknowns determined from the images of a model: times, places, rotations and lenses together, linearised.

A camera that fires late is ahead by its delay times the speed; a camera mounted differently is off by a constant; a
lens of another focal length moves points as a camera ahead does. At constant speed some of these cannot be separated.
So none is estimated alone: the normal equations of the bundle adjustment hold all of them; frames and points are
eliminated, and with them the size of the rig, which is that of the path. Prior knowledge enters as priors (Triggs et
al. 2000, section 6). A hypothesis is a choice of priors, and its cost is a solution of the remaining small system.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass

import numpy as np
import pycolmap
from scipy import sparse
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms
from tiegraph.scene.colmapmodel import model_rigs, registered_images
from tiegraph.scene.scene import Scene
from tiegraph.sfm.adjustment.jacobians import Layout, of_lens, of_mounting, of_time
from tiegraph.sfm.covariance import Linearised
from tiegraph.sfm.motion import Motion
from tiegraph.sfm.tuning import Tuning

_ANY = 1e-9  # of the stiffness: an undetermined unknown gets a huge sigma instead of a singular matrix

Key = tuple[str, int, int]  # what ("place", "turn", "time", "lens"), sensor of the rig, axis or parameter


@dataclass(frozen=True)
class RigSystem:
    """Normal equations (K, K) of a rig's unknowns with frames and points eliminated; the present state of the model
    is zero.

    ``keys`` name each unknown: place (m) and rotation (rad) of a sensor in the rig frame relative to the file, its
    time (s; frame intervals without times) after the reference, lens: parameters of its camera relative to the model.
    A solution is one robust Gauss-Newton step.
    """

    keys: tuple[Key, ...]
    curvature: np.ndarray  # (K, K) of the robust cost, px2
    gradient: np.ndarray  # (K,)
    scatter: np.ndarray  # (K, K) sum of the points' gradients squared: the sandwich's inner part
    variance: float  # of an image coordinate, px2
    observations: int
    metres_per_unit: float  # conversion of model lengths to those of the file
    speed: float  # largest, m/s (or a frame interval)
    damped: float  # factor for a step far from the minimum, where the robust cost is less curved
    timed: bool

    def where(self, what: str) -> np.ndarray:
        """Indices of the unknowns of one kind."""
        return np.array([k for k, key in enumerate(self.keys) if key[0] == what], int)

    def mounting(self, sensor: int) -> np.ndarray:
        """(6,) indices of a camera's place and rotation."""
        at = [k for what in ("place", "turn") for k in self.where(what) if self.keys[k][1] == sensor]
        return np.array(at, int)

    def solve(self, sigma: np.ndarray) -> RigSolution:
        """The unknowns with prior value zero and prior ``sigma`` (K,): 0 = held, inf = free."""
        free = np.flatnonzero(sigma > 0)
        prior = self.variance * np.diag(1 / np.square(sigma[free]))
        normal = self.curvature[np.ix_(free, free)] + prior
        stiff = np.sqrt(np.maximum(np.diag(normal), 1e-300))
        scaled = normal / stiff[:, None] / stiff[None, :] + _ANY * np.eye(len(free))
        inverse = np.linalg.inv(scaled) / stiff[:, None] / stiff[None, :]
        value = np.zeros(len(self.keys))
        value[free] = -inverse @ self.gradient[free]
        middle = self.scatter[np.ix_(free, free)] + self.variance * prior
        wide = np.zeros((2, len(self.keys), len(self.keys)))
        wide[0][np.ix_(free, free)] = inverse @ middle @ inverse
        wide[1][np.ix_(free, free)] = self.variance * inverse
        gain = float(self.gradient[free] @ inverse @ self.gradient[free])
        return RigSolution(value=value, covariance=wide[0], formal=wide[1], gain=gain / self.variance)


@dataclass(frozen=True)
class RigSolution:
    """Values (K,), covariance (K, K) with the points' actual scatter, and covariance for independent errors;
    ``gain``: twice the reduction of the cost relative to all unknowns zero, over the variance of an observation (a
    chi-square)."""

    value: np.ndarray
    covariance: np.ndarray
    formal: np.ndarray
    gain: float

    def sigma(self) -> np.ndarray:
        """(K,)"""
        return np.sqrt(np.clip(np.diag(self.covariance), 0, None))


def rig_system(
    model: pycolmap.Reconstruction,
    scene: Scene,
    index: int,
    lenses: Collection[int],
    metres_per_unit: float,
    tuning: Tuning,
) -> RigSystem | None:
    """The system of rig ``index`` of a model, with unknowns relative to the scene's extrinsics; None if there are too
    few observations. ``lenses``: ids of cameras whose parameters are unknowns too.
    """
    sensors, first = scene.rigs[index].sensors, scene.first_sensor(index) + 1
    part = _stretch(model, scene, index, tuning.rig.most_frames)
    try:
        found = Linearised(part, Layout(part, False, False), {}, tuning, tuning.rig.most_points)
    except ValueError:
        return None
    seen, motion = found.weighed.seen, Motion(part, scene, tuning.shutter.max_gap_s)
    keys: list[Key] = []
    columns = []
    for k in range(len(sensors)):
        own = of_mounting(part, seen, first + k)
        columns.append(own @ sparse.diags(np.repeat([1 / metres_per_unit, 1.0], 3)))
        keys += [(what, k, axis) for what in ("place", "turn") for axis in range(3)]
        if k:
            columns.append(of_time(seen, motion, np.flatnonzero(seen.camera == first + k)))
            keys.append(("time", k, 0))
        if first + k in lenses:
            columns.append(of_lens(part, seen, first + k))
            keys += [("lens", k, axis) for axis in range(columns[-1].shape[1])]
    told = found.weighed.score(sparse.hstack(columns).tocsr())
    off, share = deviations(part, scene, index, metres_per_unit), found.share
    there = np.array([off.get(key, 0.0) for key in keys])
    rates = [np.linalg.norm(motion.rate(i)[:3]) for i in part.reg_image_ids()]
    return RigSystem(
        keys=tuple(keys),
        curvature=told.information / share,
        gradient=(told.score - told.information @ there) / share,
        scatter=told.noise / share,
        variance=found.variance,
        observations=round(len(seen.residual) / share),
        metres_per_unit=metres_per_unit,
        speed=metres_per_unit * float(max(rates)),
        damped=float(found.weights[1].sum() / found.weights[0].sum()),
        timed=motion.timed,
    )


def deviations(model: pycolmap.Reconstruction, scene: Scene, index: int, metres_per_unit: float) -> dict[Key, float]:
    """Deviations of the cameras of the model's rig from the scene's, metres and radians along the axes of the rig."""
    out: dict[Key, float] = {}
    for k, (own, given) in enumerate(zip(model_rigs(model, scene)[index].sensors, scene.rigs[index].sensors)):
        if k and own.sensor_from_rig is not None and given.sensor_from_rig is not None:
            there, told = transforms.invert(own.sensor_from_rig), transforms.invert(given.sensor_from_rig)
            place = metres_per_unit * there[:3, 3] - told[:3, 3]
            turn = Rotation.from_matrix(there[:3, :3] @ told[:3, :3].T).as_rotvec()
            each = zip(("place", "turn"), (place, turn))
            out |= {(what, k, axis): float(v[axis]) for what, v in each for axis in range(3)}
    return out


def _stretch(model: pycolmap.Reconstruction, scene: Scene, index: int, most: int) -> pycolmap.Reconstruction:
    """The model with the images of this rig only, and at most ``most`` consecutive frames: those with most
    observations."""
    out = pycolmap.Reconstruction(model)
    seen, home = np.zeros(scene.frames), {}
    for k, image in registered_images(out, scene):
        if scene.rig[scene.frame[k]] == index:
            home[image.frame_id] = int(scene.frame[k])
            seen[scene.frame[k]] += image.num_points3D
    order = np.lexsort((scene.sequence_index, scene.sequence))
    order = order[seen[order] > 0]
    if len(order) > most:
        first = int(np.argmax(np.convolve(seen[order], np.ones(most), "valid")))
        order = order[first : first + most]
    kept = set(order.tolist())
    for frame in out.reg_frame_ids():
        if home.get(frame, -1) not in kept:
            out.deregister_frame(frame)
    return out
