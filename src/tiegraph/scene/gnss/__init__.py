"""Positions of a receiver from the files people have: one table of formats, one form of what they say.

A format is told by what stands in the file, never by its suffix: a ``.txt`` may be NMEA, ODM's geo.txt or a CSV. Each
has a reader that returns its rows (``fixes.Gnss``); which of them can be used is asked of all formats alike
(``fixes.judged``).

Sentences of NMEA and tracks of GPX are read here and not by pynmeagps and gpxpy: what is wrong in a file is told with
its line, which these do not know, and one damaged sentence ends no log. The tests write files with both.

Times become seconds since 1970, UTC, where the format says what they are: GPS time loses its leap seconds, seconds of a
GPS week need the week. Where a file names no day or week (NMEA without RMC and ZDA, SBET), its rows are laid on the day
or week of the frames (``fixes.on_clock_of``). A CSV's column ``time`` is of the clock of the frames, whatever that is.

Heights are above the ellipsoid. NMEA's are above the geoid and carry the undulation, which is added; formats that have
heights above the sea and no undulation (GPX, KML, RTKLIB's geodetic heights) are taken as they are, and that is said.
"""

import codecs
from collections.abc import Callable
from pathlib import Path

from tiegraph.scene.bags import is_bag
from tiegraph.scene.gnss import columns, solutions, tracks
from tiegraph.scene.gnss.fixes import HEIGHTS_M, Gnss, judged
from tiegraph.scene.textfile import whole_file
from tiegraph.scene.tuning import GnssTuning

_HEAD = 1 << 16  # bytes that tell a format


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
"""Of each format what says of the first bytes of a file, as text and as bytes, whether it is one, and what reads it.
The first that fits is taken."""


def read_gnss(path: Path, tuning: GnssTuning, heights_m: tuple[float, float] = HEIGHTS_M) -> Gnss:
    """Read positions of any of ``FORMATS``, or of a ROS bag (of a topic of one: ``scene.bags``); ``heights_m``: from
    which to which are believed.

    Rows without a usable position are left out and noted with their lines. Raises InputError, naming file and line, for
    what cannot be read, is damaged, or has no usable row.
    """
    if is_bag(Path(path)):
        return judged(solutions.read_navsat(Path(path)), tuning, heights_m)
    raw = whole_file(Path(path), "give the GNSS file as a CSV file")
    utf16 = raw.startswith((codecs.BOM_UTF16_LE, codecs.BOM_UTF16_BE))
    head = raw[:_HEAD].decode("utf-16" if utf16 else "utf-8-sig", errors="replace")
    read = next(read for told, read in FORMATS.values() if told(head, raw[:_HEAD]))
    return judged(read(Path(path), raw), tuning, heights_m)
