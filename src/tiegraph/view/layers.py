"""What the page draws in local coordinates, those of the CRS minus the middle of the cloud: cameras, rasters, lines.
What is known of a place that was picked on the cloud: the point of the file, its coordinates, its sigma, and whether
something hides it from an image.
"""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from typing import Any

import cv2
import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.geometry.geodesy import Origin, geodetic_from_world
from tiegraph.geometry.transforms import PlacementError
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.results import Cloud
from tiegraph.scene.rig import on_plane

View = tuple[np.ndarray, pycolmap.Camera]
"""cam_from_world (4, 4) and camera of an image."""


def cameras(names: Sequence[str], views: Sequence[View], local_from_world: np.ndarray) -> list[dict[str, Any]]:
    """Name, size (pixels), projection centre (3) and unit rays of the four corners (4, 3) of each image.

    A corner that its lens has no ray of (90 degrees off the axis and more) is drawn 45 degrees off in x and y."""
    out = []
    for name, (pose, camera) in zip(names, views):
        size = np.array([camera.width, camera.height], float)
        sides = np.array([[-1.0, -1.0], [1.0, -1.0], [1.0, 1.0], [-1.0, 1.0]])
        plane = on_plane(camera, (sides + 1) / 2 * size)
        rays = np.c_[np.where(np.isfinite(plane), plane, sides), np.ones(4)] @ pose[:3, :3]
        rays /= np.linalg.norm(rays, axis=1, keepdims=True)
        centre = transforms.centre(pose) + local_from_world
        out.append({"name": name, "size": size.tolist(), "at": centre.tolist(), "corners": rays.tolist()})
    return out


def ties(pairs: Pairs, rows: Mapping[int, int]) -> list[list[int]]:
    """[row, row, verified matches] of each pair that was kept, the weakest first; ``rows``: of the images with a pose,
    by scene index."""
    kept = pairs.kept()
    found = zip(kept.i.tolist(), kept.j.tolist(), kept.inliers.tolist())
    return sorted(([rows[i], rows[j], n] for i, j, n in found if i in rows and j in rows and n > 0), key=lambda t: t[2])


def mesh(w: np.ndarray, frame: Mapping[str, Any], middle: np.ndarray) -> np.ndarray:
    """Local places (rows, columns, 3) f4 of heights w (rows, columns) that span a raster, NaN where not known.

    ``frame``: what its ``frame.json`` says; ``middle`` (3,) in the CRS."""
    rows, columns = w.shape
    wide, high = np.array(frame["size"]) * frame["pixel"]
    left, top = frame["upper_left_uv"]
    u = left + (np.arange(columns) + 0.5) / columns * wide
    v = top - (np.arange(rows) + 0.5) / rows * high
    uvw = np.stack([*np.meshgrid(u, v), w], axis=-1).reshape(-1, 3)
    crs_from_surface = transforms.invert(np.array(frame["surface_from_crs"], float))
    return (transforms.apply(crs_from_surface, uvw) - middle).astype(np.float32).reshape(rows, columns, 3)


def strung(lines: Sequence[np.ndarray], middle: np.ndarray) -> np.ndarray:
    """Local vertices (N, 3) f4 of lines (K, 3) in the CRS one after the other, a row of NaN after each."""
    gap = np.full((1, 3), np.nan)
    return np.concatenate([gap[:0], *(part for line in lines for part in (line - middle, gap))]).astype(np.float32)


def tinted(w: np.ndarray, shade: np.ndarray) -> np.ndarray:
    """BGRA (rows, columns, 4) u1 of heights (rows, columns) by colour with shades (rows, columns) u1; transparent where
    not known (NaN)."""
    known = np.isfinite(w)
    low, high = np.percentile(w[known], (0.5, 99.5)) if known.any() else (0.0, 1.0)
    level = np.clip((np.where(known, w, low) - low) / max(high - low, 1e-9), 0, 1)
    colour = cv2.applyColorMap(np.rint(255 * level).astype(np.uint8), cv2.COLORMAP_VIRIDIS)
    light = np.where(shade > 0, 0.35 + 0.9 * shade / 255, 1.0)[..., None]  # as the pictures of the report
    return np.dstack([np.clip(colour * light, 0, 255), np.where(known, 255, 0)]).astype(np.uint8)


@dataclass(frozen=True, eq=False)
class Known:
    """What a run says of its accuracy, units of the world: ``inside``, the sigma of a camera inside the model (median);
    ``placed``, that of the model as a whole, None = nothing places it; ``scale`` (share), NaN = not known; of what lies
    ``between`` two frames (K, 2: apart, sigma)."""

    inside: float = 0.0
    placed: PlacementError | None = None
    scale: float = float("nan")
    between: np.ndarray = field(default_factory=lambda: np.zeros((0, 2)))


def nearest(cloud: Cloud, place: np.ndarray) -> int | None:
    """Row of the point nearest to a place (3,) in the world; None without points."""
    return int(np.argmin(np.linalg.norm(cloud.xyz_m - place, axis=1))) if len(cloud) else None


def sigmas(place: np.ndarray, point: float, known: Known) -> dict[str, Any]:
    """Standard deviations (length of the error) of a place (3,) in the world: of the ``point`` by its matching, of the
    ``model`` by the cameras inside it, both together (``shape``), of what places the model east, north and up
    (``placed``), and of all (``world``), which is what the cloud's receipt counts; None = not known."""
    own = float(point) if np.isfinite(point) else 0.0
    shape = float(np.hypot(own, known.inside))
    out = {"point": own or None, "model": known.inside or None, "shape": shape or None, "placed": None, "world": None}
    if known.placed is None:
        return out
    placed = known.placed.sigma(place)[0]
    return out | {"placed": placed.tolist(), "world": float(np.hypot(np.linalg.norm(placed), shape))}


def distance_sigma(distance: float, points: np.ndarray, known: Known) -> float | None:
    """Standard deviation of a distance by those of both ``points`` (2,) by their matching, of the shape of the model
    over so far, and of its scale; None where nothing tells the scale."""
    if not np.isfinite(known.scale):
        return None
    shape = np.interp(distance, *np.vstack([[0.0, 0.0], known.between]).T)
    return float(np.linalg.norm([*points, shape, distance * known.scale]))


def coordinates(place: np.ndarray, origin: Origin | None) -> dict[str, Any]:
    """A place (3,) in the world by the coordinates of its CRS, and by latitude, longitude (degrees) and ellipsoidal
    height; of a world that lies nowhere on the Earth by its own."""
    if origin is None:
        return {"crs": None, "xyz": place.tolist(), "geodetic": None}
    geodetic = geodetic_from_world(place[None], origin)[0]
    return {"crs": origin.crs, "xyz": (place + origin.shift_m).tolist(), "geodetic": geodetic.tolist()}


def hidden(place: np.ndarray, depth: np.ndarray, K: np.ndarray, cam_from_world: np.ndarray) -> bool | None:
    """Whether something in front hides a place (3,) in the world from an image with a depth map (H, W), its camera
    matrix K (3, 3) and pose (4, 4); None where the map says nothing."""
    x, y, z = K @ transforms.apply(cam_from_world, place[None])[0]
    if z <= 0 or not (0 <= x / z < depth.shape[1] and 0 <= y / z < depth.shape[0]):
        return None
    row, column = int(y / z), int(x / z)
    around = depth[max(row - 1, 0) : row + 2, max(column - 1, 0) : column + 2]
    # 2 % behind the surface in its pixel: far above any sigma of a depth
    return None if not np.isfinite(around).any() else bool(z > 1.02 * np.nanmax(around))
