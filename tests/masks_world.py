"""A camera on a platform: sky on top, a textured scene that moves from frame to frame, the platform at the bottom."""

from pathlib import Path

import cv2
import numpy as np

SHAPE = (240, 320)
HORIZON, DECK = 60, 180  # rows: sky above the horizon, platform from the deck down
SKY_BGR, CLOUD_BGR = (220, 150, 90), (228, 222, 215)


def frame(k: int, gain: float = 1.0, noise: float = 1.5) -> np.ndarray:
    """Image k, (240, 320, 3) u1 BGR."""
    scene = np.random.default_rng(1000 + k)
    image = np.zeros((*SHAPE, 3), np.float32)
    image[:HORIZON] = SKY_BGR
    coarse = scene.uniform(30, 220, ((DECK - HORIZON) // 6, SHAPE[1] // 8, 1)).astype(np.float32)
    texture = cv2.resize(coarse, (SHAPE[1], DECK - HORIZON), interpolation=cv2.INTER_NEAREST)
    image[HORIZON:DECK] = texture[..., None] * np.float32([0.7, 0.9, 1.0])
    image[DECK:] = _deck()
    image = gain * image + scene.normal(0, noise, image.shape)
    return np.clip(image, 0, 255).astype(np.uint8)


def smooth(seed: int, shape: tuple[int, int], cells: tuple[int, int], span: tuple[float, float] = (0, 1)) -> np.ndarray:
    """Random values (H, W) f4 that vary from cell to cell."""
    coarse = np.random.default_rng(seed).uniform(*span, cells).astype(np.float32)
    return cv2.resize(coarse, shape[::-1], interpolation=cv2.INTER_CUBIC)


def _deck() -> np.ndarray:
    coarse = np.random.default_rng(7).uniform(60, 180, (5, 16)).astype(np.float32)
    return cv2.resize(coarse, (SHAPE[1], SHAPE[0] - DECK), interpolation=cv2.INTER_NEAREST)[..., None]


def write(path: Path, image: np.ndarray) -> Path:
    """Write an image and return its path."""
    path.parent.mkdir(parents=True, exist_ok=True)
    assert cv2.imwrite(str(path), image)
    return path


def sequence(folder: Path, count: int = 4) -> list[Path]:
    """Paths of the frames 0 .. count - 1."""
    return [write(folder / f"{k:06d}.png", frame(k)) for k in range(count)]


def share(mask: np.ndarray, rows: slice) -> float:
    """Share of used pixels in some rows."""
    return float(mask[rows].mean())
