"""The prior of a rig's geometry: its cameras look outwards from one body.

A camera that shares hardly any point with the others, such as the up camera of a boat, has its lever arm from a
handful of tracks: on canal from 16 of them, with a sigma of 44 mm in a rig of 60 mm. The other cameras have a middle
and a distance from it along their optical axes in common; these predict the place of the camera, with the scatter of
the others as its sigma (empirical Bayes: Efron and Morris 1975). A camera that does not follow the rule has a small
weight, and where the images determine the place they outweigh the prior.
"""

from collections.abc import Collection, Mapping
from typing import Any

import numpy as np
import pyceres
import pycolmap

from tiegraph.geometry.transforms import skew
from tiegraph.scene.evidence import LIMIT
from tiegraph.sfm.tuning import AdjustTuning
from tiegraph.sfm.tuning.rig import LeverArmTuning

_TOLD = 1e-9  # of the largest eigenvalue: below, the information is rounding


NominalGeometry = Mapping[
    int, np.ndarray
]  # camera id -> nominal centre (3,) in the frame of the reference, in any unit


def expected_centres(
    rig: pycolmap.Rig, tuning: LeverArmTuning, drawing: NominalGeometry | None = None
) -> dict[int, tuple[np.ndarray, float]]:
    """Camera id -> centre in the rig (3,) predicted from the other cameras, and the sigma of each coordinate.

    In model units, without the reference. Empty for rigs of fewer than five cameras and for rigs whose cameras share
    one centre.
    """
    (centres, axes, drawn), keys, out = _places(rig, drawing), _cameras(rig), {}
    for row, key in enumerate(keys, start=1) if len(keys) >= tuning.least_others else ():
        others = np.arange(len(centres)) != row
        rules = [_outward(centres[others], axes[others], axes[row], tuning.uneven)]
        if drawn is not None and np.ptp(drawn[others], axis=0).any():
            rules.append(_as_drawn(centres[others], drawn[others], drawn[row], tuning.inexact))
        out[key] = min(rules, key=lambda rule: rule[1])
    return {k: (centre, sigma) for k, (centre, sigma) in out.items() if sigma > 0}


def _cameras(rig: pycolmap.Rig) -> dict[int, pycolmap.Rigid3d]:
    """The poses of all cameras but the reference, by id."""
    return {i.id: pose for i, pose in rig.non_ref_sensors.items() if pose is not None}


def _places(rig: pycolmap.Rig, drawing: NominalGeometry | None) -> tuple[np.ndarray, np.ndarray, np.ndarray | None]:
    """Centres, axes and nominal centres (N, 3), the reference first."""
    poses = {k: pose.inverse() for k, pose in _cameras(rig).items()}
    centres = np.array([np.zeros(3), *(p.translation for p in poses.values())])
    axes = np.array([[0.0, 0, 1], *(p.rotation.matrix()[:, 2] for p in poses.values())])
    drawn = np.array([np.zeros(3), *((drawing or {}).get(k, np.full(3, np.nan)) for k in poses)])
    return centres, axes, drawn if np.isfinite(drawn).all() else None


def _as_drawn(centres: np.ndarray, drawn: np.ndarray, place: np.ndarray, inexact: float) -> tuple[np.ndarray, float]:
    """Rotation and scale, about the fixed reference, that fit the nominal geometry (N, 3) best to these cameras."""
    u, stretch, v = np.linalg.svd(centres.T @ drawn)
    mirror = np.diag([1.0, 1.0, np.sign(np.linalg.det(u @ v))])
    size = float(np.sum(stretch * np.diag(mirror)) / np.sum(drawn**2))
    left = centres - size * drawn @ (u @ mirror @ v).T
    variance = float(np.sum(left**2)) / (left.size - 3 - 4) + (inexact * size) ** 2 * float(np.mean(drawn**2))
    return size * u @ mirror @ v @ place, float(np.sqrt(variance))


def _outward(centres: np.ndarray, axes: np.ndarray, axis: np.ndarray, uneven: float) -> tuple[np.ndarray, float]:
    """Middle and distance along the axis that fit these cameras (N, 3) best, for another camera with this axis (3,)."""
    around, along = axes - axes.mean(axis=0), centres - centres.mean(axis=0)
    distance = max(float(np.sum(around * along) / max(np.sum(around**2), 1e-12)), 0.0)
    left = along - distance * around
    variance = float(np.sum(left**2)) / (left.size - 4) + (uneven * distance) ** 2
    return centres.mean(axis=0) + distance * (axis - axes.mean(axis=0)), float(np.sqrt(variance))


def information(
    rig: pycolmap.Rig, tuning: LeverArmTuning, drawing: NominalGeometry | None = None
) -> tuple[list[int], np.ndarray]:
    """Ids of cameras and the information (3N, 3N) on their centres that this prior adds, 1 / model units squared.

    It measures the deviation from the rule; the parameters of the rule (middle and distance, or rotation and scale)
    are estimated from the same cameras and eliminated.
    """
    expected, keys = expected_centres(rig, tuning, drawing), list(_cameras(rig))
    centres, axes, drawn = _places(rig, drawing)
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
    weight = np.array([1 / (1 + (o / LIMIT) ** 2) / expected[k][1] ** 2 for o, k in zip(off, keys)])
    each = np.repeat([float(weight.mean()), *weight], 3)
    rows = basis.reshape(-1, 4)
    taken = each[:, None] * rows
    whole = np.diag(each) - taken @ np.linalg.pinv(rows.T @ taken, hermitian=True) @ taken.T
    return keys, whole[3:, 3:]


def bring_back(
    model: pycolmap.Reconstruction,
    fixed: Collection[int],
    nominal: Mapping[int, NominalGeometry],
    tuning: AdjustTuning,
) -> bool:
    """Move cameras that share hardly any point with others, and are far from their predicted place in the rig, to
    that place; returns whether there are any. Rigs (ids) that are ``fixed`` are left alone.

    A camera whose images tie only to each other, such as one that looks up at a bridge, may be anywhere along the
    vertical with all its points. A few false matches took it 3.4 m away in a rig of 0.06 m, where the robust weight
    no longer pulls it back. So it starts from its predicted place, and only the images can take it away from there.
    """
    rules, there = tuning.lever_arms, False
    for rig_id, rig in model.rigs.items():
        expected = {} if rig_id in fixed else expected_centres(rig, rules, nominal.get(rig_id))
        for key, pose in _cameras(rig).items() if expected else ():
            if key not in expected:
                continue
            centre, sigma = expected[key]
            apart = np.linalg.norm(pose.inverse().translation - centre) > LIMIT * sigma
            if apart and _shared(model, key) < tuning.min_points:
                pose.translation = -pose.rotation.matrix() @ centre
                there = True
    return there


def _shared(model: pycolmap.Reconstruction, camera: int) -> int:
    """Number of points that a camera sees together with another camera."""
    of = {k: model.image(k).camera_id for k in model.reg_image_ids()}
    seen = ({of[e.image_id] for e in p.track.elements} for p in model.points3D.values())
    return sum(camera in cameras and len(cameras) > 1 for cameras in seen)


def centres_of(poses: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N, 3) centres -R^T t of pose blocks (N, 7), quaternion x y z w and translation, and (N, 3, 7) their Jacobians.

    With the quaternion (u, w): R^T v = v - 2 w u x v + 2 u x (u x v). The formula is used unchanged off the unit
    sphere; the solver only uses directions along the sphere.
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
    """Square root (R, 3N) of an information matrix times the centres (N, 3) of sensors in their rig. Blocks: their
    poses (7 each).

    pyceres allocates its arrays at the first call and reads where the Jacobians go even if none are asked for. Ceres
    asks for none where all blocks are constant, which ended in SIGSEGV; therefore the constructor makes a first call.
    Residuals in Python need the interpreter's lock, so such a problem is solved with one thread (several threads
    would wait for each other for ever).
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
    problem: Any, model: pycolmap.Reconstruction, nominal: Mapping[int, NominalGeometry], tuning: AdjustTuning
) -> list[Any]:
    """Add the prior of each rig's geometry to the problem; keep the returned objects until it is solved. ``nominal``:
    geometry of rigs by rig id.

    The rule's own unknowns are eliminated (``information``). With the rule held at the model's previous state each
    adjustment went only part of the way: on canal_demo, a nominal rig, twelve in a row went from 5.9 to 2.8 mm.
    """
    kept: list[Any] = []
    for rig_id, rig in model.rigs.items():
        keys, known = information(rig, tuning.lever_arms, nominal.get(rig_id))
        blocks = [pose.params for k, pose in _cameras(rig).items() if k in keys]
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
