"""Images of a camera that rotated on the spot, or in which nothing moved: without a base there is no depth and no
model.

A pure rotation with a wrong focal length looks like a translation: points on a sphere, cameras on a circle, sigmas of
a thousandth. So the pairs are tested, with one focal length for all, whether rotations alone explain them (Hartley
and Zisserman, 13.3: x' = K R K^-1 x).
"""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.scene.colmapdatabase import Rows, image_ids
from tiegraph.scene.scene import Scene
from tiegraph.scene.sorting import evenly
from tiegraph.sfm.tuning import MappingTuning

_PAIRS, _MATCHES, _LEAST = 200, 50, 3  # pairs tested, matches of a pair, fewest pairs for a verdict
_ANY = np.geomspace(0.35, 3.0, 28)  # focal lengths as shares of the longer side: views of 110 to 19 degrees
_NEAR = np.geomspace(1 / 1.3, 1.3, 8)  # factors on a focal length from EXIF or a file


def no_base(database: Path, pairs: np.ndarray, scene: Scene, tuning: MappingTuning) -> str:
    """Why none of the verified pairs (P, 2), scene indices, gives depth, in words; "" if some do, or if the cameras
    of a rig are apart."""
    own = pairs[scene.sensor[pairs[:, 0]] == scene.sensor[pairs[:, 1]]]
    if len(own) < _LEAST or any(len(r.sensors) > 1 and not r.stitched() for r in scene.rigs):
        return ""
    ids = image_ids(database, scene)
    with Rows(database) as rows:
        cameras = rows.cameras()
        looked = [(ids[a], ids[b]) for a, b in own[evenly(len(own), _PAIRS)].tolist()]
        xy = np.stack([_parts_of_side(rows, cameras, pair) for pair in looked])
    given = cameras[looked[0][0]]
    focal = given.mean_focal_length() / max(given.width, given.height)
    tried = focal * _NEAR if given.has_prior_focal_length else _ANY
    off, turn_deg = (np.stack(part) for part in zip(*(_turned(xy, f) for f in tried)))
    best = int(np.argmin(np.median(off, axis=1)))
    fits = off[best] < tuning.turned_off
    if fits.mean() < tuning.turned_share:
        return ""
    which = f"{int(fits.sum())} of {len(fits)} pairs"
    if tried[best] * np.median(np.radians(turn_deg[best])) < tuning.turned_off:  # a rotation without visible motion
        return (
            f"nothing moves between the images in {which}: most matches are on parts that do not move relative to the "
            "camera, such as the background behind a turntable or a window in front of the lens: mask them "
            "(masks.folder), or take the photographs in front of a plain background"
        )
    return (
        f"the camera rotated on the spot: a rotation alone explains {which} (focal length {tried[best]:.2f} times the "
        "longer side of the image); without a base there is no depth: take the photographs from different places"
    )


def _parts_of_side(rows: Rows, cameras: Mapping[int, pycolmap.Camera], pair: tuple[int, int]) -> np.ndarray:
    """(2, _MATCHES, 2) key points of a pair from the middle of their images, as shares of the longer side."""
    matches = rows.verified_of(*pair)
    some = matches[np.linspace(0, len(matches) - 1, _MATCHES).round().astype(int)]
    sizes = [np.array([cameras[k].width, cameras[k].height]) for k in pair]
    return np.stack([(rows.keypoints_of(k)[m] - s / 2) / s.max() for k, m, s in zip(pair, some.T, sizes)])


def _turned(xy: np.ndarray, focal: float) -> tuple[np.ndarray, np.ndarray]:
    """(P,) medians of the residuals of pure rotations for key points (P, 2, M, 2), and (P,) degrees of these
    rotations."""
    rays = np.concatenate([xy, np.full((*xy.shape[:3], 1), focal)], axis=3)
    rays /= np.linalg.norm(rays, axis=3, keepdims=True)
    weight = np.ones(rays.shape[:1] + rays.shape[2:3])
    off, turn = weight, np.eye(3)
    for _ in range(3):  # robust by repeated weighting
        u, _, vt = np.linalg.svd(np.einsum("pmi,pm,pmj->pij", rays[:, 1], weight, rays[:, 0]))
        u[:, :, 2] *= np.linalg.det(u @ vt)[:, None]
        turn = u @ vt
        seen = rays[:, 0] @ turn.transpose(0, 2, 1)
        off = np.linalg.norm(focal * seen[..., :2] / seen[..., 2:] - xy[:, 1], axis=2)
        weight = 1 / np.maximum(off, 1e-3)
    return np.median(off, axis=1), transforms.angle_deg(turn, np.eye(3))
