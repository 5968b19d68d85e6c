"""The frames of a planned path as waypoints: CSV in local metres, and with a place on the Earth GeoJSON and KML."""

import json
from dataclasses import dataclass
from xml.sax.saxutils import escape

import numpy as np

from tiegraph.errors import InputError
from tiegraph.geometry.geodesy import Origin, crs_coordinates, geodetic_from_world, make_origin, world_from_geodetic
from tiegraph.plan.path import Path
from tiegraph.text import csv_text


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


def _rows(path: Path, anchor: Anchor | None) -> tuple[list[str], list[list]]:
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
    return csv_text(*_rows(path, anchor))


def waypoint_geojson(path: Path, anchor: Anchor) -> str:
    """A line for each leg and a point for each frame (RFC 7946: longitude, latitude, height on WGS84)."""
    columns, rows = _rows(path, anchor)
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
    columns, rows = _rows(path, anchor)
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
