"""How well the adjustment knows what lies between two frames, by how far they are apart: the shape of a survey."""

from collections.abc import Mapping

import numpy as np
import pycolmap
from scipy.spatial.distance import pdist, squareform

from tiegraph.geometry.transforms import motions
from tiegraph.sfm.covariance import PositionSigma

BETWEEN = "sigma of what lies between two frames, units of the model"
PATHS = "sigma of each camera's own path, units of the model"
_LEAST_FRAMES = 4  # less is not more than a similarity takes away
_COLUMNS = ["apart", "sigma", "pairs of frames"]
_STEPS = 2  # rows for each doubling of the distance


def between_frames(model: pycolmap.Reconstruction, sigma: PositionSigma, min_pairs: int) -> Mapping[str, dict]:
    """Table by distance of the sigma of the vector between two frames (root mean square over pairs), model units.

    {} without a covariance. After the best similarity of the whole, as all of ``PositionSigma``: the sigma of the scale
    is not in it. Distances of fewer than ``min_pairs`` pairs are left out.
    """
    if sigma.covariance is None:
        return {}
    count = len(sigma.frame_ids)
    places = np.array([_centre(model.frame(k)) for k in sigma.frame_ids])
    # of C (F, 3, F, 3) the traces of its blocks (F, F): var(p_j - p_i) = C_ii + C_jj - 2 C_ij
    shared = np.einsum("iaja->ij", sigma.covariance.reshape(count, 3, count, 3))
    own = np.diag(shared)
    variance = squareform(own[:, None] + own[None, :] - shared - shared.T, checks=False)
    apart = pdist(places)
    there = apart > 0
    step = np.round(_STEPS * np.log2(apart[there])).astype(int)
    apart, variance = apart[there], np.clip(variance[there], 0, None)
    rows = []
    for k in np.unique(step):
        of = step == k
        if of.sum() >= min_pairs:
            rows.append([float(np.median(apart[of])), float(np.sqrt(variance[of].mean())), int(of.sum())])
    return {BETWEEN: {"columns": _COLUMNS, "rows": rows}} if rows else {}


def own_paths(model: pycolmap.Reconstruction, sigma: PositionSigma, names: Mapping[int, str]) -> Mapping[str, dict]:
    """Table by camera of the median sigma of its positions after the best similarity of these alone, model units.

    {} but for a relaxed rig, whose images are frames of their own: the sigmas of all of them together say how well the
    cameras' places in the rig are known, and not the path of the rig.
    """
    camera = np.array([_only_camera(model.frame(k)) for k in sigma.frame_ids])
    if sigma.covariance is None or (camera < 0).any() or len(np.unique(camera)) < 2:
        return {}
    places = np.array([_centre(model.frame(k)) for k in sigma.frame_ids])
    rows = []
    for key in np.unique(camera).tolist():
        of = np.flatnonzero(camera == key)
        if len(of) < _LEAST_FRAMES:
            continue
        at = (3 * of[:, None] + np.arange(3)).ravel()
        moves = motions(places[of] - places[of].mean(axis=0)).reshape(-1, 7)
        left = np.eye(len(at)) - moves @ np.linalg.pinv(moves)
        own = np.diag(left @ sigma.covariance[np.ix_(at, at)] @ left.T).reshape(-1, 3).sum(axis=1)
        rows.append([names.get(key, key), float(np.median(np.sqrt(np.clip(own, 0, None)))), len(of)])
    return {PATHS: {"columns": ["camera", "sigma", "frames"], "rows": rows}} if rows else {}


def _only_camera(frame: pycolmap.Frame) -> int:
    """Id of the camera of a frame of one image, else -1."""
    sensors = {d.sensor_id.id for d in frame.image_ids}
    return sensors.pop() if len(sensors) == 1 else -1


def _centre(frame: pycolmap.Frame) -> np.ndarray:
    """(3,) place of a frame in the world."""
    pose = frame.rig_from_world
    return np.full(3, np.nan) if pose is None else np.asarray(pose.inverse().translation, float)
