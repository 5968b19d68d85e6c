"""The cameras of a rig as the odometry uses them: which see their own corners, which only see those of others."""

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np
import pycolmap

from tiegraph.errors import InputError
from tiegraph.geometry import transforms
from tiegraph.scene.colmapmodel import rigid3d
from tiegraph.scene.rig import Rig

FAR_BASELINES = 20.0
"""Distance, in baselines, at which cameras of a rig see about the same."""
_GRID = 12  # places along each side of an image at which the common view of two cameras is looked at


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

    def side_px(self, camera: int) -> int:
        """Longer side of a camera's images."""
        return max(self.models[camera].width, self.models[camera].height)

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
        x, y = np.meshgrid(np.linspace(0, model.width - 1, _GRID), np.linspace(0, model.height - 1, _GRID))
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
    models, poses = [], []
    for sensor in rigs[0].sensors:
        if sensor.camera is None or not sensor.camera.has_prior_focal_length:
            raise InputError(
                f"camera {sensor.name}: its focal length is not known: give --rig rig.toml (`tiegraph calibrate` makes "
                "one) or --camera"
            )
        models.append(sensor.camera)
        poses.append(np.asarray(sensor.sensor_from_rig))
    return Cameras(tuple(s.name for s in rigs[0].sensors), tuple(models), np.stack(poses))
