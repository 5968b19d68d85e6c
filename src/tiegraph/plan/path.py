"""Shapes of surveys: where the rig stands at each frame, and the surfaces it sees; its frames as waypoints: CSV in
local metres, and with a place on the Earth KML.

World: x along the first way, y to its left, z up, metres. Body: x right, y down, z forward, which is along the way in
canal, road, corridor and tunnel, to the surface at facade and orbit, and down over a grid (its top then points ahead).
"""

from collections.abc import Callable
from dataclasses import dataclass
from xml.sax.saxutils import escape

import numpy as np
from scipy.spatial.transform import Rotation

from tiegraph.errors import InputError, choose
from tiegraph.geometry.geodesy import Origin, crs_coordinates, geodetic_from_world, make_origin, world_from_geodetic
from tiegraph.geometry.transforms import rigid
from tiegraph.text import csv_text

_PASSES_APART = 0.3  # ways out and back, in parts of the distance to the wall: one keeps to the right
_CAMERA_M = 2.0  # height of a camera over water or road
_BEYOND = 4.0  # distances that walls go on before and behind the way
_UP = np.array([0.0, 0.0, 1.0])
_FACETS = 16  # planes that stand for a round wall
WAYS = ("canal", "road", "corridor", "tunnel")


@dataclass(frozen=True)
class Course:
    """What a path is made of, metres and degrees. ``base``: way between frames; ``row``: between rows or lines;
    ``turned``: yaw to the right and pitch up, out of the direction that the shape gives the body."""

    shape: str
    distance_m: float
    length_m: float
    width_m: float
    height_m: float
    base_m: float
    row_m: float
    passes: int = 1
    turned_deg: tuple[float, float] = (0.0, 0.0)


@dataclass(frozen=True)
class Facet:
    """A flat piece of surface: a corner and two edges, (3,) each; it is seen from where edge x edge points."""

    corner: np.ndarray
    edges: np.ndarray  # (2, 3)

    @property
    def normal(self) -> np.ndarray:
        """Unit vector (3,)."""
        normal = np.cross(*self.edges)
        return np.asarray(normal / np.linalg.norm(normal))


@dataclass(frozen=True)
class Path:
    """F frames: poses (F, 4, 4) of the body, way (F,) along the leg, number of the leg (F,) with its name; surface."""

    world_from_body: np.ndarray
    way_m: np.ndarray
    leg: np.ndarray
    legs: tuple[str, ...]
    surface: tuple[Facet, ...]

    def __len__(self) -> int:
        return len(self.way_m)

    @property
    def centres(self) -> np.ndarray:
        """(F, 3) places of the body."""
        return self.world_from_body[:, :3, 3]

    @property
    def length_m(self) -> float:
        """From the first frame to the last, with the ways between legs."""
        return float(np.linalg.norm(np.diff(self.centres, axis=0), axis=1).sum())

    def place(self, frame: int) -> str:
        """Where a frame is, in words."""
        return f"{self.way_m[frame]:.0f} m along {self.legs[self.leg[frame]]}"


def make_path(course: Course) -> Path:
    """The frames and the surface of a shape. Raises SettingsError for an unknown shape, InputError for sizes."""
    shape: Callable[[Course], Path] = choose("shape", course.shape, SHAPES)  # type: ignore[assignment]
    path = shape(course)
    if len(path) < 3:
        raise InputError(
            f"the path has {len(path)} frame(s), {course.base_m:.3g} m apart: less than the 3 that an adjustment "
            "needs; give a larger --length, or a smaller --base"
        )
    return path


def _way(c: Course) -> Path:
    """Canal, road, corridor and tunnel: out along x, and back for two passes, each right of the middle of canal and
    road. What lines the way is drawn across it, as pieces from and to (y, z), seen from their left."""
    side, top = c.distance_m, c.height_m
    right, left = (-side, top), (side, 0.0)
    walls = [(left, (side, top)), (right, (-side, 0.0))]
    ground, ceiling = ((-side, 0.0), left), ((side, top), right)
    beside, height = (_PASSES_APART * side / 2 if c.passes > 1 else 0.0), _CAMERA_M
    pieces = {"canal": walls, "road": [*walls, ground], "corridor": [*walls, ground, ceiling]}.get(c.shape, [])
    if c.shape == "tunnel":
        ring = side * _circle(_FACETS + 1, 2 * np.pi / _FACETS)[:, :2]
        pieces = list(zip(ring, ring[1:]))
    if c.shape in ("corridor", "tunnel"):
        beside, height = 0.0, (top / 2 if c.shape == "corridor" else 0.0)
    start, long = np.array([-_BEYOND * side, 0, 0]), np.array([c.length_m + 2 * _BEYOND * side, 0, 0])
    across = [(np.array([0, *a]), np.array([0, *b])) for a, b in pieces]
    surface = tuple(Facet(start + a, np.stack([long, b - a])) for a, b in across)
    steps = _steps(c)
    parts = []
    for k in range(c.passes):
        ahead = 1.0 if k % 2 == 0 else -1.0
        places = np.stack([steps if k % 2 == 0 else c.length_m - steps, *np.full((2, len(steps)), height)], axis=1)
        places[:, 1] = -beside * ahead
        parts.append(rigid(_turn(np.array([ahead, 0, 0])) @ _mounted(c), places))
    names = ("the way",) if c.passes == 1 else tuple(f"pass {k + 1} {('out', 'back')[k % 2]}" for k in range(c.passes))
    return _path(np.stack(parts), np.tile(steps, (c.passes, 1)), names, surface)


def _facade(c: Course) -> Path:
    wall = Facet(np.array([0, c.distance_m, 0]), np.array([[c.length_m, 0, 0], [0, 0, c.height_m]]))
    lines = [np.array([0, 0, z]) for z in _evenly(c.height_m, c.row_m)]
    return _rows(c, lines, _turn(np.array([0.0, 1.0, 0.0])), "row", wall)


def _grid(c: Course) -> Path:
    """Ground from above, by lines to and fro; it goes on round about."""
    more = c.distance_m
    edges = np.diag([c.length_m + 2 * more, c.width_m + 2 * more, 0.0])[:2]
    lines = [np.array([0, y, c.distance_m]) for y in _evenly(c.width_m, c.row_m)]
    ahead = np.stack([[0.0, -1, 0], [-1, 0, 0], [0, 0, -1]], axis=1)  # right of the body = right of the way
    return _rows(c, lines, ahead, "line", Facet(np.array([-more, -more, 0.0]), edges))


def _orbit(c: Course) -> Path:
    """A round object of the given width on the ground, by rings about it. Frames are a base apart on its surface."""
    radius = c.width_m / 2
    ring = radius * _circle(_FACETS + 1, 2 * np.pi / _FACETS)
    surface = [Facet(a, np.stack([b - a, c.height_m * _UP])) for a, b in zip(ring, ring[1:])]
    reach = radius + _BEYOND * c.distance_m
    surface.append(Facet(np.array([-reach, -reach, 0.0]), np.diag([2 * reach, 2 * reach, 0.0])[:2]))
    count = max(3, int(np.ceil(2 * np.pi * radius / c.base_m)))
    out = _circle(count, 2 * np.pi / count)
    levels = _evenly(c.height_m, c.row_m)
    far, down = radius + c.distance_m, np.radians(max(-c.turned_deg[1], 0.0))
    lifted = far * np.sin(down) * _UP  # a rig that looks down stands higher, so that it sees the middle of its ring
    turns = np.stack([_turn(-o) @ _mounted(c) for o in out])
    poses = np.stack([rigid(turns, far * np.cos(down) * out + lifted + z * _UP) for z in levels])
    way = np.tile(far * 2 * np.pi * np.arange(count) / count, (len(levels), 1))
    return _path(poses, way, tuple(f"ring {k + 1}" for k in range(len(levels))), tuple(surface))


SHAPES = {**dict.fromkeys(WAYS, _way), "facade": _facade, "grid": _grid, "orbit": _orbit}


def _rows(c: Course, lines: list[np.ndarray], turn: np.ndarray, word: str, surface: Facet) -> Path:
    """To and fro along x from the starts (3,) of lines. The body looks the same way on all: it does not turn about."""
    steps = _steps(c)
    along = np.eye(3)[0]
    places = [start + np.outer(steps if k % 2 == 0 else c.length_m - steps, along) for k, start in enumerate(lines)]
    names = tuple(f"{word} {k + 1}" for k in range(len(lines)))
    return _path(rigid(turn @ _mounted(c), np.stack(places)), np.tile(steps, (len(lines), 1)), names, (surface,))


def _path(poses: np.ndarray, way: np.ndarray, legs: tuple[str, ...], surface: tuple[Facet, ...]) -> Path:
    """Of poses (L, K, 4, 4) and ways (L, K) of K frames on each of the legs."""
    leg = np.repeat(np.arange(len(legs)), way.shape[1])
    return Path(world_from_body=poses.reshape(-1, 4, 4), way_m=way.ravel(), leg=leg, legs=legs, surface=surface)


def _steps(c: Course) -> np.ndarray:
    """Ways of the frames on a leg, a base apart."""
    return np.arange(int(np.floor(c.length_m / c.base_m + 1e-9)) + 1) * float(c.base_m)


def _circle(count: int, step: float) -> np.ndarray:
    """(K, 3) places on a circle of radius 1 in the plane of x and y, so many radians apart."""
    angle = step * np.arange(count)
    return np.stack([np.cos(angle), np.sin(angle), np.zeros(count)], axis=1)


def _evenly(size: float, row: float) -> np.ndarray:
    """Middles of rows that cover a size, no further apart than ``row``."""
    count = max(1, int(np.ceil(size / row - 1e-9)))
    return (np.arange(count) + 0.5) * size / count


def _turn(forward: np.ndarray) -> np.ndarray:
    """world_from_body (3, 3) of a level body that looks along ``forward``."""
    return np.stack([np.cross(forward, _UP), -_UP, forward], axis=1)


def _mounted(c: Course) -> np.ndarray:
    """body_from_mounted (3, 3): yaw to the right about the body's down axis, then pitch up."""
    return np.asarray(Rotation.from_euler("YX", c.turned_deg, degrees=True).as_matrix())


@dataclass(frozen=True)
class Anchor:
    """Where the start of the path is on the Earth, and the heading of its first way, degrees clockwise from north."""

    origin: Origin
    heading_deg: float

    def coordinates(self, places: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(N, 3) latitude, longitude, height and (N, 3) east, north, height in the CRS, of places of the path.

        The path is laid on the tangent plane at its start: true metres, whatever the scale of the grid.
        """
        a = np.radians(self.heading_deg)
        along, left = np.array([np.sin(a), np.cos(a), 0]), np.array([-np.cos(a), np.sin(a), 0])
        enu = places[:, :1] * along + places[:, 1:2] * left + places[:, 2:] * np.array([0, 0, 1.0])
        o = self.origin
        geodetic = geodetic_from_world(enu, Origin(o.lat_deg, o.lon_deg, o.height_m))
        return geodetic, crs_coordinates(world_from_geodetic(geodetic, o), o)


def read_anchor(origin: str, heading_deg: float) -> Anchor:
    """The anchor of "LAT,LON" or "LAT,LON,HEIGHT". Raises InputError for what is no place on the Earth."""
    try:
        numbers = [float(word) for word in origin.split(",")]
    except ValueError:
        numbers = []
    if len(numbers) not in (2, 3) or not np.isfinite(numbers).all() or abs(numbers[0]) > 90 or abs(numbers[1]) > 180:
        raise InputError(f"--origin {origin}: give LAT,LON or LAT,LON,HEIGHT in degrees and metres: 35.6965,139.7695")
    if not np.isfinite(heading_deg):
        raise InputError(f"--heading {heading_deg}: give degrees clockwise from north")
    return Anchor(make_origin(numbers[0], numbers[1], numbers[2] if len(numbers) > 2 else 0.0), heading_deg)


def _waypoints(path: Path, anchor: Anchor | None) -> tuple[list[str], list[list]]:
    forward = path.world_from_body[:, :3, 2]
    yaw = np.degrees(np.arctan2(forward[:, 1], forward[:, 0]))
    pitch = np.degrees(np.arcsin(np.clip(forward[:, 2], -1, 1)))
    columns = ["number", "leg", "way_m", "x_m", "y_m", "z_m", "yaw_deg", "pitch_deg"]
    figures = np.round(np.column_stack([path.way_m, path.centres, yaw, pitch]), 3).tolist()
    rows: list[list] = [[k + 1, path.legs[path.leg[k]], *row] for k, row in enumerate(figures)]
    if anchor is None:
        return columns, rows
    geodetic, grid = anchor.coordinates(path.centres)
    columns += ["latitude", "longitude", "height_m", "east_m", "north_m", "crs"]
    for row, (lat, lon, height), (east, north, _) in zip(rows, geodetic.tolist(), grid.tolist()):
        row += [round(lat, 9), round(lon, 9), round(height, 3), round(east, 3), round(north, 3), anchor.origin.crs]
    return columns, rows


def waypoint_csv(path: Path, anchor: Anchor | None) -> str:
    """One frame a line. yaw is counter-clockwise from the first way, pitch up, of the body's forward axis."""
    return csv_text(*_waypoints(path, anchor))


def waypoint_kml(path: Path, anchor: Anchor) -> str:
    """Legs and frames for map programs (OGC KML 2.2, absolute heights)."""
    places = np.round(anchor.coordinates(path.centres)[0], 9)[:, [1, 0, 2]].tolist()
    of_leg = [[p for p, k in zip(places, path.leg) if k == leg] for leg in range(len(path.legs))]
    legs, marks = [("LineString", escape(name), own) for name, own in zip(path.legs, of_leg)], []
    for kind, name, at in [*legs, *(("Point", str(k), [p]) for k, p in enumerate(places, 1))]:
        where = f"<coordinates>{' '.join(','.join(map(str, p)) for p in at)}</coordinates>"
        shape = f"<{kind}><altitudeMode>absolute</altitudeMode>{where}</{kind}>"
        marks.append(f"<Placemark><name>{name}</name>{shape}</Placemark>")
    body = "\n".join(marks)
    head = '<?xml version="1.0" encoding="UTF-8"?>\n<kml xmlns="http://www.opengis.net/kml/2.2"><Document>\n'
    return f"{head}<name>tiegraph plan</name>\n{body}\n</Document></kml>\n"
