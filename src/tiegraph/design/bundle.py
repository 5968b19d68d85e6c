"""The bundle adjustment that a choice of pairs would make, linearised at the coarse model.

A net of resistances knows nothing of what many images share: the extrinsics of a rig that is adjusted, and intrinsics.
On a rig seven tenths of the position sigma can come from there, and the pairs that tell it (between cameras, at their
borders) are few. Here frames, extrinsics and intrinsics are unknowns as in the mapper, points are eliminated, and the
sigma of the frames' positions is exact but for the tracks, which are foreseen (``foreseen``).

A match of two images that are not joined yet is worth one equation, the epipolar one: of its four coordinates three go
into the point. The gain of a pair is the fall of the mean variance by the equations it brings (A-optimality; Fedorov
1972, Theory of Optimal Experiments; for networks of images Fraser 1984).
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from scipy import sparse

from tiegraph.design.tracks import Candidates, Tracks
from tiegraph.design.tuning import BundleTuning
from tiegraph.geometry import transforms
from tiegraph.scene.matches import PreviewMatches, Visibility
from tiegraph.scene.rig import calibrated
from tiegraph.scene.scene import Scene

_BLOCK = 2000  # pairs looked at together: bounds the memory
_INTRINSICS = 4  # focal length, principal point, radial distortion
_SEED = 0


@dataclass(frozen=True)
class _Columns:
    """Unknowns: six a frame, six a sensor beside the reference of an adjusted rig, four a camera not calibrated.

    ``of_image`` (N, 16) column of each of its parameters, ``size`` = none.
    """

    of_image: np.ndarray
    frame: np.ndarray  # (N,) six each
    frames: int
    size: int

    @staticmethod
    def make(scene: Scene) -> _Columns:
        known = np.array([r.known() for r in scene.rigs], bool)[scene.rig[scene.frame]]
        label = np.where(known, scene.frame, scene.frames + np.arange(len(scene)))
        names, frame = np.unique(label, return_inverse=True)
        size, frames = 6 * len(names), len(names)
        sensor, camera = np.full(len(scene.all_sensors), -1), np.full(len(scene.all_sensors), -1)
        key = 0
        for rig in scene.rigs:
            for place, one in enumerate(rig.sensors):
                if place and rig.known() and not rig.measured():
                    sensor[key], size = size, size + 6
                stated = one.camera is not None and rig.fixed and one.camera.has_prior_focal_length
                believed = stated or (one.camera is not None and calibrated(one.camera))
                if not believed or one.camera_sigma_px:
                    camera[key], size = size, size + _INTRINSICS
                key += 1
        columns = np.full((len(scene), 12 + _INTRINSICS), size)
        columns[:, :6] = 6 * frame[:, None] + np.arange(6)
        for start, count, at in ((6, 6, sensor), (12, _INTRINSICS, camera)):
            own = at[scene.sensor_key]
            columns[own >= 0, start : start + count] = own[own >= 0, None] + np.arange(count)
        return _Columns(of_image=columns, frame=frame, frames=frames, size=size)


class Bundle:
    """Information of chosen candidates about the frames' positions, and what each further candidate would add."""

    def __init__(
        self, candidates: Candidates, ties: PreviewMatches, sights: Visibility, scene: Scene, tuning: BundleTuning
    ) -> None:
        """``ties`` are those of the candidates, features being rows of ``sights``, whose poses are known."""
        self.candidates = self._c = candidates
        self._sights, self._scene, self._tuning = sights, scene, tuning
        self._columns = _Columns.make(scene)
        self._rotation = np.asarray(sights.rotation)
        placed = np.isfinite(sights.centre).all(axis=1)
        self.usable = placed[candidates.i] & placed[candidates.j] & candidates.seen
        self._node_point, self._node_image = self._nodes(ties)
        self._frame_centre, self._rig_axes = self._frames(placed)
        chosen = np.random.default_rng(_SEED).permutation(len(sights.xyz))[: tuning.points]
        mine = np.zeros(len(sights.xyz), bool)
        mine[chosen] = True
        self._share = len(chosen) / max(len(sights.xyz), 1)
        self._node = np.flatnonzero(mine[self._node_point])
        self._jacobian, self._by_point = self._linear(self._node_image[self._node], self._node_point[self._node])
        self._prior, self._unit = self._priors(placed)
        self._equations: np.ndarray | None = None
        self._positions = (6 * np.arange(self._columns.frames)[:, None] + np.arange(3)).ravel()
        self._basis = self._similarities()

    @staticmethod
    def possible(i: np.ndarray, j: np.ndarray, sights: Visibility | None, scene: Scene, tuning: BundleTuning) -> bool:
        """Whether images share unknowns (else the net of resistances chooses as well, and faster), the coarse model
        holds nearly all of them, and the survey is small enough."""
        if sights is None or sights.rotation is None or not len(i):
            return False
        placed = np.isfinite(sights.centre).all(axis=1)
        used = np.unique(np.concatenate([i, j]))
        columns = _Columns.make(scene)
        if placed[used].mean() < tuning.min_placed:
            return False
        return 6 * columns.frames < columns.size <= tuning.max_unknowns

    # ------------------------------------------------------------------------------------------ linear equations

    def _nodes(self, ties: PreviewMatches) -> tuple[np.ndarray, np.ndarray]:
        """Point and image of each node of the candidates."""
        c = self._c
        image = np.repeat(np.arange(c.images), np.diff(c.first))
        point = np.zeros(len(image), np.int64)
        row = ties.find(c.i, c.j)
        count = np.diff(c.start)
        at = np.repeat(np.where(row >= 0, ties.start[row], 0) - c.start[:-1], count) + np.arange(c.start[-1])
        match = ties.matches[at].astype(np.int64)
        start = self._sights.start
        point[c.left] = self._sights.point[start[np.repeat(c.i, count)] + match[:, 0]]
        point[c.right] = self._sights.point[start[np.repeat(c.j, count)] + match[:, 1]]
        return point, image

    def _frames(self, placed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(F', 3) place of each frame: its first image in the model; (N, 3, 3) rotation of each image's rig."""
        frame, scene = self._columns.frame, self._scene
        centre = np.zeros((self._columns.frames, 3))
        own = np.flatnonzero(placed)[::-1]
        centre[frame[own]] = self._sights.centre[own]
        sensors = scene.all_sensors
        turn = np.stack([np.eye(3) if s.sensor_from_rig is None else s.sensor_from_rig[:3, :3] for s in sensors])
        return centre, np.swapaxes(turn[scene.sensor_key], 1, 2) @ self._rotation

    def _linear(self, image: np.ndarray, point: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Jacobians (K, 2, 16) to the unknowns of the image and (K, 2, 3) to the point, in sigmas of a coordinate."""
        scene, rotation = self._scene, self._rotation[image]
        focal = np.array([1.0 if s.camera is None else s.camera.mean_focal_length() for s in scene.all_sensors])
        f = focal[scene.sensor_key][image]
        world = self._sights.xyz[point]
        ray = world - self._sights.centre[image]
        local = np.einsum("kij,kj->ki", rotation, ray)
        (x, y), by_ray = _projected(local, self._tuning)
        zero, one = np.zeros(len(x)), np.ones(len(x))
        by_point = f[:, None, None] * by_ray @ rotation
        rig = self._rig_axes[image]
        by_rig = by_point @ np.swapaxes(rig, 1, 2)
        lever = world - self._frame_centre[self._columns.frame[image]]
        radial = f * (x * x + y * y)
        inner = np.stack([np.stack([x, one, zero, radial * x], 1), np.stack([y, zero, one, radial * y], 1)], 1)
        in_rig = np.einsum("kij,kj->ki", rig, ray)
        parts = [-by_point, by_point @ transforms.skew(lever), -by_rig, by_rig @ transforms.skew(in_rig), inner]
        bad = ~np.isfinite(local).all(axis=1)
        jacobian = np.where(bad[:, None, None], 0.0, np.concatenate(parts, axis=2))
        sigma = self._tuning.sigma_px
        return jacobian / sigma, np.where(bad[:, None, None], 0.0, by_point) / sigma

    def _priors(self, placed: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(U,) weak information that keeps everything finite; (U,) typical size of each unknown."""
        columns, scene = self._columns, self._scene
        centre = self._sights.centre[placed]
        size = max(float(np.sqrt(np.mean(np.sum((centre - centre.mean(axis=0)) ** 2, axis=1)))), 1e-9)
        sigma = np.ones(columns.size + 1)
        for k in range(len(scene)):
            camera = scene.all_sensors[scene.sensor_key[k]].camera
            f = 1.0 if camera is None else camera.mean_focal_length()
            own = columns.of_image[k]
            sigma[own[:3]] = sigma[own[6:9]] = size
            sigma[own[12:15]], sigma[own[15]] = self._tuning.focal_prior * f, self._tuning.distortion_prior
        return 1.0 / sigma[:-1] ** 2, sigma[:-1]

    def _similarities(self) -> np.ndarray:
        """(3F', 7) orthonormal shifts of the positions by shift, turn and scale of the whole."""
        centre = self._frame_centre - self._frame_centre.mean(axis=0)
        size = max(float(np.sqrt(np.mean(np.sum(centre**2, axis=1)))), 1e-9)
        shift = np.tile(np.eye(3), (len(centre), 1))
        turn = -transforms.skew(centre / size).reshape(-1, 3)
        return np.linalg.svd(np.concatenate([shift, turn, (centre / size).reshape(-1, 1)], 1), full_matrices=False)[0]

    def _epipolar(self) -> np.ndarray:
        """(E, K, 32) equations of K matches of each candidate over the unknowns of its two images; worked out once."""
        if self._equations is not None:
            return self._equations
        c, each = self._c, self._tuning.matches
        count = np.diff(c.start)
        out = np.zeros((len(c), each, 2 * (12 + _INTRINSICS)))
        for e in range(0, len(c), _BLOCK):
            rows = np.arange(e, min(e + _BLOCK, len(c)))
            rows = rows[self.usable[rows] & (count[rows] > 0)]
            step = (np.arange(each)[None] + 0.5) / each * count[rows, None]
            at = (c.start[rows, None] + step.astype(int)).ravel()
            left, right = c.left[at], c.right[at]
            a, by_a = self._linear(self._node_image[left], self._node_point[left])
            b, by_b = self._linear(self._node_image[right], self._node_point[right])
            null = _normal4(np.concatenate([by_a, by_b], axis=1))
            both = [np.einsum("ki,kij->kj", null[:, :2], a), np.einsum("ki,kij->kj", null[:, 2:], b)]
            out[rows] = np.concatenate(both, axis=1).reshape(len(rows), each, -1)
        self._equations = out
        return out

    # ------------------------------------------------------------------------------------------ information

    def normal(self, tracks: Tracks) -> np.ndarray:
        """(U, U) reduced normal equations of the tracks joined so far."""
        label = tracks.parent[self._node]
        size = np.bincount(label, minlength=1)
        live = np.flatnonzero(size[label] >= 2)
        track = np.unique(label[live], return_inverse=True)[1]
        count = int(track.max(initial=-1)) + 1
        by_point, jacobian, image = self._by_point[live], self._jacobian[live], self._node_image[self._node[live]]
        inner = np.zeros((max(count, 1), 3, 3))
        np.add.at(inner, track, np.swapaxes(by_point, 1, 2) @ by_point)
        scale = np.maximum(np.trace(inner, axis1=1, axis2=2), 1e-12)[:, None, None]
        inverse = np.linalg.inv(inner + 1e-9 * scale * np.eye(3))
        total = self._columns.size + 1
        out = np.zeros((total, total))
        ends = np.searchsorted(image, np.arange(self._c.images + 1))
        for k in np.flatnonzero(np.diff(ends)):
            columns = self._columns.of_image[k]
            flat = jacobian[ends[k] : ends[k + 1]].reshape(-1, jacobian.shape[2])
            # No index comes twice but that of the row of nothing, which is cut off: no need of the slow add.at.
            out[columns[:, None], columns[None]] += flat.T @ flat
        mixed = np.swapaxes(jacobian, 1, 2) @ by_point  # (K, 16, 3) of observations
        half = np.swapaxes(mixed @ np.linalg.cholesky(inverse)[track], 1, 2)
        row = np.broadcast_to(self._columns.of_image[image][:, None], half.shape)
        column = np.broadcast_to((3 * track[:, None] + np.arange(3))[:, :, None], half.shape)
        cross = sparse.csr_matrix((half.ravel(), (row.ravel(), column.ravel())), shape=(total, 3 * max(count, 1)))
        out -= (cross @ cross.T).toarray()
        return out[:-1, :-1] / self._share

    def add(self, normal: np.ndarray, places: np.ndarray, worth: np.ndarray) -> np.ndarray:
        """The normal equations with those of the candidates at places, each by its ``worth`` (K,) matches."""
        total = self._columns.size + 1
        out = np.zeros((total, total))
        out[:-1, :-1] = normal
        columns = self._columns.of_image
        for e, w in zip(places.tolist(), worth.tolist()):
            own = np.concatenate([columns[self._c.i[e]], columns[self._c.j[e]]])
            rows = self._epipolar()[e]
            np.add.at(out, (own[:, None], own[None]), w / self._tuning.matches * rows.T @ rows)
        return out[:-1, :-1]

    def covariance(self, normal: np.ndarray) -> np.ndarray:
        """(U, U) covariance of all unknowns under the weak priors."""
        scaled = normal * self._unit[:, None] * self._unit[None]
        scaled[np.diag_indices(len(scaled))] += 1.0
        stiff = np.sqrt(np.diag(scaled))
        inverse = np.linalg.inv(scaled / stiff[:, None] / stiff[None])
        unit = self._unit / stiff
        return inverse * unit[:, None] * unit[None]

    def variances(self, covariance: np.ndarray) -> np.ndarray:
        """(F',) variance of each frame's position about the best similarity, in squares of the survey's size."""
        own = covariance[np.ix_(self._positions, self._positions)]
        half = own @ self._basis
        diagonal = np.diag(own) - 2 * np.sum(half * self._basis, axis=1)
        diagonal = diagonal + np.sum((self._basis @ (self._basis.T @ half)) * self._basis, axis=1)
        return diagonal.reshape(-1, 3).sum(axis=1) / self._unit[0] ** 2

    def gains(self, covariance: np.ndarray, places: np.ndarray, worth: np.ndarray) -> np.ndarray:
        """(K,) fall of the variance by each of the candidates at places with ``worth`` (K,) new matches."""
        total, each = self._columns.size + 1, self._tuning.matches
        pos = covariance[:, self._positions]
        pos = pos - (pos @ self._basis) @ self._basis.T
        moved, spread = np.zeros((total, total)), np.zeros((total, total))
        moved[:-1, :-1], spread[:-1, :-1] = pos @ pos.T, covariance
        out = np.zeros(len(places))
        columns = np.concatenate([self._columns.of_image[self._c.i], self._columns.of_image[self._c.j]], axis=1)
        for k in range(0, len(places), _BLOCK):
            e = places[k : k + _BLOCK]
            own, rows = columns[e], self._epipolar()[e] * np.sqrt(worth[k : k + _BLOCK] / each)[:, None, None]
            at = (own[:, :, None], own[:, None])
            inner = np.eye(each) + rows @ spread[at] @ np.swapaxes(rows, 1, 2)
            fall = rows @ moved[at] @ np.swapaxes(rows, 1, 2)
            out[k : k + _BLOCK] = np.trace(np.linalg.solve(inner, fall), axis1=1, axis2=2)
        return out / self._columns.frames


def _projected(local: np.ndarray, tuning: BundleTuning) -> tuple[np.ndarray, np.ndarray]:
    """Image coordinates (2, K), of focal length 1, of rays (K, 3) in the camera, and their derivatives (K, 2, 3).

    A pinhole's; beyond ``wide_cosine`` those of an equidistant fisheye, where a pinhole's run off to infinity.
    """
    length = np.maximum(np.linalg.norm(local, axis=1), 1e-12)
    side = np.linalg.norm(local[:, :2], axis=1)
    wide = local[:, 2] < tuning.wide_cosine * length
    z = np.where(wide, length, local[:, 2])
    x, y, zero, one = local[:, 0] / z, local[:, 1] / z, np.zeros(len(z)), np.ones(len(z))
    pinhole = np.stack([np.stack([one, zero, -x], 1), np.stack([zero, one, -y], 1)], 1) / z[:, None, None]
    around = np.maximum(side, 1e-9 * length)
    e = local[:, :2] / around[:, None]
    angle = np.arctan2(side, local[:, 2])
    outward = np.concatenate([local[:, 2:] * e, -side[:, None]], axis=1) / length[:, None] ** 2
    turned = (np.eye(2) - e[:, :, None] * e[:, None]) * (angle / around)[:, None, None]
    fisheye = e[:, :, None] * outward[:, None] + np.concatenate([turned, np.zeros((len(z), 2, 1))], axis=2)
    xy = np.where(wide[:, None], angle[:, None] * e, np.stack([x, y], 1))
    return xy.T, np.where(wide[:, None, None], fisheye, pinhole)


def _normal4(by_point: np.ndarray) -> np.ndarray:
    """(K, 4) unit vectors at right angles to the three columns of (K, 4, 3)."""
    rows = np.arange(4)
    minors = [np.linalg.det(by_point[:, rows != k]) * (-1) ** k for k in range(4)]
    out = np.stack(minors, axis=1)
    length = np.linalg.norm(out, axis=1, keepdims=True)
    return np.where(length > 0, out / np.maximum(length, 1e-300), 0.0)
