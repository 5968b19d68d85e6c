"""Where images with known poses see a place: what a person is shown who is to mark it."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.scene.rays import on_plane

_SAME = 1e-3  # on the plane z = 1, between a ray and the way there and back: lenses fold beyond their images


@dataclass(frozen=True)
class View:
    """A posed image: cam_from_world (4, 4), camera."""

    pose: np.ndarray
    camera: pycolmap.Camera


def seen_in(views: Mapping[int, View], place: np.ndarray) -> dict[int, tuple[float, float]]:
    """Pixels at which images, by index, see a place (3,), the most central first; what hides it is not asked for."""
    found = {}
    for k, view in views.items():
        there = transforms.apply(view.pose, place[None])[0]
        if not np.isfinite(there).all() or there[2] <= 0:
            continue
        xy = view.camera.img_from_cam(there)
        if xy is None or not np.isfinite(xy).all():
            continue
        size = np.array([view.camera.width, view.camera.height])
        inside = ((np.ravel(xy) >= 0) & (np.ravel(xy) <= size)).all()
        if inside and np.abs(on_plane(view.camera, np.ravel(xy)[None])[0] - there[:2] / there[2]).max() < _SAME:
            found[k] = (float(xy[0]), float(xy[1]))
    middle = {k: np.linalg.norm(np.array(xy) / (views[k].camera.width, views[k].camera.height) - 0.5)
              for k, xy in found.items()}  # fmt: skip
    return dict(sorted(found.items(), key=lambda item: (round(float(middle[item[0]]), 6), item[0])))
