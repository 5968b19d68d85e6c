"""Shapes of surveys: where the rig stands at each frame, and the surfaces it sees; its frames as waypoints: CSV in
local metres, and with a place on the Earth GeoJSON and KML.

World: x along the first way, y to its left, z up, metres. Body: x right, y down, z forward, which is along the way in
canal, road, corridor and tunnel, to the surface at facade and orbit, and down over a grid (its top then points ahead).
"""

import json
from collections.abc import Callable
from dataclasses import dataclass, replace
from xml.sax.saxutils import escape

import numpy as np
from scipy.spatial.transform import Rotation

from tiegraph.errors import InputError, choose
from tiegraph.geometry.geodesy import Origin, crs_coordinates, geodetic_from_world, make_origin, world_from_geodetic
from tiegraph.geometry.transforms import rigid
from tiegraph.plan.tuning import PathTuning
from tiegraph.text import csv_text

_BEYOND = 4.0  # distances that walls go on before and behind the way
_UP = np.array([0.0, 0.0, 1.0])
_FACETS = 16  # planes that stand for a round wall


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


def make_path(course: Course, tuning: PathTuning) -> Path:
    """The frames and the surface of a shape. Raises SettingsError for an unknown shape, InputError for sizes."""
    shape: Callable[[Course, PathTuning], Path] = choose("shape", course.shape, SHAPES)  # type: ignore[assignment]
    for name in ("length", "width", "height"):
        value = getattr(course, f"{name}_m")
        if not (np.isfinite(value) and value > 0):
            raise InputError(f"--{name} {value:g}: give metres, above zero")
    path = shape(course, tuning)
    if len(path) < 3:
        raise InputError(
            f"the path has {len(path)} frame(s), {course.base_m:.3g} m apart: less than the 3 that an adjustment "
            "needs; give a larger --length, or a smaller --base"
        )
    return path


def _canal(c: Course, tuning: PathTuning) -> Path:
    """Walls on both sides and water below, which is no surface: out and back, each way right of the middle."""
    beside = tuning.passes_apart * c.distance_m / 2 if c.passes > 1 else 0.0
    reach = _BEYOND * c.distance_m
    walls = (_wall(c, -reach, c.distance_m, c.height_m, 1), _wall(c, -reach, -c.distance_m, c.height_m, -1))
    return _ways(c, beside, tuning.camera_m, walls)


def _road(c: Course, tuning: PathTuning) -> Path:
    """The ground and what lines it on both sides."""
    canal = _canal(c, tuning)
    reach, side = _BEYOND * c.distance_m, c.distance_m
    ground = np.array([[c.length_m + 2 * reach, 0, 0], [0, 2 * side, 0]])
    return replace(canal, surface=(*canal.surface, Facet(np.array([-reach, -side, 0.0]), ground)))


def _corridor(c: Course, tuning: PathTuning) -> Path:
    """Two walls, floor and ceiling."""
    reach, side = _BEYOND * c.distance_m, c.distance_m
    walls = [_wall(c, -reach, side, c.height_m, 1), _wall(c, -reach, -side, c.height_m, -1)]
    long = np.array([c.length_m + 2 * reach, 0, 0])
    across = np.array([0, 2 * side, 0])
    walls.append(Facet(np.array([-reach, -side, 0.0]), np.stack([long, across])))
    walls.append(Facet(np.array([-reach, -side, c.height_m]), np.stack([across, long])))
    return _ways(c, 0.0, c.height_m / 2, tuple(walls))


def _tunnel(c: Course, tuning: PathTuning) -> Path:
    """A round lining about the way."""
    angle = 2 * np.pi * np.arange(_FACETS + 1) / _FACETS
    ring = c.distance_m * np.stack([np.zeros_like(angle), np.cos(angle), np.sin(angle)], axis=1)
    reach = _BEYOND * c.distance_m
    start, long = np.array([-reach, 0, 0]), np.array([c.length_m + 2 * reach, 0, 0])
    return _ways(c, 0.0, 0.0, tuple(Facet(start + a, np.stack([long, b - a])) for a, b in zip(ring, ring[1:])))


def _facade(c: Course, tuning: PathTuning) -> Path:
    """A wall, by rows to and fro."""
    wall = Facet(np.array([0, c.distance_m, 0]), np.array([[c.length_m, 0, 0], [0, 0, c.height_m]]))
    lines = [np.array([0, 0, z]) for z in _evenly(c.height_m, c.row_m)]
    return _rows(c, lines, _turn(np.array([0.0, 1.0, 0.0])), "row", (wall,))


def _grid(c: Course, tuning: PathTuning) -> Path:
    """Ground from above, by lines to and fro; it goes on round about."""
    more = c.distance_m
    edges = np.diag([c.length_m + 2 * more, c.width_m + 2 * more, 0.0])[:2]
    ground = Facet(np.array([-more, -more, 0.0]), edges)
    lines = [np.array([0, y, c.distance_m]) for y in _evenly(c.width_m, c.row_m)]
    ahead = np.stack([[0.0, -1, 0], [-1, 0, 0], [0, 0, -1]], axis=1)  # right of the body = right of the way
    return _rows(c, lines, ahead, "line", (ground,))


def _orbit(c: Course, tuning: PathTuning) -> Path:
    """A round object of the given width on the ground, by rings about it. Frames are a base apart on its surface."""
    radius = c.width_m / 2
    angle = 2 * np.pi * np.arange(_FACETS + 1) / _FACETS
    ring = radius * np.stack([np.cos(angle), np.sin(angle), np.zeros_like(angle)], axis=1)
    up = np.array([0, 0, c.height_m])
    surface = tuple(Facet(a, np.stack([b - a, up])) for a, b in zip(ring, ring[1:]))
    reach = radius + _BEYOND * c.distance_m
    ground = Facet(np.array([-reach, -reach, 0.0]), np.diag([2 * reach, 2 * reach, 0.0])[:2])
    count = max(3, int(np.ceil(2 * np.pi * radius / c.base_m)))
    around = 2 * np.pi * np.arange(count) / count
    out = np.stack([np.cos(around), np.sin(around), np.zeros(count)], axis=1)
    levels = _evenly(c.height_m, c.row_m)
    far, down = radius + c.distance_m, np.radians(max(-c.turned_deg[1], 0.0))
    lifted = far * np.sin(down) * _UP  # a rig that looks down stands higher, so that it sees the middle of its ring
    poses = [rigid(_turn(-o) @ _mounted(c), far * np.cos(down) * o + lifted + z * _UP) for z in levels for o in out]
    way = np.tile(far * around, len(levels))
    names = tuple(f"ring {k + 1}" for k in range(len(levels)))
    leg = np.repeat(np.arange(len(levels)), count)
    return Path(world_from_body=np.stack(poses), way_m=way, leg=leg, legs=names, surface=(*surface, ground))


SHAPES = {
    "canal": _canal, "road": _road, "corridor": _corridor, "tunnel": _tunnel, "facade": _facade, "grid": _grid,
    "orbit": _orbit,
}  # fmt: skip


def _wall(c: Course, start: float, y: float, height: float, side: int) -> Facet:
    """A wall along the way at ``y``, seen from the side away from ``side``."""
    edges = np.array([[c.length_m - 2 * start, 0, 0], [0, 0, height]])
    return Facet(np.array([start, y, 0.0]), edges if side > 0 else edges[::-1])


def _ways(c: Course, beside: float, height: float, surface: tuple[Facet, ...]) -> Path:
    """Out along x, and back for two passes; ``beside`` the middle to the right."""
    steps = _steps(c.length_m, c.base_m)
    parts = []
    for k in range(c.passes):
        forward = np.array([1.0 if k % 2 == 0 else -1.0, 0, 0])
        at = steps if k % 2 == 0 else c.length_m - steps
        places = np.stack([at, np.full_like(at, -beside * forward[0]), np.full_like(at, height)], axis=1)
        turn = _turn(forward) @ _mounted(c)
        parts.append(np.stack([rigid(turn, place) for place in places]))
    names = ("the way",) if c.passes == 1 else tuple(f"pass {k + 1} {('out', 'back')[k % 2]}" for k in range(c.passes))
    leg = np.repeat(np.arange(c.passes), len(steps))
    way = np.tile(steps, c.passes)
    return Path(world_from_body=np.concatenate(parts), way_m=way, leg=leg, legs=names, surface=surface)


def _rows(c: Course, lines: list[np.ndarray], turn: np.ndarray, word: str, surface: tuple[Facet, ...]) -> Path:
    """To and fro along x from the starts (3,) of lines. The body looks the same way on all: it does not turn about."""
    steps = _steps(c.length_m, c.base_m)
    poses, way = [], []
    for k, start in enumerate(lines):
        for s in steps:
            at = s if k % 2 == 0 else c.length_m - s
            poses.append(rigid(turn @ _mounted(c), start + np.array([at, 0, 0])))
        way.append(steps)
    names = tuple(f"{word} {k + 1}" for k in range(len(lines)))
    leg = np.repeat(np.arange(len(lines)), len(steps))
    return Path(world_from_body=np.stack(poses), way_m=np.concatenate(way), leg=leg, legs=names, surface=surface)


def _steps(length: float, base: float) -> np.ndarray:
    return np.arange(int(np.floor(length / base + 1e-9)) + 1) * float(base)


def _evenly(size: float, row: float) -> np.ndarray:
    """Middles of rows that cover a size, no further apart than ``row``."""
    count = max(1, int(np.ceil(size / row - 1e-9)))
    return (np.arange(count) + 0.5) * size / count


def _turn(forward: np.ndarray) -> np.ndarray:
    """world_from_body (3, 3) of a level body that looks along ``forward``."""
    right = np.cross(forward, _UP)
    return np.stack([right, -_UP, forward], axis=1)


def _mounted(c: Course) -> np.ndarray:
    """body_from_mounted (3, 3): yaw to the right about the body's down axis, then pitch up."""
    return np.asarray(Rotation.from_euler("YX", c.turned_deg, degrees=True).as_matrix())


# --- waypoints -----------------------------------------------------------------------------------------------------


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


def waypoint_geojson(path: Path, anchor: Anchor) -> str:
    """A line for each leg and a point for each frame (RFC 7946: longitude, latitude, height on WGS84)."""
    columns, rows = _waypoints(path, anchor)
    features: list[dict] = []
    for name, line in _lines(path, anchor):
        geometry = {"type": "LineString" if len(line) > 1 else "MultiPoint", "coordinates": line}
        features.append({"type": "Feature", "geometry": geometry, "properties": {"leg": name}})
    for row in rows:
        facts = dict(zip(columns, row))
        at = [facts.pop("longitude"), facts.pop("latitude"), facts["height_m"]]
        features.append({"type": "Feature", "geometry": {"type": "Point", "coordinates": at}, "properties": facts})
    return json.dumps({"type": "FeatureCollection", "features": features}, indent=1) + "\n"


def waypoint_kml(path: Path, anchor: Anchor) -> str:
    """Legs and frames for map programs (OGC KML 2.2, absolute heights)."""
    columns, rows = _waypoints(path, anchor)
    marks = []
    for name, line in _lines(path, anchor):
        at = " ".join(",".join(map(str, p)) for p in line)
        marks.append(f"<Placemark><name>{escape(name)}</name><LineString><altitudeMode>absolute</altitudeMode>"
                     f"<coordinates>{at}</coordinates></LineString></Placemark>")  # fmt: skip
    for row in rows:
        facts = dict(zip(columns, row))
        at = f"{facts['longitude']},{facts['latitude']},{facts['height_m']}"
        marks.append(f"<Placemark><name>{facts['number']}</name><Point><altitudeMode>absolute</altitudeMode>"
                     f"<coordinates>{at}</coordinates></Point></Placemark>")  # fmt: skip
    body = "\n".join(marks)
    head = '<?xml version="1.0" encoding="UTF-8"?>\n<kml xmlns="http://www.opengis.net/kml/2.2"><Document>\n'
    return f"{head}<name>tiegraph plan</name>\n{body}\n</Document></kml>\n"


def _lines(path: Path, anchor: Anchor) -> list[tuple[str, list[list[float]]]]:
    geodetic, _ = anchor.coordinates(path.centres)
    at = np.column_stack([np.round(geodetic[:, [1, 0]], 9), np.round(geodetic[:, 2], 3)])
    return [(name, at[path.leg == k].tolist()) for k, name in enumerate(path.legs)]
