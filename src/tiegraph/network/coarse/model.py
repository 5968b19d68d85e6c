"""The coarse model of a survey or of a block, made of previews: poses, cameras, points, and their observations.

Its points are the intersections of the rays of its tracks. The mapper of a coarse model uses the longest tracks only,
which are a seventh of all. With the poses known, the other tracks need no adjustment: each point is where its rays
are closest to each other.
"""

import json
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.network.coarse.proxy import Proxy, observed_proxy
from tiegraph.network.coarse.visible import Overlap, shared_surface, visible_points
from tiegraph.network.tuning import CoarseTuning, CourseTuning
from tiegraph.scene.pairs import PreviewMatches, Visibility
from tiegraph.scene.rig import (
    Rig,
    calibrated,
    camera_from_dict,
    camera_to_dict,
    pixel_rays,
    rays_or_axis,
    rig_from_dict,
    rig_to_dict,
)


@dataclass(frozen=True)
class CoarseModel:
    """A model of the survey in its own frame and units.

    cam_from_world (N, 4, 4), NaN = not in the model; cameras: one for each image; points (P, 3); image (M,), point
    (M,): observations; rigs: with the extrinsics and cameras of the model.
    """

    cam_from_world: np.ndarray
    cameras: tuple[pycolmap.Camera, ...]
    points: np.ndarray
    image: np.ndarray
    point: np.ndarray
    rigs: tuple[Rig, ...]

    def placed(self) -> np.ndarray:
        """(N,) bool: images in the model."""
        return np.all(np.isfinite(self.cam_from_world), axis=(1, 2))

    def reach(self) -> np.ndarray:
        """(N, 2) distances to the nearest and farthest points that an image sees (percentiles); NaN without points."""
        centre = transforms.centre(self.cam_from_world)
        distance = np.linalg.norm(self.points[self.point] - centre[self.image], axis=1)
        out = np.full((len(self.cam_from_world), 2), np.nan)
        order = np.argsort(self.image, kind="stable")
        ends = np.searchsorted(self.image[order], np.arange(len(out) + 1))
        for k in np.flatnonzero(np.diff(ends) >= 10):
            own = order[ends[k] : ends[k + 1]]
            out[k] = np.percentile(distance[own], (5.0, 95.0))
        return out

    def proxy(self) -> Proxy:
        """Its points as the surface."""
        return observed_proxy(self.points, self.image, self.point, self.cam_from_world)

    def overlap(self, max_angle_deg: float, tuning: CoarseTuning) -> Overlap:
        """Predicted shared surface of all pairs of images whose rays to it meet at no more than this angle."""
        proxy = self.proxy()
        return shared_surface(self.cam_from_world, self.cameras, proxy, tuning.visible, max_angle_deg)

    def visibility(self, tuning: CoarseTuning) -> Visibility:
        """The points that each image should see."""
        return visible_points(self.cam_from_world, self.cameras, self.proxy(), tuning.visible)

    def to_npz(self) -> dict[str, np.ndarray]:
        """Arrays for ``np.savez``: all of it, exactly; cameras and rigs as JSON."""
        words = [json.dumps(camera_to_dict(c)) for c in self.cameras]
        kinds = list(dict.fromkeys(words))
        return {
            "cam_from_world": self.cam_from_world,
            "points": self.points,
            "image": self.image,
            "point": self.point,
            "cameras": np.array(kinds, str),
            "camera": np.array([kinds.index(w) for w in words], np.int32),
            "rigs": np.array([json.dumps(rig_to_dict(r)) for r in self.rigs], str),
        }

    @staticmethod
    def from_npz(data: Mapping[str, np.ndarray]) -> "CoarseModel":
        """Inverse of ``to_npz``."""
        kinds = [camera_from_dict(json.loads(str(c))) for c in data["cameras"]]
        rigs = tuple(rig_from_dict(json.loads(str(r))) for r in data["rigs"])
        cameras = tuple(kinds[k] for k in data["camera"])
        return CoarseModel(
            cam_from_world=data["cam_from_world"],
            cameras=cameras,
            points=data["points"],
            image=data["image"],
            point=data["point"],
            rigs=rigs,
        )


def with_surface(
    model: CoarseModel, ties: PreviewMatches, features: Callable[[int], np.ndarray], tuning: CourseTuning
) -> CoarseModel:
    """The model with the points of all tracks that ``ties`` form between its images.

    ``features``: pixels (K, 2) of an image's preview. The worst rays of a point are left out one after another, at
    most three, while they miss it by more than ``tolerance_deg``; the point needs two other rays that far apart.
    """
    placed = model.placed()
    track, image, feature = ties.where(placed[ties.i] & placed[ties.j]).observations()
    centre = transforms.centre(model.cam_from_world)[image]
    towards = np.zeros((len(image), 3))
    for k in np.unique(image):
        own = image == k
        towards[own] = pixel_rays(model.cameras[k], features(int(k))[feature[own]]) @ model.cam_from_world[k, :3, :3]
    # (K,) bool: observations of tracks without a repeated image; a wrong match has joined two tracks that repeat one
    order = np.lexsort((image, track))
    twice = (np.diff(track[order]) == 0) & (np.diff(image[order]) == 0)
    use = np.isfinite(towards).all(axis=1) & ~np.isin(track, track[order[1:][twice]])
    points, off = np.zeros((0, 3)), np.zeros(len(track))
    for _ in range(4):  # a point with more than three wrong rays is dropped
        off, most = np.where(use, off, 0.0), np.zeros(int(track.max(initial=-1)) + 1)
        np.maximum.at(most, track, off)
        use &= (off <= tuning.tolerance_deg) | (off < most[track])  # not the worst of a track
        use &= _held(track, towards, use, tuning.tolerance_deg)[track]
        points = _nearest(track, centre, np.where(use[:, None], towards, np.nan))
        # (K,) angle between the direction to a point and a ray
        way = points[track] - centre
        along = np.einsum("kc,kc->k", way, towards) / np.maximum(np.linalg.norm(way, axis=1), 1e-12)
        off = np.degrees(np.arccos(np.clip(along, -1, 1)))
    use &= ~np.isin(track, track[use & (off > tuning.tolerance_deg)])
    kept, point = np.unique(track[use], return_inverse=True)
    return replace(model, points=points[kept], image=image[use], point=point)


def explained(
    model: CoarseModel,
    pairs: tuple[np.ndarray, np.ndarray],
    matches: Callable[[int, int], np.ndarray],
    features: Callable[[int], np.ndarray],
    tuning: CourseTuning,
) -> np.ndarray:
    """(P,) bool: pairs of images i, j (P,), (P,) of which enough matches (K, 2) can be of points where the model has
    its surface. ``features``: pixels (K, 2) of an image's preview.

    A wall that repeats along the path gives false matches with the right rotation and on the right epipolar lines, but
    at impossible distances or behind a camera.
    """
    out, rays, reach = np.zeros(len(pairs[0]), bool), dict[int, np.ndarray](), model.reach()
    known = np.isfinite(reach).all(axis=1)
    if not known.any():
        return out
    reach[~known] = reach[known].min(axis=0)[0] / tuning.margin, reach[known].max(axis=0)[1] * tuning.margin
    for k in np.unique(np.concatenate(pairs)).tolist():
        rays[k] = rays_or_axis(model.cameras[k], features(k))
    for row, (i, j) in enumerate(zip(*(ends.tolist() for ends in pairs))):
        own, j_from_i = matches(i, j), model.cam_from_world[j] @ transforms.invert(model.cam_from_world[i])
        off = _off_course_deg(rays[i][own[:, 0]], rays[j][own[:, 1]], j_from_i, (reach[i], reach[j]), tuning)
        out[row] = np.mean(off <= tuning.tolerance_deg) >= tuning.min_share
    return out


def _off_course_deg(
    a: np.ndarray, b: np.ndarray, b_from_a: np.ndarray, reach: tuple[np.ndarray, np.ndarray], tuning: CourseTuning
) -> np.ndarray:
    """(M,) least angle in degrees between rays b (M, 3) and where the points on rays a (M, 3) would be seen at all
    distances within reach of image a, or the same from b to a: the larger. ``reach``: nearest and farthest points (2,)
    that a and that b see, to which a margin is added."""
    there = _one_way_deg(a, b, b_from_a, reach[0], tuning)
    return np.maximum(there, _one_way_deg(b, a, transforms.invert(b_from_a), reach[1], tuning))


def _one_way_deg(
    a: np.ndarray, b: np.ndarray, b_from_a: np.ndarray, reach: np.ndarray, tuning: CourseTuning
) -> np.ndarray:
    near, far = reach[0] / tuning.margin, reach[1] * tuning.margin
    distance = np.geomspace(near, far, 24)  # straight lines between these
    course = distance[:, None, None] * (a @ b_from_a[:3, :3].T) + b_from_a[:3, 3]  # (24, M, 3)
    course /= np.maximum(np.linalg.norm(course, axis=2, keepdims=True), 1e-12)
    along = np.diff(course, axis=0)
    share = np.sum((b - course[:-1]) * along, axis=2) / np.maximum(np.sum(along**2, axis=2), 1e-18)
    nearest = course[:-1] + np.clip(share, 0, 1)[..., None] * along
    nearest /= np.linalg.norm(nearest, axis=2, keepdims=True)
    cosine = np.max(np.sum(nearest * b, axis=2), axis=0)
    return np.degrees(np.arccos(np.clip(cosine, -1, 1)))


def _nearest(track: np.ndarray, centre: np.ndarray, towards: np.ndarray) -> np.ndarray:
    """(T, 3) points nearest to the rays of each track, arbitrary without rays; NaN rays do not count."""
    use, number = np.isfinite(towards).all(axis=1), int(track.max(initial=-1)) + 1
    across = np.eye(3) - towards[use, :, None] * towards[use, None, :]
    normal, right = np.zeros((number, 3, 3)), np.zeros((number, 3))
    np.add.at(normal, track[use], across)
    np.add.at(right, track[use], np.einsum("kab,kb->ka", across, centre[use]))
    return np.linalg.solve(normal + 1e-9 * np.eye(3), right[:, :, None])[:, :, 0]


def _held(track: np.ndarray, towards: np.ndarray, use: np.ndarray, angle_deg: float) -> np.ndarray:
    """(T,) bool: tracks with two used rays this far apart: one at half that angle from their mean."""
    number = int(track.max(initial=-1)) + 1
    mean = np.zeros((number, 3))
    np.add.at(mean, track[use], towards[use])
    mean /= np.maximum(np.linalg.norm(mean, axis=1, keepdims=True), 1e-12)
    least = np.ones(number)
    np.minimum.at(least, track[use], np.einsum("kc,kc->k", towards[use], mean[track[use]]))
    return least < np.cos(np.radians(angle_deg / 2))


# ---------------------------------------------------------------- its calibration


def turned_deg(given: Sequence[Rig], found: Sequence[Rig]) -> np.ndarray:
    """(S,) rotation of each nominal mounting in the model, 0 for those that are not nominal or unknown."""
    out = []
    for old, new in zip(given, found):
        for a, b in zip(old.sensors, new.sensors):
            known = old.nominal and a.sensor_from_rig is not None and b.sensor_from_rig is not None
            poses = np.stack(
                [np.eye(4) if not known or p is None else p for p in (a.sensor_from_rig, b.sensor_from_rig)]
            )
            out.append(float(transforms.angle_deg(*poses[:, :3, :3])))
    return np.array(out)


def calibrated_rigs(
    given: Sequence[Rig], found: Sequence[Rig], most_focal: float, loose: np.ndarray | None = None
) -> tuple[tuple[Rig, ...], tuple[str, ...]]:
    """Rigs with guessed values replaced by those of the model: cameras that were not calibrated, and the rotations of
    a nominal rig (its centres nearly coincide, so the model cannot determine its lever arms). ``most_focal``: factor
    by which a focal length of a data sheet may be corrected. Sensors that are ``loose`` (S,) in the model stay as
    given."""
    rigs, notes = [], []
    held = iter(np.zeros(sum(len(r.sensors) for r in given), bool) if loose is None else loose)
    for old, new in zip(given, found):
        sensors, turned = [], []
        for a, b in zip(old.sensors, new.sensors):
            if next(held):
                sensors.append(a)
                continue
            camera = _better_camera(a.camera, b.camera, old.fixed, most_focal)
            extrinsics = a.sensor_from_rig
            if old.nominal and extrinsics is not None and b.sensor_from_rig is not None:
                centre = transforms.centre(extrinsics)
                rotation = b.sensor_from_rig[:3, :3]
                turned.append(transforms.angle_deg(extrinsics[:3, :3], rotation))
                extrinsics = transforms.rigid(rotation, -rotation @ centre)
            elif extrinsics is None:
                extrinsics = b.sensor_from_rig
            sensors.append(replace(a, camera=camera, sensor_from_rig=extrinsics))
        derived = old.derived or not old.known()
        rigs.append(replace(old, sensors=tuple(sensors), nominal=old.nominal or derived, derived=derived))
        if turned:
            notes.append(f"rig {old.name}: its cameras are rotated by up to {max(turned):.2f} deg from nominal")
    return tuple(rigs), tuple(notes)


def _better_camera(
    given: pycolmap.Camera | None, found: pycolmap.Camera | None, fixed: bool, most_focal: float
) -> pycolmap.Camera | None:
    """The camera used from here on. A focal length of a data sheet or of EXIF is accurate to some per cent and does not
    include principal point and distortion; at the side of an image that is more than a degree."""
    if given is None or found is None:
        return given
    if not given.has_prior_focal_length:
        return found
    change = found.mean_focal_length() / given.mean_focal_length()
    if fixed or calibrated(given) or not 1 / most_focal < change < most_focal:
        return given
    # It was not calibrated: later stages may adjust it further.
    return camera_from_dict({**(camera_to_dict(found) or {}), "prior_focal": False})
