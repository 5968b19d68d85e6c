"""Between geodetic coordinates and the local world: world = CRS coordinates - one recorded shift, in metres."""

from __future__ import annotations

import re
import warnings
from dataclasses import dataclass
from functools import cache, lru_cache
from typing import TYPE_CHECKING, Any

import numpy as np

from tiegraph.errors import InputError

if TYPE_CHECKING:
    from collections.abc import Sequence

    import pyproj  # a tenth of the start of a process, and few processes ask where on the Earth they are

ENU = "ENU"
_TOLD_DATUM_M = 0.5  # datum operations that are less accurate are told
FAR_FACTOR, FAR_FLOOR_M = 10.0, 2000.0  # far from the rest: so many of its radii, and so many metres more


@dataclass(frozen=True)
class Origin:
    """Where the world is on the Earth.

    ``crs`` is "EPSG:n" (projected, metres) or "ENU" (tangent plane at lat, lon, height on WGS84). ``shift_m`` (3,) is
    taken off the CRS coordinates (east, north, height) of every product; zero for ENU.
    """

    lat_deg: float
    lon_deg: float
    height_m: float
    crs: str = ENU
    shift_m: tuple[float, float, float] = (0.0, 0.0, 0.0)

    def to_dict(self) -> dict:
        """JSON-ready."""
        return {**self.__dict__, "shift_m": list(self.shift_m)}

    @staticmethod
    def from_dict(data: dict) -> Origin:
        """Inverse of ``to_dict``."""
        given: dict[str, Any] = {**data, "shift_m": tuple(data["shift_m"])}
        return Origin(**given)


def middle(lat_lon_height: np.ndarray) -> tuple[float, float, float]:
    """The median of positions (N, 3) in each coordinate; those on both sides of 180 degrees are neighbours."""
    lat, lon, height = np.asarray(lat_lon_height, float).T
    beside = float(np.median(lon % 360 if np.ptp(lon) > 180 else lon))
    return float(np.median(lat)), beside - 360 if beside > 180 else beside, float(np.median(height))


def utm_crs(lat_deg: float, lon_deg: float) -> str:
    """EPSG code of the WGS84 / UTM zone of a position."""
    zone = int((lon_deg + 180) // 6) % 60 + 1
    return f"EPSG:{(32600 if lat_deg >= 0 else 32700) + zone}"


def utm_by_name(text: str) -> tuple[str, ...]:
    """EPSG codes of the WGS84 / UTM zones that words such as "UTM10N", "UTM zone 10 N" or "WGS84 UTM 54S" name.

    One code; two, north and south, if the words do not say which; none if they are no name of a zone.
    """
    found = re.fullmatch(r"(?i)\s*(?:WGS\s*_?84\s*[/,]?\s*)?UTM\s*_?(?:zone\s*)?(\d{1,2})\s*([NS])?\s*", text)
    if found is None or not 1 <= int(found[1]) <= 60:
        return ()
    north, south = (f"EPSG:{base + int(found[1])}" for base in (32600, 32700))
    return {"N": (north,), "S": (south,)}.get((found[2] or "").upper(), (north, south))


def make_origin(lat_deg: float, lon_deg: float, height_m: float, crs: str = "auto") -> Origin:
    """Origin at a position; ``crs`` "auto" = its UTM zone, "ENU", or "EPSG:n" (projected, metres).

    The shift is the position rounded to whole 100 m (height: 10 m), so that world coordinates are small and the shift
    is easy to write down. Raises InputError for an unknown or unprojected CRS, and for one whose lengths are more than
    1 % too long or too short at the position: a CRS of another place.
    """
    if crs.lower() == "auto":
        crs = utm_crs(lat_deg, lon_deg)
    if crs.upper() == ENU:
        return Origin(lat_deg=lat_deg, lon_deg=lon_deg, height_m=height_m, crs=ENU)
    check_scale(crs, lat_deg, lon_deg)
    east, north, height = crs_transformer(crs).transform(lon_deg, lat_deg, height_m)
    shift = (round(east / 100) * 100.0, round(north / 100) * 100.0, round(height / 10) * 10.0)
    return Origin(
        lat_deg=lat_deg, lon_deg=lon_deg, height_m=height_m, crs=crs.upper() if ":" in crs[:9] else crs, shift_m=shift
    )


def check_scale(crs: str, lat_deg: float, lon_deg: float) -> None:
    """Raise InputError if lengths in a CRS are off by more than 1 % at a position, or its axes make mirror images."""
    where = f"CRS {crs} ({parse_crs(crs).name})"
    remedy = f"choose {utm_crs(lat_deg, lon_deg)} (--scan.crs auto), ENU or another one for this place"
    here, exchanged = _in_area(parse_crs(crs), *np.array([[lat_deg, lon_deg], [lon_deg, lat_deg]]))
    if exchanged and not here:
        remedy += "; or are latitude and longitude of the positions exchanged? Exchanged they lie in its area"
    place = f"the positions, about lat {lat_deg:.5f}, lon {lon_deg:.5f}"
    # Grid coordinates (east, north) by true metres to the east and north, from places 50 m off
    steps = 50.0 * np.array([[1.0, 0, 0], [-1, 0, 0], [0, 1, 0], [0, -1, 0]])
    lat, lon, _ = geodetic_from_world(steps, Origin(lat_deg, lon_deg, 0.0)).T
    east, north, _ = (np.asarray(v) for v in crs_transformer(crs).transform(lon, lat, np.zeros(4)))
    with np.errstate(invalid="ignore"):  # outside: infinite
        grid = np.stack([[v[0] - v[1], v[2] - v[3]] for v in (east, north)]) / (2 * 50.0)
    if not np.isfinite(grid).all():
        raise InputError(f"{where}: {place}, lie outside it: {remedy}")
    largest, smallest = np.linalg.svd(grid, compute_uv=False)
    off = max(largest - 1, 1 - smallest)
    if off > 0.01:  # of lengths in a grid: a UTM zone has 0.001 inside and 0.004 in its neighbours
        scales = f"{smallest:.4f} to {largest:.4f} times the true ones"
        raise InputError(f"{where}: lengths in it are {scales} at {place}: {remedy}")
    if np.linalg.det(grid) < 0:
        raise InputError(f"{where}: its axes make mirror images of east and north: {remedy}")


def _in_area(crs: pyproj.CRS, lat: np.ndarray, lon: np.ndarray) -> np.ndarray:
    """(N,) whether positions lie in the area of use of a CRS; all do where it names none."""
    area = crs.area_of_use
    if area is None:
        return np.ones(len(lat), bool)
    lon = (lon + 180) % 360 - 180
    across = area.west > area.east  # over the date line
    inside = (lon >= area.west) | (lon <= area.east) if across else (lon >= area.west) & (lon <= area.east)
    return inside & (lat >= area.south) & (lat <= area.north)


def within_area(crs: str, east_north: np.ndarray) -> np.ndarray:
    """(N,) whether coordinates (N, 2) of a CRS lie in its area of use; none do where it names none."""
    import pyproj

    parsed = pyproj.CRS.from_user_input(crs)
    flat = parsed.sub_crs_list[0] if parsed.is_compound else parsed
    if parsed.area_of_use is None or not len(east_north):
        return np.zeros(len(east_north), bool)
    to_degrees = pyproj.Transformer.from_crs(flat, "EPSG:4326", always_xy=True)
    lon, lat = to_degrees.transform(*np.asarray(east_north, float).T)
    return _in_area(parsed, lat, lon)


def area_note(crs: str, lat_lon_height: np.ndarray) -> str:
    """What to say of positions (N, 3) outside the area of use of a CRS; "" if there are none."""
    if crs.upper() == ENU:
        return ""
    parsed = parse_crs(crs)
    outside = ~_in_area(parsed, *lat_lon_height[:, :2].T)
    if not outside.any():
        return ""
    lat, lon = lat_lon_height[np.flatnonzero(outside)[0], :2]
    return (
        f"--scan.crs {crs} ({parsed.name}): {outside.sum()} of {len(outside)} positions lie outside its area of use "
        f"({parsed.area_of_use.name if parsed.area_of_use else ''}), such as lat {lat:.5f}, lon {lon:.5f}; "
        f"{utm_crs(lat, lon)} would fit there"
    )


def far_from_rest(lat_lon_height: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """(N,) whether positions (N, 3) stand far apart from most of the others, and (N,) their distances in metres.

    Distances are from the position that half of all are nearest to. At most half of the positions stand apart, by
    ``apart`` with 2 km.
    """
    lat, lon, height = np.asarray(lat_lon_height, float).reshape(-1, 3).T
    if len(lat) < 2:
        return np.zeros(len(lat), bool), np.zeros(len(lat))
    xyz = np.stack(_ecef().transform(lat, lon, height), axis=-1)
    tried = xyz[:: max(1, len(xyz) // 200)]  # positions at most that are tried for the middle of the rest
    half = (len(tried) - 1) // 2
    within = [np.partition(np.linalg.norm(tried - c, axis=1), half)[half] for c in tried]
    away = np.linalg.norm(xyz - tried[int(np.argmin(np.round(within)))], axis=1)
    return apart(away, FAR_FLOOR_M), away


def apart(away: np.ndarray, floor: float) -> np.ndarray:
    """(N,) which of some distances (N,) lie behind a gap in their order, in the upper half of them.

    Behind a gap is what exceeds ten times the largest distance before it by more than ``floor``. A path that is merely
    long, or dense at one end, has no such gap.
    """
    ordered = np.sort(away)
    first = (len(away) + 1) // 2
    gaps = np.flatnonzero(ordered[first:] > FAR_FACTOR * ordered[first - 1 : -1] + floor)
    return away >= ordered[first + gaps[0]] if len(gaps) else np.zeros(len(away), bool)


@lru_cache(maxsize=16)
def parse_crs(crs: str) -> pyproj.CRS:
    """The pyproj CRS of "EPSG:n". Raises InputError unless it exists, is projected and counts in metres to the east."""
    import pyproj

    try:
        parsed = pyproj.CRS.from_user_input(crs)
    except pyproj.exceptions.CRSError:
        zones = utm_by_name(crs)
        hint = f": {zones[0]} is that zone north of the equator, {zones[1]} south of it" if len(zones) == 2 else ""
        raise InputError(
            f"unknown CRS {crs!r}{hint}; give EPSG:n of a projected CRS in metres (EPSG:32610 is UTM zone 10 north), a "
            "zone such as UTM10N, ENU (tangent plane), or auto (the UTM zone of the positions)"
        ) from None
    if not parsed.is_projected:
        raise InputError(f"CRS {crs!r} ({parsed.name}) is not projected: give a projected one in metres, or ENU")
    other = next((a for a in parsed.axis_info if abs(a.unit_conversion_factor - 1) > 1e-12), None)
    if other is not None:
        raise InputError(f"CRS {crs!r} counts in {other.unit_name}, not metres: choose a metric one")
    if "west" in {a.direction.lower() for a in parsed.axis_info}:
        raise InputError(f"CRS {crs!r} ({parsed.name}) counts to the west: choose one whose axes point east and north")
    return parsed


@lru_cache(maxsize=16)
def crs_transformer(crs: str) -> _Transformer:
    """From WGS84 lon, lat, height to a CRS as east, north, height, all in its unit (whatever its own axis order)."""
    return _Transformer(crs)


@lru_cache(maxsize=16)
def check_vertical(crs: str) -> None:
    """Raise InputError for a compound CRS whose geoid grid is not installed: PROJ would leave heights as they are."""
    import pyproj

    parsed = None if crs.upper() == ENU else pyproj.CRS.from_user_input(crs)
    if parsed is None or not parsed.is_compound:
        return
    group = _operations(crs, "EPSG:4979")
    if group.transformers and "ballpark vertical" not in group.transformers[0].description:
        return
    grids = _missing_grids(group.unavailable_operations)
    raise InputError(
        f"CRS {crs!r} ({parsed.name}) has heights above a geoid, but PROJ has no grid for it"
        + (f" ({grids}: install it with projsync or set PROJ_NETWORK=ON)" if grids else "")
        + "; or choose the horizontal CRS alone: heights then stay above the ellipsoid"
    )


def vertical_note(crs: str) -> str:
    """What the heights of a CRS count from, and how its coordinates come from those of WGS84, in words."""
    if crs.upper() == ENU:
        return "heights from the tangent plane at the origin (ellipsoidal near it)"
    import pyproj

    parsed = pyproj.CRS.from_user_input(crs)
    heights = "heights are as given, with GNSS above the ellipsoid; no geoid is applied"
    if parsed.is_compound:
        heights = f"heights are {parsed.sub_crs_list[-1].name}"
    return "; ".join([heights, *_operation(crs)])


def datum_sigma_m(crs: str) -> float:
    """How well PROJ ties the datum of a CRS to WGS84 here, in metres; 0 = to half a metre, or the two are taken as one:
    GNSS with corrections has the datum of their network, and calls it WGS84."""
    if crs.upper() == ENU or not (operations := _operations(crs).transformers):
        return 0.0
    shifted = re.search(r"helmert|molodensky|grid|cart", operations[0].definition)
    return float(operations[0].accuracy) if shifted and operations[0].accuracy > _TOLD_DATUM_M else 0.0


def datum_note(crs: str) -> str:
    """What to say of a CRS whose datum nobody names, on an ellipsoid of old; "" of others."""
    if crs.upper() == ENU or not (operations := _operations(crs).transformers):
        return ""
    import pyproj

    ellipsoid = pyproj.CRS.from_user_input(crs).ellipsoid
    named = "Ballpark geographic" not in operations[0].description
    if named or ellipsoid is None or abs(ellipsoid.semi_major_metre - 6378137.0) < 1:
        return ""
    return (
        f"its datum is not named, and on the ellipsoid {ellipsoid.name} places may lie hundreds of metres from "
        "those of WGS84: give the CRS by its EPSG code, or +towgs84"
    )


def _operations(crs: str, wgs84: str = "EPSG:4326") -> Any:
    import pyproj
    from pyproj.transformer import TransformerGroup

    with warnings.catch_warnings():
        warnings.simplefilter("ignore", UserWarning)  # says the same as unavailable_operations
        return TransformerGroup(wgs84, pyproj.CRS.from_user_input(crs))


def _missing_grids(operations: Sequence[Any]) -> str:
    return ", ".join(sorted({g.short_name for o in operations for g in o.grids if not g.available}))


def _operation(crs: str) -> list[str]:
    """The accuracy of the datum operation of a CRS, and the grid that would do it better, where it is worth a word."""
    group = _operations(crs)
    if unknown := datum_note(crs):
        return [unknown]
    if not group.transformers or not group.transformers[0].accuracy > _TOLD_DATUM_M:
        return []
    used = group.transformers[0].accuracy
    if not datum_sigma_m(crs):
        return [
            f"its datum and WGS84 are taken as one, as GNSS with a network's corrections has it; else {used:g} m off"
        ]
    better = [o for o in group.unavailable_operations if 0 <= o.accuracy < used]
    text = f"between it and WGS84 places are good to {used:g} m, which counts in the sigma of positions"
    if not better:
        return [text]
    best = min(better, key=lambda o: o.accuracy)
    return [f"{text} (with {_missing_grids([best])}, which projsync fetches, to {best.accuracy:g} m)"]


class _Transformer:
    """Between WGS84 as lon, lat, height and east, north, height of a CRS, whatever the order and names of its axes.

    A CRS of two axes leaves heights as they are, in its unit: changed from datum to datum they would count from an
    ellipsoid that nobody in the country measures from (in Britain 46 m lower).
    """

    def __init__(self, crs: str) -> None:
        import pyproj

        target = pyproj.CRS.from_user_input(crs)
        check_vertical(crs)
        flat = len(target.axis_info) == 2
        self._inner = pyproj.Transformer.from_crs("EPSG:4326" if flat else "EPSG:4979", target, always_xy=True)
        self._unit_m = target.axis_info[0].unit_conversion_factor if flat and target.is_projected else 1.0

    def transform(self, a: Any, b: Any, c: Any, direction: str = "FORWARD") -> tuple:
        """Coordinates of the other side."""
        if direction == "FORWARD":
            east, north, height = self._inner.transform(a, b, c)
            return east, north, height / self._unit_m
        return tuple(self._inner.transform(a, b, c * self._unit_m, direction=direction))


def world_from_geodetic(lat_lon_height: np.ndarray, origin: Origin) -> np.ndarray:
    """World metres (N, 3) of geodetic positions (N, 3): degrees, degrees, ellipsoidal metres."""
    lat, lon, height = np.asarray(lat_lon_height, float).reshape(-1, 3).T
    if origin.crs == ENU:
        ecef = np.stack(_ecef().transform(lat, lon, height), axis=-1)
        zero = np.array(_ecef().transform(origin.lat_deg, origin.lon_deg, origin.height_m))
        return (ecef - zero) @ enu_axes(origin.lat_deg, origin.lon_deg).T
    xyz = np.stack(crs_transformer(origin.crs).transform(lon, lat, height), axis=-1)
    return xyz - np.asarray(origin.shift_m)


def geodetic_from_world(world_m: np.ndarray, origin: Origin) -> np.ndarray:
    """Geodetic positions (N, 3): degrees, degrees, ellipsoidal metres, of world metres (N, 3)."""
    world_m = np.asarray(world_m, float).reshape(-1, 3)
    if origin.crs == ENU:
        zero = np.array(_ecef().transform(origin.lat_deg, origin.lon_deg, origin.height_m))
        ecef = world_m @ enu_axes(origin.lat_deg, origin.lon_deg) + zero
        return geodetic_from_ecef(ecef)
    return geodetic_from_crs(world_m + np.asarray(origin.shift_m), origin.crs)


def geodetic_from_crs(xyz: np.ndarray, crs: str) -> np.ndarray:
    """Geodetic positions (N, 3) of east, north (of degrees: longitude, latitude) and height in a CRS (N, 3); infinite
    outside of it."""
    lon, lat, height = crs_transformer(crs).transform(*xyz.T, direction="INVERSE")
    return np.stack([lat, lon, height], axis=-1)


def crs_coordinates(world_m: np.ndarray, origin: Origin) -> np.ndarray:
    """CRS coordinates (N, 3) east, north, height of world metres; ENU: unchanged."""
    return np.asarray(world_m, float) + np.asarray(origin.shift_m)


@cache
def _ecef() -> pyproj.Transformer:
    import pyproj

    return pyproj.Transformer.from_crs("EPSG:4979", "EPSG:4978", always_xy=False)


def enu_axes(lat_deg: np.ndarray | float, lon_deg: np.ndarray | float) -> np.ndarray:
    """(..., 3, 3) rows east, north, up in ECEF at places (...)."""
    lat, lon = np.radians(lat_deg), np.radians(lon_deg)
    east = [-np.sin(lon), np.cos(lon), np.zeros_like(lon)]
    north = [-np.sin(lat) * np.cos(lon), -np.sin(lat) * np.sin(lon), np.cos(lat)]
    up = [np.cos(lat) * np.cos(lon), np.cos(lat) * np.sin(lon), np.sin(lat)]
    return np.stack([np.stack(row, axis=-1) for row in (east, north, up)], axis=-2)


def ecef_from_enu(place: Origin) -> np.ndarray:
    """(4, 4) from metres east, north and up about a place to ECEF coordinates on WGS84."""
    zero, out = _ecef().transform(place.lat_deg, place.lon_deg, place.height_m), np.eye(4)
    out[:3, :3], out[:3, 3] = enu_axes(place.lat_deg, place.lon_deg).T, zero
    return out


def geodetic_from_ecef(xyz_m: np.ndarray) -> np.ndarray:
    """Geodetic positions (N, 3): degrees, degrees, ellipsoidal metres, of ECEF coordinates (N, 3) on WGS84."""
    x, y, z = np.asarray(xyz_m, float).reshape(-1, 3).T
    return np.stack(_ecef().transform(x, y, z, direction="INVERSE"), axis=-1)
