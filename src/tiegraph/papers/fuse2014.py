"""Paper 002: Fuse, Harada 2014, Image selection for 3D measurement based on network design.

Pairs are thinned by weak matches (section 2.2), similar images (2.3) and minimum cuts of the image connectivity graph
(3.2, 4.2.3), whose capacities are the accuracies of pairs: how little a bundle adjustment of two images moves their
base (2.4, ``two_view``; the glue asks for it and hands it in as a column of the pair table).
"""

from functools import partial

import cv2
import numpy as np
import pycolmap
from scipy.sparse import csr_array
from scipy.sparse.csgraph import breadth_first_order

from tiegraph.design.design import DesignResult
from tiegraph.geometry import transforms
from tiegraph.scene.colmapmodel import options_of, rigid3d
from tiegraph.scene.graph import cheapest_cut, forest, parts, symmetric
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.rig import on_plane
from tiegraph.scene.scene import Scene

# The paper's own numbers: they define its method.
WEAK = 25  # matches, paper 002 section 4.2.1
SIMILAR = 500.0  # distance to the object over base length, paper 002 section 4.2.2
PARTS = 5  # consecutive partial graphs cut beside the whole one, paper 002 section 4.2.3
LEAST = 8  # matches, and points in front of both images, that determine two views linearly
_TRIALS, _CONFIDENCE = 200, 0.999  # of the RANSAC for the essential matrix
_FARTHEST = 1e4  # bases: points beyond are at infinity
_ITERATIONS = 20  # of the bundle adjustment, at most


def thinned(pairs: Pairs, scene: Scene, expected: np.ndarray, safe: bool) -> DesignResult:
    """Thin the pairs as paper 002 does; ``safe`` takes back what holds together images that were connected.

    expected (P,) preview matches. Taken literally each cut severs its graph between the first and the last image; the
    numbers the paper prints (1161 edges by 6 cuts, at 17 edges a node) are those of complete severings too. The parts
    may still hang together through each other, the whole does not.
    """
    before = pairs.kept()
    weak = pairs.drop(expected < WEAK, "weak")
    order = image_order(scene)
    place, gone = np.argsort(order), np.zeros(len(order), bool)
    for k in np.flatnonzero((weak.dropped == 0) & (weak.h_over_b > SIMILAR)):
        i, j = weak.i[k], weak.j[k]  # of two images whose base is too short for their distance the later one goes
        if not gone[i] and not gone[j]:
            gone[i if place[i] > place[j] else j] = True
    similar = weak.drop(gone[weak.i] | gone[weak.j], "similar")
    thin = similar.drop(_cut_rows(similar, capacities(similar, expected), order), "cut")
    taken_back = 0
    if safe:
        # The strongest dropped pairs that tie what was connected before
        label = parts(thin.kept().i, thin.kept().j, len(scene))
        lost = np.flatnonzero((pairs.dropped == 0) & (thin.dropped != 0))
        back = lost[forest(label[pairs.i[lost]], label[pairs.j[lost]], expected[lost], len(scene))]
        dropped = thin.dropped.copy()
        dropped[back] = 0
        thin, taken_back = thin.with_(dropped=dropped), len(back)
    kept, n = thin.kept(), len(scene)
    counts: dict[str, float] = {
        "weak": _count(pairs, weak),
        "similar": _count(weak, similar),
        "cut": _count(similar, thin) if not safe else _count(similar, thin) + taken_back,
        "pieces_before": _pieces(before, before, n),
        "pieces": _pieces(kept, before, n),
    }
    note = f"fuse2014: {counts['pieces_before']} components of the pairs before, {counts['pieces']} after"
    more = f"; {taken_back} pairs taken back to keep it together" if safe else ""
    notes, known = [note + more], int(np.isfinite(before.sigma_m).sum())
    if known < len(before):
        of = f"{known} of {len(before)} pairs, of the others matches (B/H)^2 in its place"
        notes.append(f"fuse2014: capacities by two-view bundle adjustment of {of}")
    return DesignResult(thin, tuple(notes), counts)


fuse2014 = partial(thinned, safe=False)
fuse2014_safe = partial(thinned, safe=True)


def image_order(scene: Scene) -> np.ndarray:
    """(N,) images in order of pass, step and camera: the paper's first to last frame."""
    return np.lexsort((scene.sensor_key, scene.sequence_index[scene.frame], scene.sequence[scene.frame]))


def capacities(pairs: Pairs, expected: np.ndarray) -> np.ndarray:
    """(P,) the paper's accuracy of a pair, 1 / |T - T'|^2, up to one factor for all pairs.

    1 / sigma^2 where the pair's sigma is known. Else the precision of the direction of a unit base, known from n
    matches: (f / sigma_px)^2 n (B/H)^2 (Kraus, Photogrammetry: normal case), n alone where H/B is not known.
    """
    ratio = np.where(np.isfinite(pairs.h_over_b), pairs.h_over_b, np.nan)
    usual = float(np.nanmedian(ratio)) if np.isfinite(ratio).any() else 1.0
    guess = np.maximum(expected, 1.0) / np.maximum(np.where(np.isnan(ratio), usual, ratio), 1e-3) ** 2
    known = np.isfinite(pairs.sigma_m)
    if not known.any():
        return guess
    exact = 1.0 / np.maximum(pairs.sigma_m, 1e-6) ** 2
    scale = float(np.median(exact[known] / guess[known]))
    return np.where(known, exact, guess * scale)


def _cut_rows(pairs: Pairs, capacity: np.ndarray, order: np.ndarray) -> np.ndarray:
    """(P,) bool: pairs in the minimum cut of the whole graph or of one of its parts (002, 3.2 and 4.2.3)."""
    used = np.zeros(len(order), bool)
    kept = pairs.dropped == 0
    used[pairs.i[kept]] = used[pairs.j[kept]] = True
    nodes = order[used[order]]  # paper 002: the nodes are the images left
    out = np.zeros(len(pairs), bool)
    for part in [nodes, *np.array_split(nodes, PARTS)]:
        out |= _minimum_cut(pairs, kept, capacity, part)
    return out


def _minimum_cut(pairs: Pairs, kept: np.ndarray, capacity: np.ndarray, nodes: np.ndarray) -> np.ndarray:
    """(P,) bool: pairs whose removal separates the first node from the last at the least capacity."""
    if len(nodes) < 2:
        return np.zeros(len(pairs), bool)
    number = np.full(int(max(pairs.j.max(initial=0), nodes.max())) + 1, -1)
    number[nodes] = np.arange(len(nodes))
    a, b = number[pairs.i], number[pairs.j]
    rows = kept & (a >= 0) & (b >= 0)
    a, b, n = a[rows], b[rows], len(nodes)
    degree = np.bincount(a, capacity[rows], n) + np.bincount(b, capacity[rows], n)
    # Scipy's maximum flow counts in 32 bit integers
    whole = np.maximum(np.rint(capacity[rows] * (2.0e9 / max(float(degree.max(initial=0.0)), 1e-300))), 1)
    graph = symmetric(a, b, whole, n)
    graph = csr_array((graph.data.astype(np.int32), graph.indices, graph.indptr), shape=(n, n))
    if n - 1 not in breadth_first_order(graph, 0, return_predecessors=False):
        return np.zeros(len(pairs), bool)  # apart already
    near = cheapest_cut(graph, 0, n - 1)
    out = np.zeros(len(pairs), bool)
    out[np.flatnonzero(rows)[near[a] != near[b]]] = True
    return out


def _count(before: Pairs, after: Pairs) -> int:
    return int(np.sum(before.dropped == 0) - np.sum(after.dropped == 0))


def _pieces(kept: Pairs, before: Pairs, images: int) -> int:
    """Components of the images that had any pair before; an image left alone is one."""
    label = parts(kept.i, kept.j, images)
    return len(np.unique(label[np.concatenate([before.i, before.j])]))


def two_view(
    xy_a: np.ndarray,
    xy_b: np.ndarray,
    camera_a: pycolmap.Camera,
    camera_b: pycolmap.Camera,
    max_error_px: float,
    pixel: float = 1.0,
) -> tuple[float, float] | None:
    """Reconstruct two images from matches xy_a, xy_b (K, 2) pixels and adjust them; None where no geometry is found.

    Gives |T - T'| of unit bases, T of the reconstruction from the essential matrix, T' after the adjustment (paper 002,
    section 2.4), and the distance of the points from the first image, in bases (its equation 1, but the median: at a
    short base a few points come out so far away that they alone make the mean).

    ``max_error_px``: tolerance of the essential matrix, pixels of the matches; ``pixel``: size of a pixel of the
    matches in those of the cameras (previews are reduced images).
    """
    if len(xy_a) < LEAST:
        return None
    rays_a, rays_b = on_plane(camera_a, xy_a), on_plane(camera_b, xy_b)
    good = np.isfinite(rays_a).all(axis=1) & np.isfinite(rays_b).all(axis=1)
    if good.sum() < LEAST:
        return None
    focal = 0.5 * (camera_a.mean_focal_length() + camera_b.mean_focal_length())
    eye = np.eye(3)
    bound = max_error_px * pixel / focal
    essential, mask = cv2.findEssentialMat(rays_a[good], rays_b[good], eye, cv2.RANSAC, _CONFIDENCE, bound, _TRIALS)
    if essential is None or essential.shape != (3, 3):
        return None
    _, rotation, base, front, points = cv2.recoverPose(
        essential, rays_a[good], rays_b[good], eye, distanceThresh=_FARTHEST, mask=mask.copy()
    )
    ahead = np.asarray(front).ravel() > 0
    if ahead.sum() < LEAST:
        return None
    xyz = (points[:3] / points[3]).T[ahead]
    b_from_a = transforms.rigid(rotation, base.ravel())
    moved = _adjusted((xy_a[good][ahead], xy_b[good][ahead]), (camera_a, camera_b), b_from_a, xyz)
    before = b_from_a[:3, 3] / np.linalg.norm(b_from_a[:3, 3])
    after = moved / max(float(np.linalg.norm(moved)), 1e-12)
    distance = float(np.median(np.linalg.norm(xyz, axis=1)))
    return float(np.linalg.norm(before - after)), distance


def _adjusted(
    xy: tuple[np.ndarray, np.ndarray],
    cameras: tuple[pycolmap.Camera, ...],
    b_from_a: np.ndarray,
    xyz: np.ndarray,
) -> np.ndarray:
    """Translation (3,) of the second image after a bundle adjustment with fixed intrinsics."""
    model = pycolmap.Reconstruction()
    for k, (camera, pose) in enumerate(zip(cameras, (np.eye(4), b_from_a)), 1):
        own = pycolmap.Camera(model=camera.model, width=camera.width, height=camera.height, params=camera.params)
        own.camera_id = k
        model.add_camera_with_trivial_rig(own)
        image = pycolmap.Image(name=str(k), keypoints=np.asarray(xy[k - 1], float), camera_id=k, image_id=k)
        model.add_image_with_trivial_frame(image, rigid3d(pose))
    for n, point in enumerate(xyz):
        track = pycolmap.Track([pycolmap.TrackElement(1, n), pycolmap.TrackElement(2, n)])
        model.add_point3D(point, track)
    options = options_of(_ITERATIONS)
    config = pycolmap.BundleAdjustmentConfig()
    for k in (1, 2):
        config.add_image(k)
        config.set_constant_cam_intrinsics(k)
    config.fix_gauge(pycolmap.BundleAdjustmentGauge.TWO_CAMS_FROM_WORLD)
    level, pycolmap.logging.minloglevel = pycolmap.logging.minloglevel, 2  # pairs without a base make it complain
    try:
        pycolmap.create_default_ceres_bundle_adjuster(options, config, model).solve()
    finally:
        pycolmap.logging.minloglevel = level
    return np.asarray(model.image(2).cam_from_world().translation, float)
