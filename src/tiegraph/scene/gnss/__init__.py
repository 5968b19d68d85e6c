"""Positions of a receiver from common files: one table of formats, one form of the result.

A format is recognised by the contents of the file, never by its suffix: a ``.txt`` may be NMEA, ODM's geo.txt or a
CSV. Each has a reader that returns its rows (``fixes.Gnss``); usable rows are selected for all formats alike
(``fixes.judged``).

Sentences of NMEA and tracks of GPX are read here and not by pynmeagps and gpxpy: errors name the line in the file,
which these do not know, and one damaged sentence ends no log. The tests write files with both.

Times become seconds since 1970, UTC, if the format defines them: GPS time loses its leap seconds, seconds of a
GPS week need the week. If a file names no day or week (NMEA without RMC and ZDA, SBET), its rows get the day
or week of the frames (``fixes.on_clock_of``). A CSV's column ``time`` is of the clock of the frames, whatever that is.

Heights are above the ellipsoid. NMEA's are above the geoid and include the undulation, which is added; formats with
heights above the sea and no undulation (GPX, KML, RTKLIB's geodetic heights) are used unchanged, with a note.
"""

import codecs
from collections.abc import Callable
from pathlib import Path

from tiegraph.scene.bags import is_bag
from tiegraph.scene.gnss import columns, solutions, tracks
from tiegraph.scene.gnss.fixes import HEIGHTS_M, Gnss, judged
from tiegraph.scene.textfile import whole_file
from tiegraph.scene.tuning import GnssTuning

_HEAD = 1 << 16  # bytes for recognising a format


FORMATS: dict[str, tuple[Callable[[str, bytes], bool], Callable[[Path, bytes], Gnss]]] = {
    "GPX": (tracks.is_gpx, tracks.read_gpx),
    "KML": (tracks.is_kml, tracks.read_kml),
    "SBET": (solutions.is_sbet, solutions.read_sbet),
    "RTKLIB": (solutions.is_rtklib, solutions.read_rtklib),
    "DJI MRK": (solutions.is_mrk, solutions.read_mrk),
    "ODM geo.txt": (columns.is_geotxt, columns.read_geotxt),
    "NMEA 0183": (tracks.is_nmea, tracks.read_nmea),
    "CSV": (lambda text, raw: True, columns.read_columns),
}
"""For each format a test whether the first bytes of a file, as text and as bytes, are of it, and its reader.
The first that fits is used."""


def read_gnss(path: Path, tuning: GnssTuning, heights_m: tuple[float, float] = HEIGHTS_M) -> Gnss:
    """Read positions of any of ``FORMATS``, or of a ROS bag (of a topic of one: ``scene.bags``); ``heights_m``: range
    of plausible heights.

    Rows without a usable position are left out and noted with their lines. Raises InputError, naming file and line, if
    the file cannot be read, is damaged, or has no usable row.
    """
    if is_bag(Path(path)):
        return judged(solutions.read_navsat(Path(path)), tuning, heights_m)
    raw = whole_file(Path(path), "give the GNSS file as a CSV file")
    utf16 = raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    head = raw[:_HEAD].decode("utf-16" if utf16 else "utf-8-sig", errors="replace")
    read = next(read for told, read in FORMATS.values() if told(head, raw[:_HEAD]))
    return judged(read(Path(path), raw), tuning, heights_m)
