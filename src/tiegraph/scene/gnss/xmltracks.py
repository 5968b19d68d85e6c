"""Positions from GPX tracks, KML tracks (gx:Track) and KML placemarks named as images, packed (KMZ) or not.

Heights of both are above the sea by their specifications, in GPX with the undulation (geoidheight) where a program
writes it. Times are UTC.
"""

import io
import re
import zipfile
import zlib
from dataclasses import replace
from pathlib import Path

import numpy as np

from tiegraph.errors import InputError
from tiegraph.scene.cells import number, parse_time
from tiegraph.scene.gnss.fixes import Gnss, above_ellipsoid
from tiegraph.scene.textfile import parse_xml

_NAN = float("nan")
_MOST_BYTES = 1 << 29  # bound of memory: of a KMZ's document
_IMAGE = re.compile(r"(?i)\.(jpe?g|png|tiff?|dng|bmp|webp|heic|insp)$")


def is_gpx(text: str, raw: bytes) -> bool:
    """Whether the first bytes of a file are those of GPX."""
    return text.lstrip().startswith("<") and bool(re.search(r"<(?:\w+:)?gpx[\s>]", text))


def is_kml(text: str, raw: bytes) -> bool:
    """Whether the first bytes of a file are those of KML, or of a KMZ."""
    return _is_kmz(raw) or (text.lstrip().startswith("<") and bool(re.search(r"<(?:\w+:)?kml[\s>]", text)))


def _is_kmz(raw: bytes) -> bool:
    return raw.startswith(b"PK\x03\x04")  # a ZIP archive; no other format here is one


def _unpacked(path: Path, raw: bytes) -> bytes:
    """The KML document of a KMZ: doc.kml, else the first (OGC 12-007r2, C.2). Raises InputError."""
    try:
        with zipfile.ZipFile(io.BytesIO(raw)) as archive:
            inside = [f for f in archive.infolist() if f.filename.lower().endswith(".kml")]
            first = min(inside, key=lambda f: f.filename.lower() != "doc.kml", default=None)
            if first is not None and first.file_size <= _MOST_BYTES:
                return archive.read(first)
    except (zipfile.BadZipFile, zlib.error, EOFError, NotImplementedError, RuntimeError, OSError) as error:
        raise InputError(
            f"{path}: a KMZ or another ZIP archive that is cut off or damaged ({error}): export it again"
        ) from None
    why = "no KML in it" if first is None else f"{first.filename} has {first.file_size / 2**30:.3g} GiB unpacked"
    raise InputError(f"{path}: a ZIP archive, but no KMZ ({why}): give a KMZ or one of the formats of positions")


def read_gpx(path: Path, raw: bytes) -> Gnss:
    """Track points of GPX 1.0 and 1.1 with their times. Raises InputError for damaged XML and for no timed points."""
    root = parse_xml(path, raw)
    points = list(root.all("trkpt"))
    if not points:
        others = sum(1 for n in ("rtept", "wpt") for _ in root.all(n))
        raise InputError(
            f"{path}: no track points (trkpt), {others} of routes and waypoints; export the recorded track"
        )
    if not any(p.said("time") for p in points):
        raise InputError(
            f"{path}, line {points[0].line}: no track point has a time, so nothing says which image was taken there: "
            "export the track with times"
        )
    above_sea, undulation = (np.array([number(p.said(n)) for p in points]) for n in ("ele", "geoidheight"))
    height, notes = above_ellipsoid(path, above_sea, undulation)
    return Gnss(
        path=path,
        line=[p.line for p in points],
        lat_lon_height=np.column_stack(
            [*([number(p.given.get(n, "")) for p in points] for n in ("lat", "lon")), height]
        ),
        time_s=np.array([parse_time(p.said("time")) for p in points]),
        notes=notes,
    )


def read_kml(path: Path, raw: bytes) -> Gnss:
    """Rows of gx:Track (when, coord), or placemarks of points that are named as images or have a TimeStamp.

    Raises InputError for damaged XML or KMZ, heights above the ground, a track of other times than places, and for
    nothing of the kind.
    """
    root = parse_xml(path, _unpacked(path, raw) if _is_kmz(raw) else raw)
    for mode in root.all("altitudeMode"):
        if mode.text.strip() == "relativeToGround":
            raise InputError(
                f"{path}, line {mode.line}: heights above the ground (relativeToGround) place nothing: export absolute "
                "altitudes"
            )
    whens, places = [], []
    for track in root.all("Track"):
        mine = [c for c in track.children if c.name == "when"], [c for c in track.children if c.name == "coord"]
        if len(mine[0]) != len(mine[1]):
            raise InputError(
                f"{path}, line {track.line}: a gx:Track of {len(mine[0])} times and {len(mine[1])} places: is the "
                "file cut off? Export it again"
            )
        whens += mine[0]
        places += mine[1]
    if places:
        times = np.array([parse_time(w.text.strip()) for w in whens])
        return _kml_fixes(path, [p.line for p in places], [p.text.split() for p in places], times)
    marks = [(m, p) for m in root.all("Placemark") for p in m.all("Point")]
    named = [(m.said("name"), p) for m, p in marks if _IMAGE.search(m.said("name"))]
    if named:
        where = [p.said("coordinates").split(",") for _, p in named]
        found = _kml_fixes(path, [p.line for _, p in named], where, np.full(len(named), _NAN))
        return replace(found, names=[n for n, _ in named])
    timed = [(s, p) for m, p in marks for s in m.all("TimeStamp")]
    if not timed:
        raise InputError(
            f"{path}: no gx:Track and no points named as images or with a TimeStamp ({len(marks)} points without); "
            "a line alone has no times: export the track as GPX, or as KML with times"
        )
    times = np.array([parse_time(s.said("when")) for s, _ in timed])
    return _kml_fixes(path, [p.line for _, p in timed], [p.said("coordinates").split(",") for _, p in timed], times)


def _kml_fixes(path: Path, line: list[int], lon_lat_height: list[list[str]], time_s: np.ndarray) -> Gnss:
    lon, lat, above_sea = np.array([[number(v) for v in [*cells, "", "", ""][:3]] for cells in lon_lat_height]).T
    height, notes = above_ellipsoid(path, above_sea, np.full(len(line), _NAN))
    return Gnss(path=path, line=line, lat_lon_height=np.stack([lat, lon, height], axis=1), time_s=time_s, notes=notes)
