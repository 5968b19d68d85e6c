"""How near places and reconstructions are to the truth."""

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import umeyama
from tiegraph.scene.colmapmodel import image_poses
from tiegraph.scene.rig import Rig
from tiegraph.scene.scene import Scene

_COPIED_M, _COPIED_DEG = 1e-7, 1e-5  # nearer than that nothing is measured: it is the truth itself


def rms(off: np.ndarray) -> float:
    """Root mean square length of vectors (K, 3)."""
    return float(np.sqrt(np.mean(np.sum(off**2, axis=1))))


def off_after_similarity(found: np.ndarray, true: np.ndarray, with_scale: bool = True) -> np.ndarray:
    """Errors (K, 3) of places after the similarity (or rigid motion) that brings them nearest to the true ones."""
    return umeyama(found, true, with_scale=with_scale)(found) - true


def assert_reconstruction_near(
    model: pycolmap.Reconstruction,
    scene: Scene,
    truth: np.ndarray,
    *,
    m: float,
    deg: float,
    images: np.ndarray | None = None,
) -> float:
    """Every image of the scene has a pose; after the best similarity their centres are within ``m`` metres of the true
    ones and their rotations within ``deg`` degrees (root mean squares), and not the truth itself. Returns the scale of
    that similarity, which is 1 where the model keeps the metres of the truth.

    ``truth``: (N, 4, 4) cam_from_world. ``images``: rows of the scene that alone have a pose, None = all.
    """
    poses = image_poses(model, scene)
    posed = np.isfinite(poses).all(axis=(1, 2))
    asked = np.ones(len(scene), bool) if images is None else np.isin(np.arange(len(scene)), images)
    missing, more = ([scene.names[k] for k in np.flatnonzero(rows)] for rows in (asked & ~posed, posed & ~asked))
    assert not missing and not more, f"without a pose: {missing}; with one: {more}"
    poses, truth = poses[asked], truth[asked]
    found, true = transforms.centre(poses), transforms.centre(truth)
    fit = umeyama(found, true)
    off = rms(fit(found) - true)
    turned = poses[:, :3, :3] @ fit.rotation.T
    angle = float(np.sqrt(np.mean(transforms.angle_deg(turned, truth[:, :3, :3]) ** 2)))
    assert _COPIED_M < off < m, f"centres off by {off:.3g} m (limit {m:g})"
    assert _COPIED_DEG < angle < deg, f"rotations off by {angle:.3g} deg (limit {deg:g})"
    return fit.scale


def baselines_m(rig: Rig) -> np.ndarray:
    """(S, S) distances between the projection centres of a rig that is known."""
    centres = np.stack([transforms.centre(s.sensor_from_rig) for s in rig.sensors if s.sensor_from_rig is not None])
    assert len(centres) == len(rig.sensors)
    return np.linalg.norm(centres[:, None] - centres[None], axis=-1)
