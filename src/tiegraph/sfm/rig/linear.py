"""What the images of a model say of its rig: times, places, turns, lenses and size at once, linearised at the model.

A camera that fires late stands ahead by its lateness times the speed; a camera mounted otherwise stands off by a
constant; a rig of another size stretches all its levers; a lens of another focal length moves points as a camera ahead
does. At constant speed some of these are one unknown. So none is estimated alone: the normal equations of the bundle
adjustment hold all of them, frames and points are eliminated, and what is known beforehand enters as priors
(Triggs et al. 2000, section 6). A hypothesis is a choice of priors, and its cost a solution of the small system left.
"""

from __future__ import annotations

from collections.abc import Collection
from dataclasses import dataclass, replace

import numpy as np
import pycolmap
from scipy import sparse
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms
from tiegraph.geometry.align import robust_sigma
from tiegraph.geometry.transforms import skew
from tiegraph.scene.colmapmodel import image_poses, registered_images
from tiegraph.scene.scene import Scene
from tiegraph.sfm.adjustment.jacobians import Layout, jacobians, sampled
from tiegraph.sfm.adjustment.normal import at_their_minimum, by_blocks, point_inverse, reduced
from tiegraph.sfm.rig.timeoffset import rig_motion
from tiegraph.sfm.tuning import Tuning

_ANY = 1e-9  # of the stiffness: what nothing tells gets a huge sigma instead of a singular matrix

Key = tuple[str, int, int]  # what ("place", "turn", "time", "size", "lens"), sensor of the rig or -1, axis or parameter


@dataclass(frozen=True)
class RigSystem:
    """Normal equations (K, K) of a rig's unknowns, frames and points eliminated; the model's own state is zero.

    ``keys`` say what each unknown is: place (m) and turn (rad) of a sensor in the rig frame against the file, its
    time (s; frame intervals without times) after the reference, size: levers in the model over those of the file less
    1, lens: parameters of its camera against the model. A solution is that of one robust Gauss-Newton step.
    """

    keys: tuple[Key, ...]
    curvature: np.ndarray  # (K, K) of the robust cost, px2
    gradient: np.ndarray  # (K,)
    scatter: np.ndarray  # (K, K) sum of the points' gradients squared: the sandwich's inner part
    variance: float  # of an image coordinate, px2
    observations: int
    metres_per_unit: float  # by which lengths of the model were brought to those of the file
    speed: float  # largest, m/s (or a frame interval)
    timed: bool

    def where(self, what: str) -> np.ndarray:
        """Indices of the unknowns of one kind."""
        return np.array([k for k, key in enumerate(self.keys) if key[0] == what], int)

    def only(self, what: str) -> RigSystem:
        """The same with the unknowns of one kind alone, the others known exactly."""
        at = self.where(what)
        return replace(
            self, keys=tuple(self.keys[k] for k in at), curvature=self.curvature[np.ix_(at, at)],
            gradient=self.gradient[at], scatter=self.scatter[np.ix_(at, at)],
        )  # fmt: skip

    def solve(self, sigma: np.ndarray) -> RigSolution:
        """The unknowns where each is zero but for ``sigma`` (K,) beforehand: 0 = known exactly, inf = not at all."""
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
    """Values (K,), covariance (K, K) with the points' real scatter, and as if their errors were independent; ``gain``:
    twice the fall of the cost against all unknowns zero, over the variance of an observation (a chi-square)."""

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
    """The system of rig ``index`` of a model in which it is rigid or relaxed; None where too little is there.

    ``lenses``: ids of cameras whose parameters are unknowns too. ``metres_per_unit``: of the model, nearly; the unknown
    "size" says what is left of it. All extrinsics of the rig must be given.
    """
    bounds = tuning.rig.system
    alone = per_camera_frames(model, [k + 1 for k in range(len(scene.rigs))], scene)
    free = _stretch(alone, scene, index, bounds.most_frames)
    images = _Images.of(free, scene, index, metres_per_unit)
    if images is None or images.frames < bounds.least_frames:
        return None
    layout = Layout(free, set(lenses) & {int(k) for k in images.camera}, False)
    several = (k for k, p in free.points3D.items() if p.track.length() > 1)
    points, share = sampled(several, bounds.most_points)
    seen = jacobians(free, layout, points)
    jc, jp, residual = seen.cameras, seen.points, seen.residual
    redundancy = len(residual) - 6 * images.frames - 3 * len(points)
    if redundancy <= 0 or not points:
        return None
    keys, columns, off = images.columns(layout)
    square = np.sum(residual.reshape(-1, 2) ** 2, axis=1)
    first = np.repeat(1 / (1 + square / tuning.adjust.robust_px**2), 2)
    both = sparse.hstack([jc @ columns, sparse.csr_matrix((jc @ off)[:, None])]).tocsr()
    weight = sparse.diags(first)  # the curvature's weights are the gradient's squared
    size, own, of_points = columns.shape[1], (weight @ both).tocsr(), (weight @ jp).tocsr()
    inverse = by_blocks(point_inverse(of_points))
    whole = reduced(own, (of_points.T @ own).tocsr(), inverse, 6 * images.frames).toarray() / share
    weighted = at_their_minimum(jp, first, first * residual, inverse)
    gradient = columns.T @ (jc.T @ weighted) / share - whole[:size, size]
    number = jp.indices[jp.indptr[:-1]] // 3  # an observation touches one point
    gather = sparse.csr_matrix((weighted, (number, np.arange(len(weighted)))), shape=(len(points), len(weighted)))
    of_point = (gather @ jc @ columns).tocsr()
    scatter = (of_point.T @ of_point).toarray() / share
    variance = max(robust_sigma(residual) ** 2 * len(residual) / redundancy, 1e-12)
    kept = np.arange(6 * images.frames, size)
    curvature, gradient, scatter = _eliminated(whole[:size, :size], gradient, scatter, images)
    return RigSystem(
        keys=tuple(keys),
        curvature=curvature[np.ix_(kept, kept)],
        gradient=gradient[kept],
        scatter=scatter[np.ix_(kept, kept)],
        variance=variance,
        observations=round(len(residual) / share),
        metres_per_unit=metres_per_unit,
        speed=images.speed * metres_per_unit,
        timed=images.timed,
    )


def _eliminated(
    normal: np.ndarray, gradient: np.ndarray, scatter: np.ndarray, images: _Images
) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """The same with the frames' poses at their best; position, turn and length of their path are the gauge."""
    count = 6 * images.frames
    gauge = images.gauge()
    stiff = np.sqrt(np.maximum(np.diag(normal)[:count], 1e-300))
    held = np.linalg.qr(gauge / stiff[:, None])[0]
    frames = normal[:count, :count] / stiff[:, None] / stiff[None, :] + held @ held.T + _ANY * np.eye(count)
    cross = normal[:count, count:]
    taken = np.linalg.solve(frames, np.column_stack([cross, gradient[:count]]) / stiff[:, None]) / stiff[:, None]
    down = np.vstack([-taken[:, :-1], np.eye(normal.shape[0] - count)])  # frames as the rest would have them
    rest = slice(count, None)
    out = [normal.copy(), gradient.copy(), scatter.copy()]
    out[0][rest, rest] = normal[rest, rest] - cross.T @ taken[:, :-1]
    out[1][rest] = gradient[rest] - cross.T @ taken[:, -1]
    out[2][rest, rest] = down.T @ scatter @ down
    return out[0], out[1], out[2]


@dataclass(frozen=True)
class _Images:
    """N images of a rig of S sensors in F frames of a released model; lengths in units of the model."""

    frame_id: np.ndarray  # (N,) of the released model
    camera: np.ndarray  # (N,) COLMAP id
    sensor: np.ndarray  # (N,)
    frame: np.ndarray  # (N,) 0..F-1
    pose: np.ndarray  # (N, 4, 4) world_from_cam
    rig_pose: np.ndarray  # (F, 4, 4) world_from_rig
    given: np.ndarray  # (S, 4, 4) rig_from_cam
    velocity: np.ndarray  # (F, 6) place and attitude a second, world
    timed: bool
    metres_per_unit: float

    @property
    def frames(self) -> int:
        return len(self.rig_pose)

    @property
    def speed(self) -> float:
        return float(np.max(np.linalg.norm(self.velocity[:, :3], axis=1), initial=0.0))

    @staticmethod
    def of(model: pycolmap.Reconstruction, scene: Scene, index: int, metres_per_unit: float) -> _Images | None:
        ids = {scene.image_index[model.image(i).name]: i for i in model.reg_image_ids()}
        rows = np.array([k for k in sorted(ids) if scene.rig[scene.frame[k]] == index], int)
        sensors = scene.rigs[index].sensors
        if any(s.sensor_from_rig is None for s in sensors) or not len(rows):
            return None
        given = np.stack([transforms.invert(s.sensor_from_rig) for s in sensors if s.sensor_from_rig is not None])
        given[:, :3, 3] /= metres_per_unit
        poses = transforms.invert(image_poses(model, scene))
        whole = np.full((scene.frames, 4, 4), np.nan)
        for k in sorted(rows, key=lambda k: -int(scene.sensor[k])):  # the reference, if there, comes last
            whole[scene.frame[k]] = poses[k] @ transforms.invert(given[scene.sensor[k]])
        motion = rig_motion(whole, scene)
        used = np.unique(scene.frame[rows])
        turn = whole[used, :3, :3]
        velocity = np.nan_to_num(
            np.concatenate([np.einsum("fij,fj->fi", turn, v[used]) for v in (motion.velocity, motion.rate)], axis=1)
        )
        found = [model.image(ids[k]) for k in rows.tolist()]
        ids_of = np.array([[i.frame_id, i.camera_id] for i in found])
        return _Images(
            frame_id=ids_of[:, 0],
            camera=ids_of[:, 1],
            sensor=scene.sensor[rows].astype(int),
            frame=np.searchsorted(used, scene.frame[rows]),
            pose=poses[rows],
            rig_pose=whole[used],
            given=given,
            velocity=velocity,
            timed=motion.timed,
            metres_per_unit=metres_per_unit,
        )

    def gauge(self) -> np.ndarray:
        """(6F, 7) shift, turn and stretching of the path."""
        local = self.rig_pose[:, :3, 3] - self.rig_pose[:, :3, 3].mean(axis=0)
        out = np.zeros((self.frames, 6, 7))
        out[:, :3, :3] = np.eye(3)
        out[:, :3, 3:6] = -skew(local)
        out[:, 3:, 3:6] = np.eye(3)
        out[:, :3, 6] = local
        return out.reshape(-1, 7) / np.linalg.norm(out.reshape(-1, 7), axis=0)

    def columns(self, layout: Layout) -> tuple[list[Key], sparse.csr_matrix, np.ndarray]:
        """Keys of the unknowns after the frames; (C, U) what all of them do to the layout's unknowns; (C,) how far
        the model's images stand off their rig."""
        count, frames = len(self.given), self.frames
        keys: list[Key] = [(w, s, a) for s in range(count) for w in ("place", "turn") for a in range(3)]
        keys += [("time", s, 0) for s in range(1, count)] + [("size", -1, 0)]
        turn = self.rig_pose[self.frame, :3, :3]
        lever = np.einsum("nij,nj->ni", turn, self.given[self.sensor, :3, 3])
        moved = self.velocity[self.frame].copy()
        moved[:, :3] += np.cross(moved[:, 3:], lever)
        blocks = []  # (first column, (N, 6, width))
        of_frame = np.tile(np.eye(6), (len(turn), 1, 1))
        of_frame[:, :3, 3:] = -skew(lever)
        blocks.append((6 * self.frame, of_frame))
        mount = np.zeros((len(turn), 6, 6))
        mount[:, :3, :3], mount[:, 3:, 3:] = turn / self.metres_per_unit, turn
        blocks.append((6 * frames + 6 * self.sensor, mount))
        late = self.sensor > 0
        blocks.append((6 * frames + 6 * count + self.sensor - 1, np.where(late[:, None], moved, 0.0)[:, :, None]))
        stretched = np.zeros((len(turn), 6, 1))
        stretched[:, :3, 0] = lever
        blocks.append((np.full(len(turn), 6 * frames + 7 * count - 1), stretched))
        row = np.array([layout.frame[k] for k in self.frame_id])
        at, to, values = [], [], []
        for start, block in blocks:
            width = block.shape[2]
            at.append(np.repeat(row[:, None] + np.arange(6), width, axis=1).ravel())
            to.append(np.tile(start[:, None] + np.arange(width), (1, 6)).ravel())
            values.append(block.ravel())
        size = 6 * frames + len(keys)
        for camera, column in layout.camera.items():
            params = len(layout.params[camera])
            sensor = int(self.sensor[np.flatnonzero(self.camera == camera)[0]])
            keys += [("lens", sensor, k) for k in range(params)]
            at.append(column + np.arange(params))
            to.append(size + np.arange(params))
            values.append(np.ones(params))
            size += params
        to[2] = np.maximum(to[2], 0)
        matrix = sparse.csr_matrix(
            (np.concatenate(values), (np.concatenate(at), np.concatenate(to))), shape=(layout.size, size)
        )
        return keys, matrix, self._off(layout, row)

    def _off(self, layout: Layout, row: np.ndarray) -> np.ndarray:
        out = np.zeros(layout.size)
        there = self.rig_pose[self.frame] @ self.given[self.sensor]
        out[(row[:, None] + np.arange(3)).ravel()] = (self.pose[:, :3, 3] - there[:, :3, 3]).ravel()
        turned = self.pose[:, :3, :3] @ np.swapaxes(there[:, :3, :3], 1, 2)
        out[(row[:, None] + np.arange(3, 6)).ravel()] = Rotation.from_matrix(turned).as_rotvec().ravel()
        return out


def _stretch(model: pycolmap.Reconstruction, scene: Scene, index: int, most: int) -> pycolmap.Reconstruction:
    """The released model with the images of this rig only, of at most so many frames that follow each other."""
    seen, home = np.zeros(scene.frames), {}
    for k, image in registered_images(model, scene):
        if scene.rig[scene.frame[k]] == index:
            home[image.frame_id] = int(scene.frame[k])
            seen[scene.frame[k]] += image.num_points3D
    order = np.lexsort((scene.sequence_index, scene.sequence))
    order = order[seen[order] > 0]
    if len(order) > most:
        first = int(np.argmax(np.convolve(seen[order], np.ones(most), "valid")))
        order = order[first : first + most]
    kept = set(order.tolist())
    for frame in model.reg_frame_ids():
        if home.get(frame, -1) not in kept:
            model.deregister_frame(frame)
    return model


def per_camera_frames(
    model: pycolmap.Reconstruction, rig_ids: Collection[int], scene: Scene
) -> pycolmap.Reconstruction:
    """A copy of a model in which the images of these rigs stand alone, where they stood; ids as without a rig."""
    out = pycolmap.Reconstruction(model)
    poses = {i: out.image(i).cam_from_world() for i in out.reg_image_ids()}
    sensors = len(scene.rigs)
    rigs = [_rig_copied(r) for k, r in out.rigs.items() if k not in rig_ids]
    frames = [_copied(f) for f in out.frames.values() if f.rig_id not in rig_ids]
    cameras: set[int] = set()
    for image in out.images.values():
        if out.frame(image.frame_id).rig_id not in rig_ids:
            continue
        cameras.add(image.camera_id)
        frame = pycolmap.Frame(frame_id=scene.frames + image.image_id, rig_id=sensors + image.camera_id)
        frame.add_data_id(image.data_id)
        if image.image_id in poses:
            frame.rig_from_world = poses[image.image_id]
        frames.append(frame)
    for camera in sorted(cameras):
        row = pycolmap.Rig(rig_id=sensors + camera)
        row.add_ref_sensor(pycolmap.sensor_t(pycolmap.SensorType.CAMERA, camera))
        rigs.append(row)
    out.set_rigs_and_frames(rigs, frames)
    return out


def _copied(frame: pycolmap.Frame) -> pycolmap.Frame:
    out = pycolmap.Frame(frame_id=frame.frame_id, rig_id=frame.rig_id)
    for identity in frame.data_ids:
        out.add_data_id(identity)
    if frame.has_pose():
        out.rig_from_world = frame.rig_from_world
    return out


def _rig_copied(rig: pycolmap.Rig) -> pycolmap.Rig:
    out = pycolmap.Rig(rig_id=rig.rig_id)
    out.add_ref_sensor(rig.ref_sensor_id)
    for sensor, pose in rig.non_ref_sensors.items():
        out.add_sensor(sensor, pose)
    return out
