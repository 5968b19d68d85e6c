"""The overlap of a few given pairs by poses alone: all looks of one camera at equally many points at once."""

from collections.abc import Iterator, Sequence

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.network.coarse.proxy import View, assumed_proxy
from tiegraph.network.coarse.visible import Rays, in_view
from tiegraph.network.tuning.coarse import CoarseTuning

_POINTS = 100_000  # at which looks are worked out at once


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
    count, camera = np.diff(starts)[owner], np.array([id(c) for c in cameras])[looking]
    share = np.zeros(len(owner))
    for alike in _parts_alike(camera, count):
        rows = starts[owner[alike], None] + np.arange(count[alike[0]])
        pose = cam_from_world[looking[alike]]
        ray = proxy.points[rows] - transforms.centre(pose)[:, None]
        local = (ray @ pose[:, :3, :3].swapaxes(1, 2)).reshape(-1, 3)
        view = View.of(cameras[looking[alike[0]]], tuning.visible.guessed_view_deg)
        rays = Rays(view, 0.0, rows.ravel(), world=ray.reshape(-1, 3), local=local)
        share[alike] = in_view(rays, proxy, tuning.visible)[0].reshape(rows.shape).mean(axis=1)
    out = np.full(len(i), np.nan)
    out[there] = share.reshape(2, -1).max(axis=0)
    return out


def _parts_alike(camera: np.ndarray, count: np.ndarray) -> Iterator[np.ndarray]:
    """Looks (K,) of one camera each at equally many points, in parts that bound memory; those at none are left out."""
    for key, points in set(zip(camera.tolist(), count.tolist())):
        alike, size = np.flatnonzero((camera == key) & (count == points)), max(1, _POINTS // max(points, 1))
        yield from (alike[k : k + size] for k in range(0, len(alike), size) if points)
