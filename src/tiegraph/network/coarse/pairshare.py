"""The overlap of a few given pairs by poses alone."""

from collections.abc import Sequence

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.network.coarse.proxy import View, assumed_proxy
from tiegraph.network.coarse.visible import Rays, in_view
from tiegraph.network.tuning.coarse import CoarseTuning
from tiegraph.scene.graph import spread


def pair_share(
    cam_from_world: np.ndarray,
    cameras: Sequence[pycolmap.Camera | None],
    i: np.ndarray,
    j: np.ndarray,
    range_m: float,
    tuning: CoarseTuning,
) -> np.ndarray:
    """(K,) predicted overlap of a few given pairs by poses alone, at an assumed range; NaN where a pose is unknown.

    The same measure as ``shared_surface`` of an ``assumed_proxy``.
    """
    asked = np.isin(np.arange(len(cameras)), np.concatenate([i, j]))
    proxy = assumed_proxy(np.where(asked[:, None, None], cam_from_world, np.nan), cameras, range_m, tuning)
    known = np.all(np.isfinite(cam_from_world[:, :3]), axis=(1, 2))
    there = np.flatnonzero(known[i] & known[j])
    owner, looking = np.concatenate([i[there], j[there]]), np.concatenate([j[there], i[there]])
    starts = np.searchsorted(proxy.image, np.arange(len(cameras) + 1))  # an assumed proxy is in the order of its images
    count = np.diff(starts)[owner]
    point, look = spread(starts[owner], count), np.repeat(np.arange(len(owner)), count)
    pose, camera = cam_from_world[looking[look]], np.array([id(c) for c in cameras])[looking[look]]
    ray = proxy.points[point] - transforms.centre(pose)
    local = np.einsum("kab,kb->ka", pose[:, :3, :3], ray)
    seen = np.zeros(len(point), bool)
    for one in {id(c): c for c in cameras}.values():
        own = np.flatnonzero(camera == id(one))
        view = View.of(one, tuning.visible.guessed_view_deg)
        rays = Rays(view, 0.0, point[own], world=ray[own], local=local[own])
        seen[own] = in_view(rays, proxy, tuning.visible)[0]
    share = np.bincount(look, seen, minlength=len(owner)) / np.maximum(count, 1)
    out = np.full(len(i), np.nan)
    out[there] = share.reshape(2, -1).max(axis=0)
    return out
