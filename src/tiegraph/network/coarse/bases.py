"""How good the bases of pairs are, by the coarse model: base, distance over base, and the sigma they may give.

The normal case of stereo (Kraus, Photogrammetry): of n matches, each good to one pixel, the place of one image across
the base is known from the other to distance / (focal length * sqrt(n)). It tells pairs apart; of a whole network, whose
images tie in many ways, it says nothing.
"""

import numpy as np
from scipy.sparse import csr_array

from tiegraph.geometry.align import rms_length, umeyama
from tiegraph.scene.matches import Visibility
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.places import of_frames
from tiegraph.scene.scene import Scene

_CHUNK = 20_000  # pairs whose points are looked up at once: bounds the memory


def with_bases(pairs: Pairs, scene: Scene, visibility: Visibility) -> Pairs:
    """The pairs with ``h_over_b`` where both images see points of the model, ``baseline_m`` and ``sigma_m`` (for
    matches good to one pixel, as many as ``score``) where measured positions tell the model's scale too.

    A base that is known by poses in metres stays.
    """
    base = np.linalg.norm(visibility.centre[pairs.i] - visibility.centre[pairs.j], axis=1)
    distance = _distances(pairs, visibility)
    metres = metres_per_unit(scene.measured(), visibility.centre)
    focal_px = scene.focal_px
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = distance / base
        sigma = metres * distance / (0.5 * (focal_px[pairs.i] + focal_px[pairs.j]) * np.sqrt(pairs.score))
    known = np.isfinite(pairs.baseline_m) & scene.metric_positions()
    return pairs.with_(
        baseline_m=np.where(known, pairs.baseline_m, metres * base),
        h_over_b=np.where(np.isfinite(ratio), ratio, np.nan),
        sigma_m=np.where(np.isfinite(sigma), sigma, np.nan),
    )


def metres_per_unit(scene: Scene, centre: np.ndarray) -> float:
    """Size of the model's unit by the frames' prior positions and its image centres (N, 3); NaN where fewer than three
    frames have both, or their spread is no larger than the sigma of the positions."""
    where = of_frames(centre, scene)
    prior = scene.world_from_rig[:, :3, 3]
    both = np.isfinite(where).all(axis=1) & np.isfinite(prior).all(axis=1)
    if both.sum() < 3:
        return float("nan")
    sigma = np.nan_to_num(scene.position_sigma_m[both])  # a trajectory has none
    spread = np.sqrt(np.sum(np.var(prior[both], axis=0)))
    if spread <= rms_length(sigma):
        return float("nan")
    return umeyama(where[both], prior[both]).scale


def _distances(pairs: Pairs, visibility: Visibility) -> np.ndarray:
    """(P,) mean distance of the points that both images see, from either; NaN = none."""
    images = len(visibility.start) - 1
    image = np.repeat(np.arange(images), np.diff(visibility.start))
    away = np.linalg.norm(visibility.xyz[visibility.point] - visibility.centre[image], axis=1)
    shape = (images, len(visibility.xyz))
    far = csr_array((away, visibility.point, visibility.start), shape=shape)
    seen = csr_array((np.ones(len(image)), visibility.point, visibility.start), shape=shape)
    out = np.full(len(pairs), np.nan)
    for first in range(0, len(pairs), _CHUNK):
        rows = slice(first, first + _CHUNK)
        i, j = pairs.i[rows], pairs.j[rows]
        count = seen[i].multiply(seen[j]).sum(axis=1)
        total = far[i].multiply(seen[j]).sum(axis=1) + far[j].multiply(seen[i]).sum(axis=1)
        out[rows] = np.where(count > 0, 0.5 * total / np.maximum(count, 1), np.nan)
    return out
