"""Videos of a shaken rig before a wall at infinity, with known times: for the tests of video."""

from __future__ import annotations

from collections.abc import Iterable, Iterator
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial.transform import Rotation

SIZE = (160, 120)


@dataclass(frozen=True)
class Shake:
    """Rotation of a rig over time: sums of sines, as of a boat or a car, radians about its axes."""

    amplitude: np.ndarray  # (k, 3)
    rate_hz: np.ndarray  # (k,)
    phase: np.ndarray  # (k, 3)

    @staticmethod
    def of(seed: int, degrees: float = 1.0) -> Shake:
        """Eight sines from 0.2 to 4 Hz, the slower the larger."""
        rng = np.random.default_rng(seed)
        rate = np.geomspace(0.2, 4.0, 8) * rng.uniform(0.9, 1.1, 8)
        size = np.radians(degrees) / np.sqrt(rate)[:, None] * rng.uniform(0.5, 1.5, (8, 3))
        return Shake(size, rate, rng.uniform(0, 2 * np.pi, (8, 3)))

    def world_from_rig(self, time_s: float) -> np.ndarray:
        """(3, 3) at a time."""
        angle = np.sum(self.amplitude * np.sin(2 * np.pi * self.rate_hz[:, None] * time_s + self.phase), axis=0)
        return Rotation.from_rotvec(angle).as_matrix()


def wall(seed: int = 0) -> np.ndarray:
    """A texture (H, W, 3) with edges of every size."""
    rng = np.random.default_rng(seed)
    out = np.full((600, 900, 3), 90.0)
    for size in (40, 16, 6):
        small = rng.normal(0, 45, (600 // size + 1, 900 // size + 1, 3))
        out += cv2.resize(small, (900, 600), interpolation=cv2.INTER_LINEAR)
    return np.clip(out, 0, 255).astype(np.uint8)


def pictures(
    shake: Shake, times_s: np.ndarray, turn_deg: tuple[float, float, float] = (0, 0, 0), focal_px: float = 150.0
) -> Iterator[np.ndarray]:
    """What a camera of the rig, turned by angles about x, y and z, sees of a texture of its own at times (N,)."""
    texture = wall(int(abs(hash(turn_deg))) % 97)
    rig_from_camera = Rotation.from_euler("xyz", turn_deg, degrees=True).as_matrix()
    camera = np.array([[focal_px, 0, SIZE[0] / 2], [0, focal_px, SIZE[1] / 2], [0, 0, 1.0]])
    sheet = np.array([[300.0, 0, 450], [0, 300.0, 300], [0, 0, 1.0]])
    for time in times_s:
        turned = rig_from_camera.T @ shake.world_from_rig(float(time)) @ rig_from_camera  # the texture is before it
        map_from_image = sheet @ turned @ np.linalg.inv(camera)
        yield cv2.warpPerspective(texture, map_from_image, SIZE, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)


def film(path: Path, images: Iterable[np.ndarray], fps: float = 10.0) -> Path:
    """Write pictures as a video: AVI if the file is called so, else MP4 whatever it is called."""
    path.parent.mkdir(parents=True, exist_ok=True)
    made = path if path.suffix == ".avi" else path.with_suffix(".mp4")
    first, *others = images
    codec = cv2.VideoWriter.fourcc(*("MJPG" if path.suffix == ".avi" else "mp4v"))
    out = cv2.VideoWriter(str(made), codec, fps, first.shape[1::-1])
    for image in (first, *others):
        out.write(image)
    out.release()
    return made.rename(path)
