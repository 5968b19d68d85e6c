"""One measure of how near a reconstruction is to the truth."""

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.geometry.align import umeyama
from tiegraph.scene.scene import Scene
from tiegraph.sfm.model import image_poses

_COPIED_M = 1e-7  # nearer than that nothing is measured: it is the truth itself


def assert_reconstruction_near(
    model: pycolmap.Reconstruction, scene: Scene, truth: np.ndarray, *, m: float, deg: float
) -> None:
    """Every image of the scene has a pose; after the best similarity their centres are within ``m`` metres of the true
    ones and their rotations within ``deg`` degrees (root mean squares), and not the truth itself.

    ``truth``: (N, 4, 4) cam_from_world.
    """
    poses = image_poses(model, scene)
    missing = [scene.names[k] for k in np.flatnonzero(~np.isfinite(poses).all(axis=(1, 2)))]
    assert not missing, f"without a pose: {missing}"
    found, true = transforms.centre(poses), transforms.centre(truth)
    fit = umeyama(found, true)
    off = float(np.sqrt(np.mean(np.sum((fit(found) - true) ** 2, axis=1))))
    turned = poses[:, :3, :3] @ fit.rotation.T
    angle = float(np.sqrt(np.mean(transforms.angle_deg(turned, truth[:, :3, :3]) ** 2)))
    assert _COPIED_M < off < m, f"centres off by {off:.3g} m (limit {m:g})"
    assert angle < deg, f"rotations off by {angle:.3g} deg (limit {deg:g})"
