"""Positions of a receiver from the files people have: one table of formats, one form of what they say.

A format is told by what stands in the file, never by its suffix: a ``.txt`` may be NMEA, ODM's geo.txt or a CSV. Each
has a reader that returns its rows (``fixes.Fixes``); which of them can be used is asked of all formats alike
(``fixes.judged``).

Times become seconds since 1970, UTC, where the format says what they are: GPS time loses its leap seconds, seconds of a
GPS week need the week. Where a file names no day or week (NMEA without RMC and ZDA, SBET), its rows are laid on the day
or week of the frames (``rows.on_clock_of``). A CSV's column ``time`` is of the clock of the frames, whatever that is.

Heights are above the ellipsoid. NMEA's are above the geoid and carry the undulation, which is added; formats that have
heights above the sea and no undulation (GPX, KML, RTKLIB's geodetic heights) are taken as they are, and that is said.
"""

from tiegraph.scene.gnss.columns import IMAGE
from tiegraph.scene.gnss.fixes import HEIGHT_RANGE_M, SIGMA_RANGE_M
from tiegraph.scene.gnss.formats import FORMATS, read_gnss
from tiegraph.scene.gnss.rows import Gnss, at_times, far_rows, on_clock_of, stuck_note, without_far

__all__ = [
    "FORMATS", "HEIGHT_RANGE_M", "IMAGE", "SIGMA_RANGE_M", "Gnss", "at_times", "far_rows", "on_clock_of", "read_gnss",
    "stuck_note", "without_far",
]  # fmt: skip
