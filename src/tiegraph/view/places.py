"""What is known of a place that was picked on the cloud: the point of the file, its coordinates, its sigma, and whether
something hides it from an image."""

from dataclasses import dataclass, field
from typing import Any

import numpy as np

from tiegraph.geometry import transforms
from tiegraph.geometry.align import PlacementError
from tiegraph.geometry.geodesy import Origin, geodetic_from_world
from tiegraph.scene.results import Cloud

_BEHIND = 1.02  # a place this much farther than the surface in its pixel is hidden: far above any sigma of a depth


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
    return None if not np.isfinite(around).any() else bool(z > _BEHIND * np.nanmax(around))
