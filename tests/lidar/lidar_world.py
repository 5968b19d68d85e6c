"""A simulated scanner that turns and moves in a hall of boxes: for the tests of LiDAR odometry."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from tiegraph.geometry import transforms

HALL = np.array([[-12.0, -8.0, -2.0], [24.0, 8.0, 5.0]])
BOXES = (
    np.array([[2.0, 4.0, -2.0], [4.0, 6.0, 2.0]]),
    np.array([[8.0, -7.0, -2.0], [10.5, -5.0, 3.0]]),
    np.array([[14.0, 3.0, -2.0], [15.0, 7.0, 1.0]]),
    np.array([[-6.0, -6.0, -2.0], [-4.0, -3.5, 1.5]]),
)
PERIOD_S, START_S = 0.1, 1000.0


@dataclass(frozen=True)
class Turn:
    """One turn: points (N, 3) in the scanner's moving frame, their times (N,) from its start, and that."""

    xyz_m: np.ndarray
    offset_s: np.ndarray
    start_s: float


def world_from_lidar(time_s: np.ndarray, wobble: float = 1.0) -> np.ndarray:
    """(T, 4, 4): 2 m/s ahead, with turns of some degrees, as on a boat."""
    t = np.asarray(time_s, float) - START_S
    turns = np.stack([0.05 * np.sin(2.1 * t), 0.04 * np.sin(1.7 * t + 1), 0.2 * np.sin(0.9 * t)], axis=1)
    place = np.stack([2.0 * t, wobble * 0.5 * np.sin(0.8 * t), wobble * 0.1 * np.sin(1.9 * t)], axis=1)
    return transforms.rigid(Rotation.from_rotvec(wobble * turns).as_matrix(), place)


def turns(count: int, rings: int = 16, step_deg: float = 1.0, noise_m: float = 0.01, seed: int = 0) -> list[Turn]:
    """Turns one after another."""
    rng = np.random.default_rng(seed)
    azimuth = np.radians(np.arange(0, 360, step_deg))
    height = np.radians(np.linspace(-20, 20, rings))
    ahead, up = np.meshgrid(azimuth, height, indexing="ij")
    rays = np.stack([np.cos(ahead) * np.cos(up), -np.sin(ahead) * np.cos(up), np.sin(up)], axis=2).reshape(-1, 3)
    offset = np.repeat(np.arange(len(azimuth)) / len(azimuth) * PERIOD_S, rings)
    out = []
    for k in range(count):
        start = START_S + k * PERIOD_S
        poses = world_from_lidar(start + offset)
        ahead = np.einsum("nij,nj->ni", poses[:, :3, :3], rays)
        reach = _reach(poses[:, :3, 3], ahead) + rng.normal(0, noise_m, len(rays))
        out.append(Turn(rays * reach[:, None], offset, start))
    return out


def _reach(place: np.ndarray, ray: np.ndarray) -> np.ndarray:
    """Distance to the first surface: the hall from inside, the boxes from outside."""
    with np.errstate(divide="ignore", invalid="ignore"):
        sides = (HALL[:, None] - place) / ray
        best = np.nanmin(np.max(sides, axis=0), axis=1)
        for box in BOXES:
            sides = (box[:, None] - place) / ray
            near, far = np.min(sides, axis=0).max(axis=1), np.max(sides, axis=0).min(axis=1)
            best = np.where((near < far) & (near > 0) & (near < best), near, best)
    return best


def write_bins(folder: Path, made: list[Turn], with_times: bool = True) -> Path:
    """x, y, z, intensity, and t of each point, with times.txt beside them."""
    folder.mkdir(parents=True)
    for k, turn in enumerate(made):
        columns = [turn.xyz_m, np.ones((len(turn.xyz_m), 1))]
        columns += [turn.offset_s[:, None]] if with_times else []
        np.hstack(columns).astype("<f4").tofile(folder / f"{k:06d}.bin")
    (folder / "times.txt").write_text("".join(f"{t.start_s:.3f}\n" for t in made))
    return folder
