"""What a path says of the order of its quaternions' components.

The length of a quaternion and the angle between two of them are the same in any order, and a steady turn about one axis
is one in any order: another order is a rigid motion of their space. What differs is how the turns fit the path. A
vehicle or a hand moves in much the same direction of its own body all along; and what moves over a plane turns mostly
about its normal.
"""

from dataclasses import dataclass

import numpy as np
from scipy.spatial.transform import Rotation

W_LAST, W_FIRST = (0, 1, 2, 3), (1, 2, 3, 0)  # columns of x, y, z, w
_STEPS, _MOVE = 8, 0.1  # moves needed to see which way a body drives, and the least one in median moves
_BETTER, _UNSTEADY = 0.25, 0.01  # how much steadier the other order must be, and how unsteady this one
_NOWHERE_M = 1e12  # products of larger numbers overflow
_TURN_DEG = 10.0  # of turns that have an axis
_FLAT, _WIDE = 0.1, 0.1  # of the middle extent of a path over a plane is its height, of its length its middle extent
_ABOUT, _ASKEW = 0.9, 0.5  # |cosine| of turns about the normal of a plane, and of those that are not


@dataclass(frozen=True)
class Order:
    """What speaks for an order: ``first`` True = w first, False = last, None = nothing does; why; ``sure`` if a body
    was seen to move ahead."""

    first: bool | None = None
    why: str = ""
    sure: bool = False


def order_of_start(position: np.ndarray, quaternion: np.ndarray) -> Order:
    """What the first position (3,) and quaternion (4,) say: most odometry begins at zero without a turn."""
    for is_first, unit, words in ((True, "1 0 0 0", ("first", "last")), (False, "0 0 0 1", ("last", "first"))):
        if not position.any() and np.allclose(quaternion, np.array(unit.split(), float), atol=1e-6):
            why = f"the first pose is at zero with {unit}, no turn with w {words[0]} but half a turn with w {words[1]}"
            return Order(first=is_first, why=why, sure=True)
    return Order()


def order_of(position: np.ndarray, quaternion: np.ndarray) -> Order:
    """What positions (T, 3) say of quaternions (T, 4) of length 1."""
    no_places = not np.abs(position).max(initial=0.0) < _NOWHERE_M
    if no_places or not ((np.abs(quaternion) <= 2).all() and (np.abs(quaternion).max(axis=1) > 0.1).all()):
        return Order()  # who reads them says so
    last, first = (_unsteady(position, quaternion[:, list(o)]) for o in (W_LAST, W_FIRST))
    for is_first, this, other, words in (
        (True, first, last, ("first", "last")),
        (False, last, first, ("last", "first")),
    ):
        if other > _UNSTEADY and this < _BETTER * other:
            why = f"with w {words[0]} the body moves in one direction of its own, with w {words[1]} it does not"
            return Order(first=is_first, why=why, sure=True)
    last, first = (_about_normal(position, quaternion[:, list(o)]) for o in (W_LAST, W_FIRST))
    for is_first, this, other, words in (
        (True, first, last, ("first", "last")),
        (False, last, first, ("last", "first")),
    ):
        if this > _ABOUT and other < _ASKEW:
            why = f"with w {words[0]} the body turns about the normal of its path, with w {words[1]} it does not"
            return Order(first=is_first, why=why)
    return Order()


def _unsteady(position: np.ndarray, xyzw: np.ndarray) -> float:
    """How much the direction of motion in the body's own frame varies: 0 = not at all, 1 = evenly spread."""
    step = np.diff(position, axis=0)
    length = np.sqrt(np.square(step / max(np.abs(step).max(initial=0.0), 1e-300)).sum(axis=1))
    moved = length > _MOVE * np.median(length[length > 0]) if (length > 0).any() else length > 0
    if moved.sum() < _STEPS:
        return 0.0
    ahead = step[moved] / np.linalg.norm(step[moved], axis=1, keepdims=True)
    own = Rotation.from_quat(xyzw[:-1][moved]).apply(ahead, inverse=True)
    return float(1 - np.linalg.norm(own.mean(axis=0)))


def _about_normal(position: np.ndarray, xyzw: np.ndarray) -> float:
    """Mean |cosine| between the axes of turns and the normal of a path over a plane; NaN if it is none, or no turns."""
    _, extent, axes = np.linalg.svd(position - position.mean(axis=0), full_matrices=False)
    if len(extent) < 3 or not (extent[1] > _WIDE * extent[0] and extent[2] < _FLAT * extent[1]):
        return float("nan")
    turns = Rotation.from_quat(xyzw)
    apart = max(1, len(xyzw) // _STEPS)
    between = (turns[apart:] * turns[:-apart].inv()).as_rotvec()
    angle = np.linalg.norm(between, axis=1)
    turned = np.degrees(angle) > _TURN_DEG
    if turned.sum() < _STEPS:
        return float("nan")
    return float(np.mean(np.abs(between[turned] @ axes[2]) / angle[turned]))
