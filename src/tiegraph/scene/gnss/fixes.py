"""Rows as a file gives them, and which of them can be used: the same questions for every format."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tiegraph.errors import InputError
from tiegraph.scene.gnss.rows import Gnss, in_time_order, one_place_an_image, stuck_note, without_leaps
from tiegraph.scene.table import some_lines
from tiegraph.scene.tuning import GnssTuning

# What a row cannot mean:
HEIGHTS_M = (-500.0, 9000.0)  # from the lowest shore to the highest mountain
SIGMA_RANGE_M = (1e-4, 1000.0)  # below, no receiver; above, a receiver that has no position
EMPTY = ("", "nan", "none", "null")
_NO_FIX = "position 0, 0"
_ANGLES = ("latitude", "longitude", "height")
_Faults = list[tuple[str, np.ndarray]]  # what makes rows useless, and (R,) which


@dataclass(frozen=True)
class Fixes:
    """R rows of a file, not judged yet; NaN = not given or no number."""

    path: Path
    line: Sequence[int]
    lat_lon_height: np.ndarray  # (R, 3) degrees, degrees, metres above the ellipsoid
    time_s: np.ndarray  # (R,); NaN if the rows are by image
    names: Sequence[str] = ()
    sigma_m: np.ndarray | None = None  # (R, 3) east, north, up
    heading_deg: np.ndarray | None = None  # (R,)
    notes: Sequence[str] = ()
    period_s: float = 0.0  # as of ``Gnss``
    text: Callable[[int, str], str] | None = None  # what stands in a row for "latitude", "time" ...; else the number


def judged(fixes: Fixes, tuning: GnssTuning, heights_m: tuple[float, float] = HEIGHTS_M) -> Gnss:
    """The usable rows in order; the others are noted with their lines.

    Left out are rows that are empty, out of range (heights: of ``heights_m``), without any accuracy, or so far from the
    rest that nothing moves so fast. Raises InputError for positions in radians, an image at two places, one time for
    all rows, and if no row is usable.
    """
    path, llh, count = Path(fixes.path), fixes.lat_lon_height, len(fixes.line)
    sigma = np.full((count, 3), np.nan) if fixes.sigma_m is None else fixes.sigma_m
    faults = _faults(llh, sigma, heights_m)
    if not fixes.names:
        faults.append(("time", ~np.isfinite(fixes.time_s)))
    good = ~np.any([bad for _, bad in faults], axis=0)
    if not good.any():
        what = "position in range" if fixes.names else "time and a position in range"
        raise InputError(f"{path}: none of {count} rows has a {what}: {_first(fixes, faults, heights_m)}{_hint(llh)}")
    _refuse_radians(fixes, np.flatnonzero(good).tolist())
    notes = list(fixes.notes)
    if not good.all():
        lines = some_lines([fixes.line[k] for k in np.flatnonzero(~good).tolist()])
        notes.append(
            f"{path.name}: {(~good).sum()} of {len(good)} rows left out, empty or out of range ({lines}): "
            f"{_first(fixes, faults, heights_m)}"
        )
    rows = np.flatnonzero(good).tolist()
    sigma = np.where(sigma >= SIGMA_RANGE_M[0], sigma, np.nan)
    sigma[:, 2] = np.where(np.isnan(sigma[:, 2]), tuning.vertical * np.fmax(sigma[:, 0], sigma[:, 1]), sigma[:, 2])
    raw = Gnss(
        names=tuple(fixes.names[k] for k in rows) if fixes.names else (),
        time_s=fixes.time_s[rows],
        lat_lon_height=llh[rows],
        sigma_m=sigma[rows],
        heading_deg=(np.full(count, np.nan) if fixes.heading_deg is None else fixes.heading_deg)[rows],
        notes=tuple(notes),
        line=tuple(int(fixes.line[k]) for k in rows),
        period_s=fixes.period_s,
    )
    if raw.names:
        made = one_place_an_image(raw, path)
    else:
        made = without_leaps(in_time_order(raw, path), path, tuning.max_speed_m_s)
    stuck = stuck_note(made.lat_lon_height, path.name, tuning.stuck)
    return replace(made, notes=(*made.notes, stuck)) if stuck else made


def above_ellipsoid(path: Path, above_sea_m: np.ndarray, undulation_m: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """(R,) heights above the ellipsoid of heights above the sea and undulations, and what to say where none is given.

    Rows without an undulation among others have that of the others: it changes by centimetres a kilometre.
    """
    known = np.isfinite(undulation_m)
    if known.any():
        return above_sea_m + np.where(known, undulation_m, np.median(undulation_m[known])), []
    note = "heights above the sea, taken as they are: those above the ellipsoid differ by the undulation of the geoid"
    return above_sea_m, [f"{Path(path).name}: {note}"]


def beyond(heights_m: tuple[float, float]) -> str:
    """What to say of heights that are not within those that are believed."""
    within = " to ".join(f"{h:g}" for h in heights_m)
    return f"not within {within} m: in another unit? Write metres, or give the range as --scan.heights-m"


def _faults(llh: np.ndarray, sigma: np.ndarray, heights_m: tuple[float, float]) -> _Faults:
    return [
        ("latitude", ~(np.abs(llh[:, 0]) <= 90)),
        ("longitude", ~(np.abs(llh[:, 1]) <= 360)),
        ("height", ~((llh[:, 2] >= heights_m[0]) & (llh[:, 2] <= heights_m[1]))),
        (_NO_FIX, np.all(llh[:, :2] == 0, axis=1)),
        ("accuracy", np.any(sigma > SIGMA_RANGE_M[1], axis=1)),
    ]


def _text(fixes: Fixes, row: int, what: str) -> str:
    if fixes.text is not None:
        return fixes.text(row, what)
    if what in _ANGLES:
        return f"{fixes.lat_lon_height[row, _ANGLES.index(what)]:.10g}"
    value = fixes.time_s[row] if what == "time" or fixes.sigma_m is None else np.nanmax(fixes.sigma_m[row])
    return f"{value:.10g}"


def _first(fixes: Fixes, faults: _Faults, heights_m: tuple[float, float]) -> str:
    """The first cell at fault that is not empty, in words; else the first empty one."""
    found = [(k, what) for what, bad in faults for k in np.flatnonzero(bad).tolist()]
    filled = [f for f in found if f[1] != _NO_FIX and _text(fixes, *f).lower() not in EMPTY]
    row, what = min(filled or found, key=lambda f: f[0])
    shown = "" if what == _NO_FIX else f" {_text(fixes, row, what)!r}"
    remedy = "; correct the file, or leave such rows out" if filled else ""
    if what == "height" and np.isfinite(fixes.lat_lon_height[row, 2]):
        remedy = f", {beyond(heights_m)}"
    return f"line {fixes.line[row]}, {what}{shown}{remedy}"


def _hint(llh: np.ndarray) -> str:
    """What latitudes out of range look like."""
    lat, lon = (np.nanmax(np.abs(v), initial=0) for v in llh[:, :2].T)
    if 90 < lat <= 360 and lon <= 90:
        return "; lat and lon look exchanged"
    if 90 < lat <= 9000 and lon <= 18000:
        return "; lat looks like ddmm.mmmm (NMEA): write degrees"
    if 9000 < lat <= 1e7 and lon <= 1e6:
        return "; they look like metres of a grid: write degrees, or a geo.txt whose first line is their CRS"
    return "; lat looks like 1e-7 degrees: write degrees" if 1e5 < lat <= 9e8 else ""


def _refuse_radians(fixes: Fixes, good: list[int]) -> None:
    # No land lies within this range of degrees about 0, 0 (Gulf of Guinea).
    llh = fixes.lat_lon_height[good]
    if len(llh) > 1 and np.all(np.abs(llh[:, 0]) <= np.pi / 2) and np.all(np.abs(llh[:, 1]) <= np.pi):
        raise InputError(
            f"{fixes.path}, line {fixes.line[good[0]]}: lat {llh[0, 0]:g}, lon {llh[0, 1]:g}: all positions lie in the "
            "open sea about 0, 0, as radians do: write degrees"
        )
