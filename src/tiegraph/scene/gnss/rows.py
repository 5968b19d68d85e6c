"""Positions of a receiver, and what they can be among each other: in order of time, without leaps, a place an image."""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np

from tiegraph.errors import InputError
from tiegraph.geometry.geodesy import far_from_rest
from tiegraph.geometry.transforms import interpolate, rigid
from tiegraph.scene.cells import out_of_order
from tiegraph.scene.gpstime import DATED_S, laid_on


@dataclass(frozen=True)
class Gnss:
    """G positions, in time order if they have times. Not interpolated."""

    names: tuple[str, ...]  # image names, "#12" for the image with that number, or empty
    time_s: np.ndarray  # (G,) f8; NaN if the rows are by image
    lat_lon_height: np.ndarray  # (G, 3) degrees, degrees, metres above the ellipsoid
    sigma_m: np.ndarray  # (G, 3) east, north, up; NaN = not given
    heading_deg: np.ndarray  # (G,) of the body's forward axis, clockwise from north; NaN = not given
    notes: tuple[str, ...] = ()
    line: tuple[int, ...] = ()  # (G,) line of the file each row stands in; in a binary one, its record
    period_s: float = 0.0  # times count within a day (UTC) or a GPS week that nothing names; 0 = from an epoch

    def only(self, keep: np.ndarray, notes: Sequence[str]) -> "Gnss":
        """Some rows (K,), with other notes."""
        names, line = (tuple(c[k] for k in keep) if c else () for c in (self.names, self.line))
        place, sigma = self.lat_lon_height[keep], self.sigma_m[keep]
        return Gnss(
            names=names,
            time_s=self.time_s[keep],
            lat_lon_height=place,
            sigma_m=sigma,
            heading_deg=self.heading_deg[keep],
            notes=tuple(notes),
            line=line,
            period_s=self.period_s,
        )


# --- rows among each other ------------------------------------------------------------------------------------------


def in_time_order(gnss: Gnss, path: Path) -> Gnss:
    """Rows sorted by time, the first of each time, and what to say of that. Raises InputError for one time for all."""
    notes, name = list(gnss.notes), Path(path).name
    order = np.argsort(gnss.time_s, kind="stable")
    odd = out_of_order(gnss.time_s)
    if len(odd):
        k = int(odd[0])
        beside, where = (k - 1, "after") if k else (1, "before")
        notes.append(
            f"{name}, line {gnss.line[k]}: rows are not in time order and were sorted "
            f"({gnss.time_s[k]:.2f} s {where} {gnss.time_s[beside]:.2f} s)"
        )
    twin = np.concatenate([[False], np.diff(gnss.time_s[order]) <= 1e-9])
    keep = order[~twin]
    if len(keep) < len(order):
        again = int(order[np.flatnonzero(twin)[0]])
        if len(keep) == 1:
            raise InputError(
                f"{path}, line {gnss.line[again]}: all {len(order)} rows have the time {gnss.time_s[again]:.2f} s: "
                "give the time of each row, or a table with a column image"
            )
        notes.append(
            f"{name}: {twin.sum()} rows with the time of another row left out, such as line {gnss.line[again]} "
            f"({gnss.time_s[again]:.2f} s)"
        )
    return gnss.only(keep, notes)


def without_leaps(gnss: Gnss, path: Path, max_speed_m_s: float) -> Gnss:
    """Without stretches of rows far from the rest that nothing could reach in the time between."""
    far, away = far_from_rest(gnss.lat_lon_height)
    if not far.any():
        return gnss
    edge = np.flatnonzero(np.diff(far.astype(int)) != 0)  # between rows edge and edge + 1
    fast = np.abs(np.diff(away)) > max_speed_m_s * np.diff(gnss.time_s)
    for first, last in zip([0, *(edge + 1)], [*edge, len(far) - 1]):
        reached = (first > 0 and not fast[first - 1]) or (last < len(far) - 1 and not fast[last])
        far[first : last + 1] &= not reached
    if not far.any():
        return gnss
    row = int(np.flatnonzero(far)[0])
    note = _say_far(f"{Path(path).name}, line {gnss.line[row]}", gnss.lat_lon_height[row], away[row])
    note += f", and nothing moves so fast: {far.sum()} of {len(far)} rows "
    if 2 * far.sum() >= len(far):
        return replace(gnss, notes=(*gnss.notes, note + "do so, and which are right nothing tells: correct the file"))
    return gnss.only(np.flatnonzero(~far), [*gnss.notes, note + "are left out; correct the file, or remove them"])


def _say_far(where: str, place: np.ndarray, away_m: float) -> str:
    return f"{where}: lat {place[0]:.6f}, lon {place[1]:.6f} lies {away_m / 1000:.0f} km from most of the others"


def far_rows(lat_lon_height: np.ndarray, where: Sequence[str], most: float) -> tuple[np.ndarray, str]:
    """(N,) which of some positions (N, 3) without times not to use, as they are far from the rest, and what to say.

    ``where`` names each position. They are used, though said, if they are more than a share of ``most`` (of two, one):
    which are right is then not clear.
    """
    far, away = far_from_rest(lat_lon_height)
    if not far.any():
        return far, ""
    row = int(np.flatnonzero(far)[0])
    note = _say_far(where[row], lat_lon_height[row], away[row])
    if far.sum() > max(1, most * len(far)) or len(far) < 3:
        note += f", as {far.sum()} of {len(far)} positions do: are these two surveys? Split them, or mend the positions"
        return np.zeros(len(far), bool), note
    return far, note + f": {far.sum()} of {len(far)} positions are not used; mend or remove them"


def one_place_an_image(gnss: Gnss, path: Path) -> Gnss:
    """A file by image without rows that say the same again. Raises InputError for an image at two places."""
    first: dict[str, int] = {}
    again = []
    for k, name in enumerate(gnss.names):
        other = first.setdefault(name, k)
        if other == k:
            continue
        if not np.allclose(gnss.lat_lon_height[k], gnss.lat_lon_height[other], rtol=0, atol=(1e-8, 1e-8, 1e-3)):
            raise InputError(
                f"{path}, line {gnss.line[k]}: image {name!r} has another place than in line {gnss.line[other]}: leave "
                "the right one"
            )
        again.append(k)
    if not again:
        return gnss
    image = f"{Path(path).name}, line {gnss.line[again[0]]}: image {gnss.names[again[0]]!r}"
    note = f"{image} stands there twice, at one place; {len(again)} rows left out"
    return gnss.only(np.setdiff1d(np.arange(len(gnss.names)), again), [*gnss.notes, note])


def without_far(gnss: Gnss, path: Path, most: float) -> Gnss:
    """A file by image without positions that stand far apart from the others, as ``far_rows`` says."""
    far, note = far_rows(gnss.lat_lon_height, [f"{Path(path).name}, line {n}" for n in gnss.line], most)
    return gnss.only(np.flatnonzero(~far), [*gnss.notes, note]) if note else gnss


def stuck_note(lat_lon_height: np.ndarray, where: str, least: int) -> str:
    """What to say if some positions (N, 3), the ``least`` number of them, are one and the same; else ""."""
    if len(lat_lon_height) < least or np.ptp(lat_lon_height, axis=0).max() > 0:
        return ""
    lat, lon, height = lat_lon_height[0]
    return (
        f"{where}: all {len(lat_lon_height)} positions are lat {lat:.6f}, lon {lon:.6f}, height {height:g} m, and tell "
        "neither scale nor direction: was there a fix?"
    )


def on_clock_of(gnss: Gnss, time_s: np.ndarray) -> Gnss:
    """Rows on the clock of frames (F,), as ``gpstime.laid_on`` says."""
    if gnss.names:
        return gnss
    moved, note = laid_on(gnss.time_s, gnss.period_s, time_s)
    dated = gnss.period_s and moved is not gnss.time_s and np.median(moved) >= DATED_S
    notes = (*gnss.notes, note) if note else gnss.notes
    return replace(gnss, time_s=moved, period_s=0.0 if dated else gnss.period_s, notes=notes)


def step_of(time_s: np.ndarray) -> float:
    """1 s for dates of frames (F,) of which none has a fraction of a second, as EXIF without SubSecTime; else 0."""
    known = time_s[np.isfinite(time_s)]
    return float(len(np.unique(known)) > 2 and known.min() >= DATED_S and np.all(known == np.round(known)))


def moved_within(time_s: np.ndarray, world_m: np.ndarray, step_s: float) -> np.ndarray:
    """(G, 3) metres, root mean square, that rows (G, 3) move within a time that was cut to ``step_s``."""
    if not step_s or len(time_s) < 2:
        return np.zeros_like(world_m)
    return np.abs(np.gradient(world_m, time_s, axis=0)) * step_s / np.sqrt(3)


def at_times(gnss: Gnss, world_m: np.ndarray, time_s: np.ndarray, max_gap_s: float) -> tuple[np.ndarray, ...]:
    """Positions (F, 3), sigmas (F, 3) and headings (F,) at times (F,); NaN outside and across gaps over ``max_gap_s``.

    ``world_m`` (G, 3) are the rows in the world. Sigmas are the larger of the two neighbours'.
    """
    heading = np.radians(np.where(np.isnan(gnss.heading_deg), 0.0, gnss.heading_deg))
    cos, sin, zero, one = np.cos(heading), np.sin(heading), np.zeros_like(heading), np.ones_like(heading)
    turn = np.stack([np.stack(r, -1) for r in ((cos, -sin, zero), (sin, cos, zero), (zero, zero, one))], axis=1)
    moved = interpolate(gnss.time_s, rigid(turn, world_m), time_s, max_gap_s)
    there = np.isfinite(moved[:, 0, 3])
    right = np.clip(
        np.searchsorted(gnss.time_s, np.where(there, time_s, gnss.time_s[0]) - 1e-6), 0, len(gnss.time_s) - 1
    )
    exact = np.abs(gnss.time_s[right] - time_s) < 1e-6
    left = np.where(exact, right, np.maximum(right - 1, 0))
    sigma = np.fmax(gnss.sigma_m[left], gnss.sigma_m[right])
    known = np.isfinite(gnss.heading_deg[left]) & np.isfinite(gnss.heading_deg[right]) & there
    bearing = np.where(known, np.degrees(np.arctan2(moved[:, 1, 0], moved[:, 0, 0])) % 360, np.nan)
    return moved[:, :3, 3], np.where(there[:, None], sigma, np.nan), bearing
