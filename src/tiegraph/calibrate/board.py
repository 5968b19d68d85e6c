"""Boards: how their words or Kalibr's file are read, and where their corners are.

``charuco:7x5:0.04:0.03[:DICT_5X5_1000][:legacy]``: squares across and down, side of a square and of a marker, metres,
OpenCV's dictionary (default DICT_5X5_1000); ``legacy``: the pattern of OpenCV before 4.6 (even numbers of rows).
``checker:9x6:0.025``: inner corners across and down, side of a square. A file ``aprilgrid.yaml`` or
``checkerboard.yaml`` as Kalibr's wiki has it ("calibration targets").

Points are in metres in the plane z = 0, in the order of OpenCV's corners; of an AprilGrid four a tag, tag after tag,
x to the right and y up as Kalibr's. OpenCV's DICT_APRILTAG_36h11 has its tags turned by 180 degrees against those that
Kalibr prints (compared bit by bit), so its first corner is Kalibr's lower right one.
"""

import re
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np

from tiegraph.errors import InputError
from tiegraph.scene.regular import regular

CHARUCO, CHECKER, APRILGRID = "charuco", "checker", "aprilgrid"
_EXAMPLES = {CHARUCO: "charuco:7x5:0.04:0.03:DICT_5X5_1000", CHECKER: "checker:9x6:0.025"}
_FORMS = f"give {_EXAMPLES[CHARUCO]}, {_EXAMPLES[CHECKER]} or Kalibr's aprilgrid.yaml"
_MOST_M = 1.0  # side of a square or tag: a larger one is in millimetres
_MAX_COUNT = 100  # of squares, corners or tags along a side


@dataclass(frozen=True)
class Board:
    """A board; ``points`` (K, 3) of its corners, metres, z = 0 where it is flat."""

    kind: str
    counts: tuple[int, int]  # squares, inner corners or tags, across and down
    points: np.ndarray
    marker: float = 0.0  # of a ChArUco board, side over that of a square
    dictionary: str = ""
    legacy: bool = False

    @property
    def counted(self) -> str:
        """What ``counts`` is of, and what else must be as it was printed, in words."""
        said = {CHARUCO: "squares, dictionary, legacy or not", CHECKER: "inner corners: one less than squares"}
        return said.get(self.kind, "tags")

    @property
    def turnable(self) -> bool:
        """Whether it looks the same after half a turn, so that two cameras may number its corners differently."""
        return self.kind == CHECKER and sum(self.counts) % 2 == 0


def read_board(text: str) -> Board:
    """The board of ``--board``. Raises InputError naming what is wrong and the forms that are read."""
    kind, *words = text.split(":")
    if kind in _EXAMPLES:
        return (_charuco if kind == CHARUCO else _checker)(text, words)
    if Path(text).suffix.lower() in (".yaml", ".yml"):
        return _kalibr(Path(text))
    raise InputError(f"--board {text}: {_FORMS}")


def _charuco(text: str, words: list[str]) -> Board:
    legacy = words[-1:] == ["legacy"]
    words = words[: len(words) - legacy]
    if not 3 <= len(words) <= 4:
        raise InputError(f"--board {text}: squares, side of a square and of a marker: {_EXAMPLES[CHARUCO]}")
    where = f"--board {text}"
    counts = _counts(words[0], where)
    square, marker = (_length(w, where) for w in words[1:3])
    if marker >= square:
        raise InputError(f"--board {text}: the marker ({marker:g} m) is not smaller than its square ({square:g} m)")
    dictionary = (words[3:] or ["DICT_5X5_1000"])[0].upper()
    dictionary = dictionary if dictionary.startswith("DICT_") else f"DICT_{dictionary}"
    if not hasattr(cv2.aruco, dictionary):
        known = ", ".join(n for n in dir(cv2.aruco) if n.startswith("DICT_"))
        raise InputError(f"--board {text}: no dictionary {dictionary}; OpenCV has {known}")
    there = len(cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, dictionary)).bytesList)
    if counts[0] * counts[1] // 2 > there:
        raise InputError(f"--board {text}: {counts[0] * counts[1] // 2} markers, but {dictionary} has {there}")
    across, down = (n - 1 for n in counts)
    return Board(
        kind=CHARUCO, counts=counts, points=square * (_grid(across, down) + (1, 1, 0)), marker=marker / square,
        dictionary=dictionary, legacy=legacy,
    )  # fmt: skip


def _checker(text: str, words: list[str]) -> Board:
    if len(words) == 1:
        raise InputError(
            f"--board {text}: the side of a square is missing, in metres: measure it over many squares. For a single "
            f"camera any will do ({text}:0.03), for its calibration has no lengths"
        )
    if len(words) != 2:
        raise InputError(f"--board {text}: inner corners and side of a square: {_EXAMPLES[CHECKER]}")
    where = f"--board {text}"
    counts = _counts(words[0], where)
    return Board(CHECKER, counts, _length(words[1], where) * _grid(*counts))


def _kalibr(path: Path) -> Board:
    try:
        content = regular(path).read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"--board {path}: cannot be read as text in UTF-8 ({error})") from None
    lines = (re.match(r"\s*(\w+)\s*:\s*['\"]?([^'\"#\s]+)", line) for line in content.splitlines())
    values = {m[1]: m[2] for m in lines if m}
    kind = values.get("target_type", "")
    if kind not in ("aprilgrid", "checkerboard"):
        said = f"target_type: {kind}" if kind else "no target_type"
        raise InputError(f"--board {path}: {said}; read are aprilgrid and checkerboard (Kalibr's calibration targets)")
    names = ("tagCols", "tagRows") if kind == "aprilgrid" else ("targetCols", "targetRows")
    where = f"--board {path}"
    counts = _counts("x".join(_value(values, n, where) for n in names), where)
    if kind == "checkerboard":
        sides = [_length(_value(values, f"{n}SpacingMeters", where), where) for n in ("col", "row")]
        return Board(CHECKER, counts, _grid(*counts) * (*sides, 0.0))
    size = _length(_value(values, "tagSize", where), where)
    spacing = _number(_value(values, "tagSpacing", where), where)
    if not 0 < spacing <= 1:
        raise InputError(f"--board {path}: tagSpacing = {spacing:g}: the gap between tags over their side, 0 to 1")
    corners = np.array([[1, 0, 0], [0, 0, 0], [0, 1, 0], [1, 1, 0]])  # OpenCV's order, of a tag that is turned
    tags = (1 + spacing) * _grid(*counts)
    return Board(APRILGRID, counts, size * (tags[:, None] + corners).reshape(-1, 3), dictionary="DICT_APRILTAG_36h11")


def _grid(across: int, down: int) -> np.ndarray:
    """(across * down, 3) places of a grid with sides of 1, row by row."""
    x, y = np.meshgrid(np.arange(across), np.arange(down))
    return np.stack([x.ravel(), y.ravel(), np.zeros(x.size)], axis=1).astype(float)


def _value(values: Mapping[str, str], name: str, where: str) -> str:
    if name not in values:
        raise InputError(f"{where}: {name} is missing")
    return values[name]


def _counts(word: str, where: str) -> tuple[int, int]:
    found = re.fullmatch(r"(\d{1,6})[xX](\d{1,6})", word)
    if not found:
        raise InputError(f"{where}: {word!r} are no counts across and down, such as 7x5")
    across, down = int(found[1]), int(found[2])
    if not 2 <= min(across, down) <= max(across, down) <= _MAX_COUNT or max(across, down) < 3:
        raise InputError(f"{where}: {across} x {down}: 3 x 2 at least, {_MAX_COUNT} at most along a side")
    return across, down


def _number(word: str, where: str) -> float:
    try:
        value = float(word)
    except ValueError:
        value = np.nan
    if not np.isfinite(value):
        raise InputError(f"{where}: {word!r} is no number")
    return value


def _length(word: str, where: str) -> float:
    value = _number(word, where)
    if not 0 < value <= _MOST_M:
        hint = f": {value:g} mm are {value / 1000:g}" if value > _MOST_M else ""
        raise InputError(f"{where}: a side of {value:g} m: above 0, {_MOST_M:g} at most; lengths are in metres{hint}")
    return value
