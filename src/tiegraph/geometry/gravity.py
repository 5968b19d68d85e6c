"""Which way is up in a model: cameras are mounted upright, or held level, or look straight down.

Their image tops point to the sky on average, which is as good as the cameras look all round: those of a ring, or a pair
back to back. Cameras to one side may all look up a facade or down at a find; but level they are from left to right, so
that their x axes lie in the horizon, and those of several headings span it (Brown and Lowe, Automatic panoramic image
stitching, 2007, section 5).

One least-squares fit of tops and x axes, instead of the choice between them, is no better at any weight: with 0.05 of
the tops Herz-Jesus-P8 stands 4.7 deg off instead of 0.1, with 0.001 one camera of the boat `canal_demo` 0.7 instead of
0.0 (``python -m benchmarks.sfm.upright``).
"""

from dataclasses import dataclass

import numpy as np
from pydantic import Field

from tiegraph.geometry import transforms
from tiegraph.settings import Section

STEEP_DEG = 45.0  # halfway from the horizon: a camera with a larger mean angle looks up, or down


class UpTuning(Section):
    """Which way is up in a model."""

    ring_sigma_deg: float = Field(3.0, gt=0)
    """Cameras all round a levelled platform: what trim and mounting leave."""
    lone_sigma_deg: float = Field(10.0, gt=0)
    """A person holding a camera, or cameras to one side."""
    agreement: float = Field(0.8, ge=0, le=1)
    """Length of the mean of the unit vectors at least; nadir photographs of many headings have about 0. 1: cameras tell
    nothing."""
    round: float = Field(0.5, ge=0, le=1)
    """Length of the mean viewing direction of a frame, below which its cameras look all round."""


@dataclass(frozen=True)
class Up:
    """Upward direction (3,) in the model, its sigma, whether cameras all round say so, and whether it holds the whole
    tilt (or only the roll about the track)."""

    direction: np.ndarray
    sigma_deg: float
    ring: bool
    tilt: bool
    cameras: str


def up_vector(cam_from_world: np.ndarray, frame: np.ndarray, tuning: UpTuning) -> Up | None:
    """By cameras (N, 4, 4; NaN = no pose), each of a frame (N,), that do not look up: of a ring their mean -y, of
    others the direction across their x axes, or again the mean -y where these do not span the horizon; None when they
    do not agree.

    The sigma of cameras all round is 3 deg, or more where the platform itself leans so much from frame to frame (a
    camera on a pole).
    """
    use = np.isfinite(cam_from_world).all(axis=(1, 2)) & ~looking_up(cam_from_world, frame)
    if not use.any() or tuning.agreement == 1:
        return None
    turns = cam_from_world[use, :3, :3]
    _, at, count = np.unique(frame[use], return_inverse=True, return_counts=True)
    sums = (np.stack([np.bincount(at, v) for v in axis.T], axis=1) for axis in (-turns[:, 1], turns[:, 2]))
    top, looking = (s / count[:, None] for s in sums)  # means of each frame
    several = count > 1
    ring = several.any() and float(np.linalg.norm(looking[several], axis=1).mean()) < tuning.round
    horizon = None if ring else across_horizon(turns, tuning)
    if horizon is not None:
        return horizon
    mean = -turns[:, 1].mean(axis=0)
    if np.linalg.norm(mean) < tuning.agreement:
        return None
    mean /= np.linalg.norm(mean)
    if not ring:
        return Up(direction=mean, sigma_deg=tuning.lone_sigma_deg, ring=False, tilt=False, cameras="the images")
    leaning = np.degrees(np.arccos(np.clip(top[several] @ mean / np.linalg.norm(top[several], axis=1), -1, 1)))
    sigma = max(tuning.ring_sigma_deg, float(np.sqrt(np.mean(leaning**2))))
    return Up(direction=mean, sigma_deg=sigma, ring=True, tilt=True, cameras="the ring of side cameras")


def looking_up(cam_from_world: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """(N,) bool: cameras (N, 4, 4; NaN = no pose) whose axis is within 45 degrees of the mean top of the images of
    their frame (N,)."""
    posed = np.isfinite(cam_from_world).all(axis=(1, 2))
    at, tops = frame[posed], -cam_from_world[posed, 1, :3]
    mean = np.stack([np.bincount(at, v, minlength=int(frame.max(initial=0)) + 1) for v in tops.T], axis=1)
    out = np.zeros(len(frame), bool)
    along = np.sum(cam_from_world[posed, 2, :3] * mean[at], axis=1)
    out[posed] = along > np.cos(np.radians(STEEP_DEG)) * np.linalg.norm(mean[at], axis=1)
    return out


def across_horizon(turns: np.ndarray, tuning: UpTuning) -> Up | None:
    """The direction across the x axes of cameras (N, 3, 3); None where it is not better known than by their tops, or
    where these do not tell its sense: cameras that look straight up and straight down see alike.

    Along the axes' second direction the sigma is that of one camera over their spread in it: 1 for headings all round.
    """
    x = turns[:, 0]
    spread, axes = np.linalg.eigh(x.T @ x / len(x))
    top = -float(np.mean(turns[:, 1] @ axes[:, 0]))
    if abs(top) < 1 - tuning.agreement:
        return None
    up = axes[:, 0] * np.sign(top)
    lean = np.degrees(np.sqrt(np.mean(np.arcsin(np.clip(x @ up, -1, 1)) ** 2)))
    sigma = max(tuning.ring_sigma_deg, float(lean)) / float(np.sqrt(max(2 * spread[1], 1e-12)))
    if sigma >= tuning.lone_sigma_deg:
        return None
    return Up(direction=up, sigma_deg=sigma, ring=False, tilt=True, cameras="the level images")


def levelled(cam_from_world: np.ndarray, frame: np.ndarray) -> np.ndarray:
    """(4, 4) rigid transform of a world into one with z up, the path of the cameras (N, 4, 4; NaN = no pose) along x.

    ``frame`` (N,) of each camera. Up is what ``gravity`` says; where it says nothing, they look straight down.
    """
    placed = np.isfinite(cam_from_world).all(axis=(1, 2))
    out = np.eye(4)
    if not placed.any():
        return out
    rotation, centre = cam_from_world[placed, :3, :3], transforms.centre(cam_from_world[placed])
    found = up_vector(cam_from_world, frame, UpTuning())
    up = -rotation[:, 2].mean(axis=0) if found is None else found.direction
    up = up / max(float(np.linalg.norm(up)), 1e-9)
    flat = centre - centre.mean(axis=0)
    flat = flat - np.outer(flat @ up, up)
    along = np.linalg.svd(flat, full_matrices=False)[2][0] if np.abs(flat).max() > 1e-9 else rotation[0, 0]
    along = along - (along @ up) * up
    along /= np.linalg.norm(along)
    out[:3, :3] = np.stack([along, np.cross(up, along), up])
    out[:3, 3] = -out[:3, :3] @ centre.mean(axis=0)
    return out


def roll_to_upright(upward: np.ndarray, axis: np.ndarray) -> float:
    """Angle (rad) by which to turn about ``axis`` so that ``upward`` comes closest to the vertical."""
    a, b = upward - axis * (upward @ axis), np.array([0.0, 0.0, 1.0]) - axis * axis[2]
    return float(np.arctan2(axis @ np.cross(a, b), a @ b))


def roll_by_upward(upward: np.ndarray, axis: np.ndarray) -> np.ndarray:
    """(3,) derivative of ``roll_to_upright`` by ``upward``."""
    b = np.array([0.0, 0.0, 1.0]) - axis * axis[2]
    across = np.cross(b, axis)
    sine, cosine = across @ upward, b @ upward
    return np.asarray((cosine * across - sine * b) / max(sine**2 + cosine**2, 1e-300))


def to_upright(upward: np.ndarray) -> np.ndarray:
    """Rotation vector (east, north parts) that brings ``upward`` to the vertical."""
    cross = np.cross(upward, [0.0, 0.0, 1.0])[:2]
    sine = float(np.linalg.norm(cross))
    return cross * (np.arctan2(sine, upward[2]) / sine if sine > 1e-12 else 1.0)


def upright_by_upward(upward: np.ndarray) -> np.ndarray:
    """(2, 3) derivative of ``to_upright`` by ``upward``."""
    turned = np.array([[0.0, 1.0, 0.0], [-1.0, 0.0, 0.0]])  # from ``upward`` to its cross product with the vertical
    cross = turned @ upward
    sine = float(np.linalg.norm(cross))
    if sine <= 1e-12:
        return turned
    angle = np.arctan2(sine, upward[2])
    by_sine = cross @ turned / sine
    by_angle = (upward[2] * by_sine - sine * np.array([0.0, 0.0, 1.0])) / (sine**2 + upward[2] ** 2)
    return np.asarray(angle / sine * turned + np.outer(cross, by_angle / sine - angle / sine**2 * by_sine))
