"""Positions of a receiver: which rows of a file can be used, and their mutual consistency, for every format."""

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from tiegraph.errors import InputError
from tiegraph.geometry.geodesy import far_from_rest
from tiegraph.geometry.transforms import interpolate, rigid
from tiegraph.scene.table import some_lines
from tiegraph.scene.times import DATED_S, in_time_order, laid_on

# Limits of the values of a row:
HEIGHTS_M = (-500.0, 9000.0)  # from the lowest shore to the highest mountain
SIGMA_RANGE_M = (1e-4, 1000.0)  # below, no receiver; above, a receiver without a position
VERTICAL = 2.0  # sigma of a height over the horizontal one: all satellites are above
_MOST_FAR = 0.1  # largest share of positions that is left out as false
EMPTY = ("", "nan", "none", "null")
_NO_FIX = "position 0, 0"
_ANGLES = ("latitude", "longitude", "height")
_Faults = list[tuple[str, np.ndarray]]  # reasons why rows are useless, and (R,) which


@dataclass(frozen=True)
class Gnss:
    """G rows of a file from its reader; ``judged``: the usable ones, in time order if they have times.

    NaN = not given or no number. Not interpolated.
    """

    path: Path
    line: Sequence[int]  # of the file, for each row; in a binary one, its record
    lat_lon_height: np.ndarray  # (G, 3) degrees, degrees, metres above the ellipsoid
    time_s: np.ndarray  # (G,) f8; NaN if the rows are by image
    names: Sequence[str] = ()  # image names, "#12" for the image with that number, or empty
    sigma_m: np.ndarray = field(default_factory=lambda: np.full(3, np.nan))  # (G, 3) east, north, up
    heading_deg: np.ndarray = field(default_factory=lambda: np.array(np.nan))  # (G,) of the body, clockwise from north
    notes: Sequence[str] = ()
    period_s: float = 0.0  # times count within a day (UTC) or an unnamed GPS week; 0 = from an epoch
    text: Callable[[int, str], str] | None = None  # the text of a row for "latitude", "time" ...; else the number

    def __post_init__(self) -> None:
        object.__setattr__(self, "sigma_m", np.broadcast_to(self.sigma_m, (len(self.line), 3)))
        object.__setattr__(self, "heading_deg", np.broadcast_to(self.heading_deg, len(self.line)))

    def only(self, keep: np.ndarray, *notes: str) -> "Gnss":
        """Some rows (K,), with further notes."""
        names, line = (tuple(c[k] for k in keep.tolist()) if c else () for c in (self.names, self.line))
        columns = {n: getattr(self, n)[keep] for n in ("lat_lon_height", "time_s", "sigma_m", "heading_deg")}
        return replace(self, names=names, line=line, notes=(*self.notes, *notes), text=None, **columns)


def judged(raw: Gnss, heights_m: tuple[float, float] = HEIGHTS_M) -> Gnss:
    """The usable rows in order; the others are noted with their lines.

    Left out are rows that are empty, out of range (heights: of ``heights_m``), without any accuracy, or (of rows with
    times) far from the rest. Raises InputError for positions in radians, an image at two places, one time for
    all rows, and if no row is usable.
    """
    name, llh, count = raw.path.name, raw.lat_lon_height, len(raw.line)
    faults = _faults(llh, raw.sigma_m, heights_m)
    if not raw.names:
        faults.append(("time", ~np.isfinite(raw.time_s)))
    good = ~np.any([bad for _, bad in faults], axis=0)
    if not good.any():
        what = "position in range" if raw.names else "time and a position in range"
        raise InputError(f"{raw.path}: none of {count} rows has a {what}: {_first(raw, faults, heights_m)}{_hint(llh)}")
    lines = some_lines([raw.line[k] for k in np.flatnonzero(~good).tolist()])
    out = f"{name}: {(~good).sum()} of {count} rows left out, empty or out of range ({lines})"
    made = raw.only(np.flatnonzero(good), *([] if good.all() else [f"{out}: {_first(raw, faults, heights_m)}"]))
    _refuse_radians(made)
    sigma = np.where(made.sigma_m >= SIGMA_RANGE_M[0], made.sigma_m, np.nan)
    sigma[:, 2] = np.where(np.isnan(sigma[:, 2]), VERTICAL * np.fmax(sigma[:, 0], sigma[:, 1]), sigma[:, 2])
    made = replace(made, sigma_m=sigma)
    if made.names:
        made = one_place_an_image(made)
    else:
        order, notes = in_time_order(made.time_s, made.line, made.path)
        made = without_far(made.only(order, *notes))
    stuck = stuck_note(made.lat_lon_height, name)
    return replace(made, notes=(*made.notes, stuck)) if stuck else made


def above_ellipsoid(path: Path, above_sea_m: np.ndarray, undulation_m: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """(R,) heights above the ellipsoid of heights above the sea and undulations, and a note if none is given.

    Rows without an undulation among others have that of the others: it changes by centimetres a kilometre.
    """
    known = np.isfinite(undulation_m)
    if known.any():
        return above_sea_m + np.where(known, undulation_m, np.median(undulation_m[known])), []
    note = "heights above the sea, used unchanged: those above the ellipsoid differ by the undulation of the geoid"
    return above_sea_m, [f"{Path(path).name}: {note}"]


def beyond(heights_m: tuple[float, float]) -> str:
    """A note on heights outside the plausible range."""
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


def _text(fixes: Gnss, row: int, what: str) -> str:
    if fixes.text is not None:
        return fixes.text(row, what)
    if what in _ANGLES:
        return f"{fixes.lat_lon_height[row, _ANGLES.index(what)]:.10g}"
    return f"{fixes.time_s[row] if what == 'time' else np.nanmax(fixes.sigma_m[row]):.10g}"


def _first(fixes: Gnss, faults: _Faults, heights_m: tuple[float, float]) -> str:
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
    """The likely cause of latitudes out of range."""
    lat, lon = (np.nanmax(np.abs(v), initial=0) for v in llh[:, :2].T)
    if 90 < lat <= 360 and lon <= 90:
        return "; lat and lon look exchanged"
    if 90 < lat <= 9000 and lon <= 18000:
        return "; lat looks like ddmm.mmmm (NMEA): write degrees"
    if 9000 < lat <= 1e7 and lon <= 1e6:
        return "; they look like metres of a grid: write degrees, or a geo.txt whose first line is their CRS"
    return "; lat looks like 1e-7 degrees: write degrees" if 1e5 < lat <= 9e8 else ""


def _refuse_radians(fixes: Gnss) -> None:
    # No land lies within this range of degrees about 0, 0 (Gulf of Guinea).
    llh = fixes.lat_lon_height
    if len(llh) > 1 and np.all(np.abs(llh[:, 0]) <= np.pi / 2) and np.all(np.abs(llh[:, 1]) <= np.pi):
        raise InputError(
            f"{fixes.path}, line {fixes.line[0]}: lat {llh[0, 0]:g}, lon {llh[0, 1]:g}: all positions lie in the "
            "open sea about 0, 0, as radians do: write degrees"
        )


def far_rows(lat_lon_height: np.ndarray, where: Sequence[str]) -> tuple[np.ndarray, str]:
    """(N,) which of some positions (N, 3) are not used, as they are far from the rest, and a note.

    ``where`` names each position. They are used, but noted, if they are many (of two, one):
    which are right is then undecided.
    """
    far, away = far_from_rest(lat_lon_height)
    if not far.any():
        return far, ""
    row = int(np.flatnonzero(far)[0])
    lat, lon, _ = lat_lon_height[row]
    note = f"{where[row]}: lat {lat:.6f}, lon {lon:.6f} lies {away[row] / 1000:.0f} km from most of the others"
    if far.sum() > max(1, _MOST_FAR * len(far)) or len(far) < 3:
        note += f", as {far.sum()} of {len(far)} positions do: two surveys? Split them, or correct the positions"
        return np.zeros(len(far), bool), note
    return far, note + f": {far.sum()} of {len(far)} positions are not used; correct or remove them"


def one_place_an_image(gnss: Gnss) -> Gnss:
    """A file by image without repeated rows. Raises InputError for an image at two places."""
    first: dict[str, int] = {}
    again = []
    for k, name in enumerate(gnss.names):
        other = first.setdefault(name, k)
        if other == k:
            continue
        if not np.allclose(gnss.lat_lon_height[k], gnss.lat_lon_height[other], rtol=0, atol=(1e-8, 1e-8, 1e-3)):
            raise InputError(
                f"{gnss.path}, line {gnss.line[k]}: image {name!r} has another place than in line {gnss.line[other]}: "
                "keep the right one"
            )
        again.append(k)
    if not again:
        return gnss
    image = f"{gnss.path.name}, line {gnss.line[again[0]]}: image {gnss.names[again[0]]!r}"
    note = f"{image} is listed twice, at one place; {len(again)} rows left out"
    return gnss.only(np.setdiff1d(np.arange(len(gnss.names)), again), note)


def without_far(gnss: Gnss) -> Gnss:
    """A file without positions far from the others, as in ``far_rows``."""
    far, note = far_rows(gnss.lat_lon_height, [f"{gnss.path.name}, line {n}" for n in gnss.line])
    return gnss.only(np.flatnonzero(~far), note) if note else gnss


def stuck_note(lat_lon_height: np.ndarray, where: str) -> str:
    """A note if some positions (N, 3), at least three, are all the same; else ""."""
    if len(lat_lon_height) < 3 or np.ptp(lat_lon_height, axis=0).max() > 0:
        return ""
    lat, lon, height = lat_lon_height[0]
    return (
        f"{where}: all {len(lat_lon_height)} positions are lat {lat:.6f}, lon {lon:.6f}, height {height:g} m, and give "
        "neither scale nor direction: was there a fix?"
    )


def on_clock_of(gnss: Gnss, time_s: np.ndarray) -> Gnss:
    """Rows on the clock of frames (F,), as in ``times.laid_on``."""
    if gnss.names:
        return gnss
    moved, note = laid_on(gnss.time_s, gnss.period_s, time_s)
    dated = gnss.period_s and moved is not gnss.time_s and np.median(moved) >= DATED_S
    said = replace(gnss, time_s=moved, period_s=0.0 if dated else gnss.period_s)
    return replace(said, notes=(*gnss.notes, note)) if note else said


def step_of(time_s: np.ndarray) -> float:
    """1 s for dates of frames (F,) of which none has a fraction of a second, as EXIF without SubSecTime; else 0."""
    known = time_s[np.isfinite(time_s)]
    return float(len(np.unique(known)) > 2 and known.min() >= DATED_S and np.all(known == np.round(known)))


def moved_within(time_s: np.ndarray, world_m: np.ndarray, step_s: float) -> np.ndarray:
    """(G, 3) metres, root mean square, by which rows (G, 3) move within a time rounded to ``step_s``."""
    if not step_s or len(time_s) < 2:
        return np.zeros_like(world_m)
    return np.abs(np.gradient(world_m, time_s, axis=0)) * step_s / np.sqrt(3)


def at_times(gnss: Gnss, world_m: np.ndarray, time_s: np.ndarray, max_gap_s: float) -> tuple[np.ndarray, ...]:
    """Positions (F, 3), sigmas (F, 3) and headings (F,) at times (F,); NaN outside and across gaps over ``max_gap_s``.

    ``world_m`` (G, 3) are the rows in the world. Sigmas are the larger of the two neighbours'.
    """
    turn = Rotation.from_euler("z", np.nan_to_num(gnss.heading_deg)[:, None], degrees=True).as_matrix()
    moved = interpolate(gnss.time_s, rigid(turn, world_m), time_s, max_gap_s)
    there = np.isfinite(moved[:, 0, 3])
    at_s = np.where(there, time_s, gnss.time_s[0])
    right = np.minimum(np.searchsorted(gnss.time_s, at_s - 1e-6), len(gnss.time_s) - 1)
    exact = np.abs(gnss.time_s[right] - time_s) < 1e-6
    left = np.where(exact, right, np.maximum(right - 1, 0))
    sigma = np.fmax(gnss.sigma_m[left], gnss.sigma_m[right])
    known = np.isfinite(gnss.heading_deg[left]) & np.isfinite(gnss.heading_deg[right]) & there
    bearing = np.where(known, np.degrees(np.arctan2(moved[:, 1, 0], moved[:, 0, 0])) % 360, np.nan)
    return moved[:, :3, 3], np.where(there[:, None], sigma, np.nan), bearing
