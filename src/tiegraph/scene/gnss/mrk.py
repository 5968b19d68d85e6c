"""DJI's Timestamp.MRK, beside the images of a drone with RTK: a row an image, at the centre of its sensor.

``number, seconds of the week, [week], offsets of the antenna (mm) N, E, V, Lat, Lon, Ellh, sigmas N, E, up (m), Q``
(DJI, Phantom 4 RTK; Matrice 4 user manual): the position has been moved from the antenna to the image already. Images
are meant by the last number in their names, DJI_0012.JPG or DJI_20240501120000_0012_V.JPG.
"""

import re
from collections import Counter
from pathlib import Path

import numpy as np

from tiegraph.errors import InputError
from tiegraph.scene.gnss.fixes import Fixes
from tiegraph.scene.textfile import decoded, text_lines

_START = re.compile(r"\s*(\d+)\s+\d+\.\d+\s+\[\d+\]")
_NUMBER = r"([-+]?\d+(?:\.\d*)?(?:[eE][-+]?\d+)?)"
_THREE = r"\s*,\s*".join([_NUMBER] * 3)
_PLACE = re.compile(rf"{_NUMBER}\s*,\s*Lat\s+{_NUMBER}\s*,\s*Lon\s+{_NUMBER}\s*,\s*Ellh\s+{_THREE}\s+(\d+)\s*,\s*Q")


def is_mrk(text: str, raw: bytes) -> bool:
    """Whether a file begins with a row of Timestamp.MRK."""
    return bool(_START.match(text))


def read_mrk(path: Path, raw: bytes) -> Fixes:
    """Rows of a Timestamp.MRK, named "#<number>"; those without a position (Q 0; 16 is single, 34 float, 50 fixed) are
    empty.

    Raises InputError, with the line, for a row that is none.
    """
    text, notes = decoded(path, raw, "GNSS file")
    lines = [(n, line) for n, line in enumerate(text_lines(text), start=1) if line.strip()]
    rows, flags = [], []
    for n, line in lines:
        start, place = _START.match(line), _PLACE.search(line)
        if start is None or place is None:
            raise InputError(
                f"{path}, line {n}: {line.strip()!r:.80} is no row of a Timestamp.MRK: number, seconds, [week], N, E, "
                "V, Lat, Lon, Ellh, three sigmas, Q; is the file cut off? Copy it again, or remove that line"
            )
        values = [float(v) for v in place.groups()[:6]]
        flags.append(int(place[7]))
        rows.append((n, start[1], values if flags[-1] else [np.nan] * 6))
    table = np.array([values for _, _, values in rows])
    fixed = ", ".join(f"{count} of Q {flag}" for flag, count in sorted(Counter(flags).items(), reverse=True))
    return Fixes(
        path=path,
        line=[n for n, _, _ in rows],
        lat_lon_height=table[:, :3],
        time_s=np.full(len(rows), np.nan),
        names=[f"#{int(number)}" for _, number, _ in rows],
        sigma_m=table[:, [4, 3, 5]],
        notes=[*notes, f"{path.name}: positions of the images as DJI gives them, {fixed} (50 = fixed)"],
    )
