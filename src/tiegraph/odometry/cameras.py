"""The cameras of a rig, and corners in them: found, followed from image to image, and found in the other cameras."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
import pycolmap

from tiegraph.errors import InputError
from tiegraph.geometry import transforms
from tiegraph.scene.colmapmodel import rigid3d
from tiegraph.scene.rig import Rig
from tiegraph.scene.sorting import Columns

FAR_BASELINES = 20.0
"""Distance, in baselines, at which cameras of a rig see about the same."""


@dataclass(frozen=True)
class Cameras:
    """C cameras: names, COLMAP's cameras, sensor_from_rig (C, 4, 4), the reference being one."""

    names: tuple[str, ...]
    models: tuple[pycolmap.Camera, ...]
    sensor_from_rig: np.ndarray

    def __len__(self) -> int:
        return len(self.models)

    @cached_property
    def rig_from_sensor(self) -> np.ndarray:
        """(C, 4, 4)."""
        return transforms.invert(self.sensor_from_rig)

    @cached_property
    def rigid(self) -> list[pycolmap.Rigid3d]:
        """sensor_from_rig as COLMAP's."""
        return [rigid3d(pose) for pose in self.sensor_from_rig]

    def rays(self, camera: np.ndarray, xy: np.ndarray) -> np.ndarray:
        """(K, 3) unit vectors in the rig's frame of pixels (K, 2) of cameras (K,); NaN where a lens has none."""
        out = np.full((len(xy), 3), np.nan)
        for c in np.unique(camera):
            at = camera == c
            plane = np.asarray(self.models[c].cam_from_img(np.asarray(xy[at], float)), float)
            rays = np.column_stack([plane, np.ones(len(plane))]) @ self.rig_from_sensor[c, :3, :3].T
            out[at] = rays / np.linalg.norm(rays, axis=1, keepdims=True)
        return out

    def project(self, camera: np.ndarray, in_rig: np.ndarray) -> np.ndarray:
        """(K, 2) pixels in cameras (K,) of points (K, 3) in the rig's frame; NaN behind a camera."""
        out = np.full((len(in_rig), 2), np.nan)
        for c in np.unique(camera):
            at = camera == c
            inside = transforms.apply(self.sensor_from_rig[c], in_rig[at])
            seen = np.asarray(self.models[c].img_from_cam(inside), float)
            out[at] = np.where(inside[:, 2:] > 0, seen, np.nan)
        return out

    def inside(self, camera: int, xy: np.ndarray, margin_px: float = 0.0) -> np.ndarray:
        """(K,) whether pixels (K, 2) are in a camera's image."""
        model = self.models[camera]
        x, y = xy[:, 0], xy[:, 1]
        with np.errstate(invalid="ignore"):
            return (x >= margin_px) & (y >= margin_px) & (x < model.width - margin_px) & (y < model.height - margin_px)

    def turned(self, a: int, b: int, xy: np.ndarray) -> np.ndarray:
        """(K, 2) where camera b sees what is far away and camera a sees at pixels (K, 2); NaN behind b."""
        rays = self.rays(np.full(len(xy), a), xy) @ self.sensor_from_rig[b, :3, :3].T
        with np.errstate(invalid="ignore"):
            seen = np.asarray(self.models[b].img_from_cam(rays), float)
        return np.where(rays[:, 2:] > 0, seen, np.nan)

    def angle_deg(self, a: int, b: int) -> float:
        """Between the axes of two cameras."""
        return float(transforms.angle_deg(self.sensor_from_rig[a, :3, :3], self.sensor_from_rig[b, :3, :3]))

    @cached_property
    def _maps(self) -> dict[tuple[int, int], np.ndarray]:
        return {}

    def map_of(self, a: int, b: int) -> np.ndarray:
        """(2, H, W) f4: ``turned`` of all pixels of camera a, counted from the middle of the first pixel of b, as
        OpenCV's ``remap`` wants it; -1 outside."""
        if (a, b) not in self._maps:
            width, height = self.models[a].width, self.models[a].height
            x, y = np.meshgrid(np.arange(width) + 0.5, np.arange(height) + 0.5)
            there = self.turned(a, b, np.column_stack([x.ravel(), y.ravel()])) - 0.5
            self._maps[a, b] = np.nan_to_num(there.T, nan=-1.0).reshape(2, height, width).astype(np.float32, order="C")
        return self._maps[a, b]

    def partners(self) -> dict[int, tuple[int, ...]]:
        """Camera with corners of its own -> the others that see some of what it sees. A camera of whose view an earlier
        one sees 60 % has no corners of its own."""
        share = np.array([[self._common(a, b) for b in range(len(self))] for a in range(len(self))])
        own: list[int] = []
        for camera in range(len(self)):
            if not any(share[camera, other] >= 0.6 for other in own):
                own.append(camera)
        return {a: tuple(b for b in range(len(self)) if b != a and share[a, b] > 0) for a in own}

    def _common(self, a: int, b: int) -> float:
        """Share of a grid of pixels of camera a, far away, that b sees."""
        model = self.models[a]
        x, y = np.meshgrid(np.linspace(0, model.width - 1, 12), np.linspace(0, model.height - 1, 12))
        rays = self.rays(np.full(x.size, a), np.column_stack([x.ravel(), y.ravel()]))
        centres = self.rig_from_sensor[[a, b], :3, 3]
        far = FAR_BASELINES * np.linalg.norm(centres[0] - centres[1])
        if far == 0:
            return 0.0
        return float(np.mean(self.inside(b, self.project(np.full(x.size, b), centres[0] + far * rays))))


def cameras_of(rigs: Sequence[Rig]) -> Cameras:
    """The cameras of a survey's one rig.

    Raises InputError for more than one rig, and for a camera whose focal length or place in the rig nobody gave.
    """
    if len(rigs) != 1:
        names = ", ".join(r.name for r in rigs)
        raise InputError(f"odometry follows one rig or camera, but there are {len(rigs)} ({names}): give one's images")
    for sensor in rigs[0].sensors:
        if sensor.sensor_from_rig is None or not np.isfinite(sensor.sensor_from_rig).all():
            raise InputError(
                f"camera {sensor.name}: its place in the rig is not known: odometry holds the rig as it is given; "
                "give --rig rig.toml (`tiegraph calibrate` makes one)"
            )
    models = []
    for sensor in rigs[0].sensors:
        if sensor.camera is None or not sensor.camera.has_prior_focal_length:
            raise InputError(
                f"camera {sensor.name}: its focal length is not known: give --rig rig.toml (`tiegraph calibrate` makes "
                "one) or --camera"
            )
        models.append(sensor.camera)
    poses = np.array([s.sensor_from_rig for s in rigs[0].sensors])
    return Cameras(tuple(s.name for s in rigs[0].sensors), tuple(models), poses)


CORNER_PX = 0.5
"""The middle of the first pixel, from the corner of the image, where COLMAP begins to count; OpenCV begins there."""
_EDGE_PX = 8  # closer to the edge of the image the window of a corner is cut
Images = Mapping[int, np.ndarray]
"""Camera -> its grey image (H, W) u1; a camera whose image is missing is not there."""


@dataclass(frozen=True)
class Tracks(Columns):
    """K corners in one frame: point (K,) its number in the map, camera (K,), xy (K, 2) pixels."""

    point: np.ndarray
    camera: np.ndarray
    xy: np.ndarray

    @staticmethod
    def none() -> "Tracks":
        """No corner."""
        return Tracks(np.zeros(0, int), np.zeros(0, int), np.zeros((0, 2)))

    def plus(self, other: "Tracks") -> "Tracks":
        """These and others."""
        return Tracks.concatenate([self, other])


def followed(before: np.ndarray, after: np.ndarray, xy: np.ndarray, guess: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Where corners (K, 2) of an image are in another (K, 2), from a guess (K, 2); and whether (K,) they were found."""
    if not len(xy):
        return np.zeros((0, 2)), np.zeros(0, bool)
    start, first = (np.array(v[:, None] - CORNER_PX, np.float32) for v in (xy, guess))
    how = {"winSize": (15, 15), "flags": cv2.OPTFLOW_USE_INITIAL_FLOW}  # OpenCV's 21 is slower, and no better on KITTI
    there, found, _ = cv2.calcOpticalFlowPyrLK(before, after, start, first.copy(), maxLevel=4, **how)
    # The way back starts where it should end: a short one, which a level or two will do for.
    back, returned, _ = cv2.calcOpticalFlowPyrLK(after, before, there, start.copy(), maxLevel=1, **how)
    off = np.linalg.norm((back - start)[:, 0], axis=1)
    place = there[:, 0].astype(float) + CORNER_PX
    height, width = after.shape
    inside = (place >= _EDGE_PX).all(axis=1) & (place < (width - _EDGE_PX, height - _EDGE_PX)).all(axis=1)
    return place, (found[:, 0] > 0) & (returned[:, 0] > 0) & (off < 1.0) & inside


def corners(image: np.ndarray, mask: np.ndarray | None, taken: np.ndarray) -> np.ndarray:
    """(N, 2) corners that fill an image up to 400, for more cost time and buy little; away from those it has (K, 2) and
    where the mask (H, W) is not 0."""
    spacing = 0.012 * max(image.shape)
    free = np.zeros(image.shape, np.uint8)
    free[_EDGE_PX:-_EDGE_PX, _EDGE_PX:-_EDGE_PX] = 255
    if mask is not None:
        free[mask == 0] = 0
    for x, y in np.rint(taken - CORNER_PX).astype(int).tolist():
        cv2.circle(free, (x, y), round(spacing), 0, -1)
    wanted = 400 - len(taken)
    if wanted <= 0:
        return np.zeros((0, 2))
    found = cv2.goodFeaturesToTrack(image, wanted, 0.002, spacing, mask=free)
    return np.zeros((0, 2)) if found is None else found[:, 0].astype(float) + CORNER_PX


def in_partners(
    cameras: Cameras, partners: Mapping[int, tuple[int, ...]], images: Images, tracks: Tracks, in_rig: np.ndarray
) -> Tracks:
    """The corners as the other cameras of the rig see them at the same instant; in_rig (K, 3): about where they are."""
    out = Tracks.none()
    for camera, others in partners.items():
        for other in (o for o in others if camera in images and o in images):
            guess = np.full((len(tracks), 2), np.nan)
            at = tracks.camera == camera
            guess[at] = cameras.project(np.full(at.sum(), other), in_rig[at])
            there = at & cameras.inside(other, guess, _EDGE_PX)
            seen, guess = tracks.where(there), guess[there]
            if cameras.angle_deg(camera, other) < 5.0:
                place, found = followed(images[camera], images[other], seen.xy, guess)
            else:
                place, found = _followed_turned(cameras, (camera, other), images, seen.xy, guess)
            found &= _off_plane_px(cameras, camera, other, seen.xy, place) < 1.0
            out = out.plus(Tracks(seen.point[found], np.full(found.sum(), other), place[found]))
    return out


def _followed_turned(
    cameras: Cameras, pair: tuple[int, int], images: Images, xy: np.ndarray, guess: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """``followed`` from one camera into another that looks elsewhere: its image is first turned to where the one looks,
    for at the edges of two wide images the same surface has shapes that no shift makes alike."""
    a, b = pair
    x, y = cameras.map_of(a, b)
    turned = cv2.remap(images[b], x, y, cv2.INTER_LINEAR)
    place, found = followed(images[a], turned, xy, cameras.turned(b, a, guess))
    there = np.full_like(place, np.nan)
    there[found] = cameras.turned(a, b, place[found])
    return there, found & cameras.inside(b, there, _EDGE_PX)


def _off_plane_px(cameras: Cameras, a: int, b: int, xy_a: np.ndarray, xy_b: np.ndarray) -> np.ndarray:
    """(K,) how far pixels in camera b are from the epipolar planes of pixels in a."""
    if not len(xy_a):
        return np.zeros(0)
    rays = [cameras.rays(np.full(len(xy), c), xy) for c, xy in ((a, xy_a), (b, xy_b))]
    way = cameras.rig_from_sensor[b, :3, 3] - cameras.rig_from_sensor[a, :3, 3]
    normal = np.cross(way, rays[0])
    normal /= np.maximum(np.linalg.norm(normal, axis=1, keepdims=True), 1e-12)
    return np.asarray(np.abs(np.sum(normal * rays[1], axis=1)) * cameras.models[b].mean_focal_length())
