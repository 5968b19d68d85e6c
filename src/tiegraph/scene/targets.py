"""Coded targets and scale bars by their names in files, and corners of patterns printed black on white.

A target is named by its family and number: ``tag36h11:12``, ``tag25h9:3``, ``4x4_50:7``, ``aruco_original:5``,
``DICT_6X6_250:1``; the families are OpenCV's dictionaries.

A scale bar is a row of a table in a control point file. The header has the columns from, to, length and, if known,
sigma and role (bar or check); lengths are in metres, or in the unit in brackets: ``from,to,length (mm),sigma
(mm)``.

The corners, found by OpenCV to hundredths of a pixel, serve boards (``calibrate``) and targets (``targets``) alike.
"""

import re
from dataclasses import dataclass
from functools import cache

import cv2
import numpy as np

from tiegraph.errors import InputError
from tiegraph.scene.cells import ROLES, without_unit
from tiegraph.scene.table import Table

FORM = "a target is named by its family and number, such as tag36h11:12 or 4x4_50:7"
_NAME = re.compile(r"\s*([A-Za-z][\w ]*|\d[xX]\d_\d+)\s*:\s*(\d{1,6})\s*")
_APRILTAG, _ARUCO = "apriltag_", "aruco_"


@dataclass(frozen=True, order=True)
class Target:
    """A coded target: the name of its family, OpenCV's in lower case without DICT_, and its number."""

    family: str
    number: int

    @property
    def name(self) -> str:
        """Its name for users."""
        return f"{self.family.replace(_APRILTAG, 'tag')}:{self.number}"


def target_of(name: str) -> Target | None:
    """The target of a point's name, None if it is the name of no target."""
    found = _NAME.fullmatch(name)
    if found is None:
        return None
    family = found[1].lower().removeprefix("dict_").replace(" ", "")
    known = families()
    for spelling in (
        family,
        re.sub(r"^(april)?tag_?", _APRILTAG, family),
        family.removeprefix(_ARUCO),
        _ARUCO + family,
    ):
        if spelling in known:
            return Target(spelling, int(found[2]))
    return None


@cache
def families() -> dict[str, str]:
    """OpenCV's names of the dictionaries by family, each once."""
    out: dict[int, str] = {}
    for name in sorted(n for n in dir(cv2.aruco) if n.startswith("DICT_")):
        out.setdefault(int(getattr(cv2.aruco, name)), name)
    return {name.lower().removeprefix("dict_"): name for name in out.values()}


@cache
def dictionary(family: str) -> cv2.aruco.Dictionary:
    """OpenCV's dictionary of a family."""
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, families()[family]))


def count_of(family: str) -> int:
    """The number of targets of a family, numbered from 0."""
    return len(dictionary(family).bytesList)


CENTRE = 0.5  # OpenCV counts pixels from the centre of the first one, COLMAP from its corner
_REFINED = (cv2.TERM_CRITERIA_EPS + cv2.TERM_CRITERIA_MAX_ITER, 50, 0.001)


def refined(pixels: np.ndarray, xy: np.ndarray, free_px: float, share: float, bounds_px: tuple[int, int]) -> np.ndarray:
    """Corners (K, 2) of an image (H, W) u1, OpenCV's pixels, each where all edges about it meet.

    A radius of ``free_px`` about each has no other edges; half the window is a ``share`` of that, within bounds.
    """
    half = int(np.clip(round(share * free_px), *bounds_px))
    places = np.array(xy, np.float32).reshape(-1, 1, 2)
    return cv2.cornerSubPix(pixels, places, (half, half), (-1, -1), _REFINED).reshape(-1, 2)


BAR_SIGMA_M = 0.001  # of a bar without sigma in its file: measured with a tape
_LONGEST_BAR_M = 100.0  # larger lengths are in millimetres
_CHECK = ("check", "checkbar", "check_bar")
BAR_FORM = (
    "scale bars need the columns from, to, length (metres; if known sigma, role: bar or check) in a table of theirs"
)


@dataclass(frozen=True)
class FileBar:
    """A scale bar of a file: names of its ends, length and sigma in metres, line."""

    ends: tuple[str, str]
    length_m: float
    sigma_m: float
    check: bool
    line: int


def names_bars(names: tuple[str, ...]) -> bool:
    """Whether these are the columns of a table of scale bars."""
    bare = {without_unit(n)[0] for n in names} | set(names)
    return all(bare & set(ROLES[role]) for role in ("from", "to", "length"))


def read_bars(table: Table) -> tuple[list[FileBar], str]:
    """The bars of a table, and the columns read. Raises InputError, naming file and line, for invalid lengths and
    sigmas."""
    used = {r: table.find(r) for r in ("from", "to", "length", "sigma", "role")}
    first, second, length, sigma, role = used.values()
    lengths, sigmas = table.metres(length), table.metres(sigma)
    out: list[FileBar] = []
    for row in range(len(table.rows)):
        where = table.where(row)
        ends = (table.cell(row, first), table.cell(row, second))
        if not all(ends) or ends[0] == ends[1]:
            raise InputError(f"{where}: a scale bar needs two different names, got {ends[0]!r} and {ends[1]!r}")
        known = float(lengths[row])
        if not 0 < known <= _LONGEST_BAR_M:
            raise InputError(
                f"{where}: length = {table.cell(row, length)}: above 0 and at most {_LONGEST_BAR_M:g} m; "
                "millimetres are stated in the header, length (mm)"
            )
        spread = float(sigmas[row]) if table.cell(row, sigma) else BAR_SIGMA_M
        if not 0 < spread < known:
            raise InputError(f"{where}: sigma = {table.cell(row, sigma)}: above 0 and below the length of the bar")
        said = table.cell(row, role).lower()
        if said not in ("", "bar", *_CHECK):
            raise InputError(f"{where}: role {said!r} is neither bar nor check")
        check, line = said in _CHECK, table.line(row)
        out.append(FileBar(ends=ends, length_m=known, sigma_m=spread, check=check, line=line))
        for known_bar in out[:-1]:
            if set(known_bar.ends) == set(ends):
                raise InputError(
                    f"{where}: the bar from {ends[0]!r} to {ends[1]!r} is in line {known_bar.line} already "
                    f"({known_bar.length_m:g} m there, {known:g} m here): keep one"
                )
    return out, table.said(used)
