"""What is expected of a rig before the images speak: its cameras look outwards from one body.

A camera that shares hardly a point with the others, the up camera of a boat, has its lever arm from a handful of
tracks: on canal from 16 of them, with a sigma of 44 mm in a rig of 60 mm. What the other cameras' places have in
common, a middle and a distance from it along their optical axes, is what is expected of it, with the spread that they
have around it (empirical Bayes: Efron and Morris 1975). A camera that stands apart counts little, and
where the images tell the place they outweigh it.
"""

from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np
import pyceres
import pycolmap

from tiegraph.geometry.transforms import skew
from tiegraph.sfm.tuning import AdjustTuning
from tiegraph.sfm.tuning.rig import LeverArmTuning

_TOLD = 1e-9  # of the largest eigenvalue: below, the information is rounding


NominalGeometry = Mapping[
    int, np.ndarray
]  # camera id -> nominal centre (3,) in the frame of the reference, in any unit


def expected_centres(
    rig: pycolmap.Rig, tuning: LeverArmTuning, drawing: NominalGeometry | None = None
) -> dict[int, tuple[np.ndarray, float]]:
    """Camera id -> where the other cameras let expect its centre in the rig (3,), and sigma of each coordinate.

    In model units; not for the reference. Empty for rigs of fewer than five cameras and for those of one centre.
    """
    places = _places(rig, drawing)
    keys, centres, axes, drawn = places.keys, places.centres, places.axes, places.drawn
    out = {}
    for row, key in enumerate(keys, start=1) if len(keys) >= tuning.least_others else ():
        others = np.arange(len(centres)) != row
        rules = [_outward(centres[others], axes[others], axes[row], tuning.uneven)]
        if drawn is not None and np.ptp(drawn[others], axis=0).any():
            rules.append(_as_drawn(centres[others], drawn[others], drawn[row], tuning.inexact))
        out[key] = min(rules, key=lambda rule: rule[1])
    return {k: (centre, sigma) for k, (centre, sigma) in out.items() if sigma > 0}


@dataclass(frozen=True)
class _Places:
    """Ids of all cameras but the reference; centres, axes and drawn centres (N, 3) of the reference, then of these."""

    keys: list[int]
    centres: np.ndarray
    axes: np.ndarray
    drawn: np.ndarray | None


def _places(rig: pycolmap.Rig, drawing: NominalGeometry | None) -> _Places:
    poses = {i.id: pose.inverse() for i, pose in rig.non_ref_sensors.items() if pose is not None}
    centres = np.array([np.zeros(3), *(p.translation for p in poses.values())])
    axes = np.array([[0.0, 0, 1], *(p.rotation.matrix()[:, 2] for p in poses.values())])
    drawn = np.array([np.zeros(3), *((drawing or {}).get(k, np.full(3, np.nan)) for k in poses)])
    return _Places(keys=list(poses), centres=centres, axes=axes, drawn=drawn if np.isfinite(drawn).all() else None)


def _as_drawn(centres: np.ndarray, drawn: np.ndarray, place: np.ndarray, inexact: float) -> tuple[np.ndarray, float]:
    """Turn and size (about the reference, which is where it is) that fit the drawing (N, 3) best to these cameras."""
    u, stretch, v = np.linalg.svd(centres.T @ drawn)
    mirror = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ v))])
    size = float(np.sum(stretch * np.diag(mirror)) / np.sum(drawn**2))
    left = centres - size * drawn @ (u @ mirror @ v).T
    variance = float(np.sum(left**2)) / (left.size - 3 - 4) + (inexact * size) ** 2 * float(np.mean(drawn**2))
    return size * u @ mirror @ v @ place, float(np.sqrt(variance))


def _outward(centres: np.ndarray, axes: np.ndarray, axis: np.ndarray, uneven: float) -> tuple[np.ndarray, float]:
    """Middle and distance along the axis that fit these cameras (N, 3) best, for a camera with another axis (3,)."""
    around, along = axes - axes.mean(axis=0), centres - centres.mean(axis=0)
    distance = max(float(np.sum(around * along) / max(np.sum(around**2), 1e-12)), 0.0)
    left = along - distance * around
    variance = float(np.sum(left**2)) / (left.size - 4) + (uneven * distance) ** 2
    return centres.mean(axis=0) + distance * (axis - axes.mean(axis=0)), float(np.sqrt(variance))


def information(
    rig: pycolmap.Rig, tuning: LeverArmTuning, drawing: NominalGeometry | None = None
) -> tuple[list[int], np.ndarray]:
    """Ids of cameras and the information (3N, 3N) of their centres that this expectation adds, 1 / model units squared.

    Of how they deviate from the rule, not of what the rule has from themselves: middle and distance, or turn and size.
    """
    expected = expected_centres(rig, tuning, drawing)
    places = _places(rig, drawing)
    keys, centres, axes, drawn = places.keys, places.centres, places.axes, places.drawn
    if len(expected) < len(keys) or not keys:
        return [], np.zeros((0, 0))
    outward = _outward(centres, axes, axes[0], tuning.uneven)[1]
    fitted, sigma = (None, np.inf) if drawn is None or not drawn.any() else _as_drawn(
        centres, drawn, drawn.T, tuning.inexact
    )  # fmt: skip
    if fitted is not None and sigma < outward:
        basis = np.concatenate([skew(fitted.T), fitted.T[:, :, None]], axis=2)
    else:
        basis = np.concatenate([np.tile(np.eye(3), (len(centres), 1, 1)), axes[:, :, None]], axis=2)
    off = [np.linalg.norm(c - expected[k][0]) / expected[k][1] for k, c in zip(keys, centres[1:])]
    weight = np.array([1 / (1 + (o / tuning.cauchy_sigmas) ** 2) / expected[k][1] ** 2 for o, k in zip(off, keys)])
    each = np.repeat([float(weight.mean()), *weight], 3)
    rows = basis.reshape(-1, 4)
    taken = each[:, None] * rows
    whole = np.diag(each) - taken @ np.linalg.pinv(rows.T @ taken, hermitian=True) @ taken.T
    return keys, whole[3:, 3:]


def bring_back(
    model: pycolmap.Reconstruction,
    fixed: Collection[int],
    nominal: Mapping[int, NominalGeometry] | None,
    tuning: AdjustTuning,
) -> bool:
    """Put cameras that share hardly a point with others, and stand apart from where the others of their rig let expect
    them, there; whether there are any. Not of rigs (ids) that are ``fixed``.

    A camera that ties to itself alone, as one that looks up at a bridge, may stand anywhere along the vertical, with
    all its points: a few false matches took it 3.4 m away in a rig of 0.06 m, and there the robust weight lets it be.
    So the images have to take it away from its place, not this rule back to it.
    """
    rules, there = tuning.lever_arms, False
    for rig_id, rig in model.rigs.items():
        expected = {} if rig_id in fixed else expected_centres(rig, rules, (nominal or {}).get(rig_id))
        for sensor, pose in rig.non_ref_sensors.items():
            if pose is None or sensor.id not in expected:
                continue
            centre, sigma = expected[sensor.id]
            apart = np.linalg.norm(pose.inverse().translation - centre) > rules.cauchy_sigmas * sigma
            if apart and _shared(model, sensor.id) < tuning.min_points:
                pose.translation = -pose.rotation.matrix() @ centre
                there = True
    return there


def _shared(model: pycolmap.Reconstruction, camera: int) -> int:
    """Points that a camera sees and another one too."""
    of = {k: model.image(k).camera_id for k in model.reg_image_ids()}
    seen = ({of[e.image_id] for e in p.track.elements} for p in model.points3D.values())
    return sum(camera in cameras and len(cameras) > 1 for cameras in seen)


def centres_of(poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N, 3) centres -R^T t of pose blocks (N, 7), quaternion x y z w and translation, and (N, 3, 7) their Jacobians.

    With the quaternion (u, w): R^T v = v - 2 w u x v + 2 u x (u x v). Off the unit sphere the formula goes on as it is;
    the solver only uses directions along it.
    """
    u, w, v = poses[:, :3], poses[:, 3, None, None], -poses[:, 4:]
    across, unit = skew(u), np.eye(3)
    inverse = unit + 2 * (across - w * unit) @ across
    outer = u[:, :, None] * v[:, None, :]
    out = np.empty((len(poses), 3, 7))
    out[:, :, :3] = 2 * (w * skew(v) + np.sum(u * v, axis=1)[:, None, None] * unit + outer)
    out[:, :, :3] -= 4 * np.swapaxes(outer, 1, 2)
    out[:, :, 3] = 2 * (skew(v) @ u[:, :, None])[:, :, 0]
    out[:, :, 4:] = -inverse
    return (inverse @ v[:, :, None])[:, :, 0], out


class _CentresCost(pyceres.CostFunction):  # type: ignore[misc, name-defined]
    """A root (R, 3N) of information times the centres (N, 3) of sensors in their rig. Blocks: their poses (7 each).

    pyceres sets up its arrays at the first call, and reads where the Jacobians go whether they are asked for or not.
    Ceres asks for none where all blocks are constant, and that ended by SIGSEGV: so the constructor makes a first call.
    Python residuals need the interpreter's lock: such a problem is solved with one thread (more wait for each other
    for ever).
    """

    def __init__(self, root: np.ndarray) -> None:
        super().__init__()
        self.root = root
        sizes = [7] * (root.shape[1] // 3)
        self.set_num_residuals(len(root))
        self.set_parameter_block_sizes(sizes)
        self.evaluate(*(np.zeros(size) for size in sizes))

    def Evaluate(self, parameters: Any, residuals: Any, jacobians: Any) -> bool:
        """Residual and Jacobians; a Jacobian is None where its block is constant."""
        places, slopes = centres_of(np.array(parameters))
        residuals[:] = self.root @ places.ravel()
        for k, jacobian in enumerate(jacobians or ()):
            if jacobian is not None:
                jacobian[:] = (self.root[:, 3 * k : 3 * k + 3] @ slopes[k]).ravel()
        return True


def add_priors(
    problem: Any, model: pycolmap.Reconstruction, nominal: Mapping[int, NominalGeometry] | None, tuning: AdjustTuning
) -> list[Any]:
    """Expect the sensors of each rig where all of them together let expect each; keep what is returned until it has
    solved. ``nominal``: geometry of rigs by rig id.

    The rule's own unknowns are eliminated (``information``). With the rule held as the model had it before, each
    adjustment went a part of the way only: on canal_demo, a nominal rig, twelve in a row went from 5.9 to 2.8 mm.
    """
    kept: list[Any] = []
    for rig_id, rig in model.rigs.items():
        keys, known = information(rig, tuning.lever_arms, (nominal or {}).get(rig_id))
        poses = {i.id: pose.params for i, pose in rig.non_ref_sensors.items() if pose is not None}
        blocks = [poses[k] for k in keys]
        unseen = [b for b in blocks if not problem.has_parameter_block(b)]
        if all(problem.is_parameter_block_constant(b) for b in blocks if problem.has_parameter_block(b)):
            continue
        value, vector = np.linalg.eigh(known)
        told = value > _TOLD * value[-1]
        kept.append(_CentresCost(tuning.robust_px * np.sqrt(value[told])[:, None] * vector[:, told].T))
        problem.add_residual_block(kept[-1], None, blocks)
        for block in unseen:
            problem.set_parameter_block_constant(block)
    return kept
