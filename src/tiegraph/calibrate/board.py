"""Boards: how their words or Kalibr's file are read, where their corners are, and what the cameras must see of them.

``charuco:7x5:0.04:0.03[:DICT_5X5_1000][:legacy]``: squares across and down, side of a square and of a marker, metres,
OpenCV's dictionary (default DICT_5X5_1000); ``legacy``: the pattern of OpenCV before 4.6 (even numbers of rows).
``checker:9x6:0.025``: inner corners across and down, side of a square. A file ``aprilgrid.yaml`` or
``checkerboard.yaml`` as Kalibr's wiki has it ("calibration targets").

Points are in metres in the plane z = 0, in the order of OpenCV's corners; of an AprilGrid four a tag, tag after tag,
x to the right and y up as Kalibr's. OpenCV's DICT_APRILTAG_36h11 has its tags turned by 180 degrees against those that
Kalibr prints (compared bit by bit), so its first corner is Kalibr's lower right one.
"""

import re
from collections.abc import Collection, Mapping, Sequence
from dataclasses import dataclass, replace
from functools import lru_cache
from itertools import combinations
from pathlib import Path, PurePosixPath

import cv2
import numpy as np
from scipy.spatial import cKDTree

from tiegraph.errors import InputError
from tiegraph.scene.atomic import regular
from tiegraph.scene.graph import parts
from tiegraph.scene.targets import CENTRE, refined

CHARUCO, CHECKER, APRILGRID = "charuco", "checker", "aprilgrid"
_EXAMPLES = {CHARUCO: "charuco:7x5:0.04:0.03:DICT_5X5_1000", CHECKER: "checker:9x6:0.025"}
_FORMS = f"give {_EXAMPLES[CHARUCO]}, {_EXAMPLES[CHECKER]} or Kalibr's aprilgrid.yaml"
_MOST_M = 1.0  # side of a square or tag: a larger one is in millimetres
_MAX_COUNT = 100  # of squares, corners or tags along a side
LEAST_VIEWS = 3  # of a camera: two of a plane fix a focal length and no more
_LEAST_JOINT = 2  # instants at which two cameras see the board together: a single one may be wrong unnoticed
_LEAST_CORNERS = 8  # of a view: four hold a pose without telling anything of it
# Free about a corner of a checkerboard, in sides of a square: paper is trimmed, and windows that reach over its edge
# pulled corners off by up to 6 px (OpenCV's photographs); 0.4 still does where 0.4 of the outer squares are left, and
# full windows are no better than 0.019 px for 0.021 (rendered, `tests/calibrate`).
_TRIMMED = 0.3
Corners = tuple[np.ndarray, np.ndarray]
"""Numbers (K,) of corners of the board, and where they are, (K, 2) COLMAP's pixels."""


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
        return (_charuco if kind == CHARUCO else _checker)(text, words, f"--board {text}")
    if Path(text).suffix.lower() in (".yaml", ".yml"):
        return _kalibr(Path(text))
    raise InputError(f"--board {text}: {_FORMS}")


def _charuco(text: str, words: list[str], where: str) -> Board:
    legacy = words[-1:] == ["legacy"]
    words = words[: len(words) - legacy]
    if not 3 <= len(words) <= 4:
        raise InputError(f"{where}: squares, side of a square and of a marker: {_EXAMPLES[CHARUCO]}")
    counts = _counts(words[0], where)
    square, marker = (_length(w, where) for w in words[1:3])
    if marker >= square:
        raise InputError(f"{where}: the marker ({marker:g} m) is not smaller than its square ({square:g} m)")
    dictionary = (words[3:] or ["DICT_5X5_1000"])[0].upper()
    dictionary = dictionary if dictionary.startswith("DICT_") else f"DICT_{dictionary}"
    if not hasattr(cv2.aruco, dictionary):
        known = ", ".join(n for n in dir(cv2.aruco) if n.startswith("DICT_"))
        raise InputError(f"{where}: no dictionary {dictionary}; OpenCV has {known}")
    there, markers = len(_dictionary(dictionary).bytesList), counts[0] * counts[1] // 2
    if markers > there:
        raise InputError(f"{where}: {markers} markers, but {dictionary} has {there}")
    across, down = (n - 1 for n in counts)
    return Board(
        kind=CHARUCO, counts=counts, points=square * (_grid(across, down) + (1, 1, 0)), marker=marker / square,
        dictionary=dictionary, legacy=legacy,
    )  # fmt: skip


def _checker(text: str, words: list[str], where: str) -> Board:
    if len(words) == 1:
        raise InputError(
            f"{where}: the side of a square is missing, in metres: measure it over many squares. For a single "
            f"camera any will do ({text}:0.03), for its calibration has no lengths"
        )
    if len(words) != 2:
        raise InputError(f"{where}: inner corners and side of a square: {_EXAMPLES[CHECKER]}")
    counts = _counts(words[0], where)
    return Board(CHECKER, counts, _length(words[1], where) * _grid(*counts))


def _kalibr(path: Path) -> Board:
    where = f"--board {path}"
    try:
        content = regular(path).read_text(encoding="utf-8-sig")
    except (OSError, UnicodeDecodeError) as error:
        raise InputError(f"{where}: cannot be read as text in UTF-8 ({error})") from None
    lines = (re.match(r"\s*(\w+)\s*:\s*['\"]?([^'\"#\s]+)", line) for line in content.splitlines())
    values = {m[1]: m[2] for m in lines if m}
    kind = values.get("target_type", "")
    if kind not in ("aprilgrid", "checkerboard"):
        said = f"target_type: {kind}" if kind else "no target_type"
        raise InputError(f"{where}: {said}; read are aprilgrid and checkerboard (Kalibr's calibration targets)")
    names = ("tagCols", "tagRows") if kind == "aprilgrid" else ("targetCols", "targetRows")
    counts = _counts("x".join(_value(values, n, where) for n in names), where)
    if kind == "checkerboard":
        sides = [_length(_value(values, f"{n}SpacingMeters", where), where) for n in ("col", "row")]
        return Board(CHECKER, counts, _grid(*counts) * (*sides, 0.0))
    size = _length(_value(values, "tagSize", where), where)
    spacing = _number(_value(values, "tagSpacing", where), where)
    if not 0 < spacing <= 1:
        raise InputError(f"{where}: tagSpacing = {spacing:g}: the gap between tags over their side, 0 to 1")
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


def detect(pixels: np.ndarray, board: Board) -> Corners:
    """The corners that are seen in an image (H, W) u1; none if they are too few to hold a pose."""
    find = {CHARUCO: _find_charuco, APRILGRID: _find_aprilgrid}.get(board.kind, _find_checker)
    numbers, xy = find(pixels, board)
    if len(numbers) >= _LEAST_CORNERS:
        places = board.points[numbers, :2]
        spread = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
        if spread[1] >= 0.15 * spread[0]:  # along a line they hold no pose
            return numbers, xy.astype(float) + CENTRE
    return np.zeros(0, int), np.zeros((0, 2))


def _find_charuco(pixels: np.ndarray, board: Board) -> Corners:
    detector = _charuco_detector(board.counts, board.marker, board.dictionary, board.legacy)
    xy, numbers, _, _ = detector.detectBoard(pixels)
    if numbers is None or xy is None or len(numbers) < _LEAST_CORNERS:
        return np.zeros(0, int), np.zeros((0, 2))
    xy = xy.reshape(-1, 2)
    # OpenCV's own windows reach into the markers: 0.09 px of error where these have 0.03 (tests/calibrate).
    return numbers.ravel().astype(int), _refined(pixels, xy, (1 - board.marker) / 2 * _nearest(xy))


@lru_cache
def _charuco_detector(
    counts: tuple[int, int], marker: float, dictionary: str, legacy: bool
) -> cv2.aruco.CharucoDetector:
    made = cv2.aruco.CharucoBoard(counts, 1.0, marker, _dictionary(dictionary))
    made.setLegacyPattern(legacy)
    return cv2.aruco.CharucoDetector(made)


def _dictionary(name: str) -> cv2.aruco.Dictionary:
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def _find_checker(pixels: np.ndarray, board: Board) -> Corners:
    for effort in (0, cv2.CALIB_CB_EXHAUSTIVE):
        flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_ACCURACY | effort
        found, xy = cv2.findChessboardCornersSB(pixels, board.counts, flags=flags)
        if found:
            xy = xy.reshape(-1, 2)
            return np.arange(len(board.points)), _refined(pixels, xy, _TRIMMED * _nearest(xy))
    return np.zeros(0, int), np.zeros((0, 2))


def _find_aprilgrid(pixels: np.ndarray, board: Board) -> Corners:
    quads, tags, _ = _tag_detector(board.dictionary).detectMarkers(pixels)
    inside = [] if tags is None else [(int(t), q) for t, q in zip(tags.ravel(), quads) if t < len(board.points) // 4]
    if not inside:
        return np.zeros(0, int), np.zeros((0, 2))
    numbers = (4 * np.array([tag for tag, _ in inside])[:, None] + np.arange(4)).ravel()
    sides = [np.linalg.norm(q.reshape(4, 2) - np.roll(q.reshape(4, 2), 1, axis=0), axis=1).min() for _, q in inside]
    bit = float(min(sides)) / 10  # along the side of a tag, with its borders
    return numbers, _refined(pixels, np.concatenate([q.reshape(4, 2) for _, q in inside]), bit * 2)


def _nearest(xy: np.ndarray) -> float:
    return float(cKDTree(xy).query(xy, 2)[0][:, 1].min())


def _refined(pixels: np.ndarray, xy: np.ndarray, free_px: float) -> np.ndarray:
    """Corners (K, 2), each where black and white meet like on a checkerboard; about each so much is free of others."""
    return refined(pixels, xy, free_px, 0.8, (2, 11))  # half a window: in what is free, and its bounds in pixels


@lru_cache
def _tag_detector(dictionary: str) -> cv2.aruco.ArucoDetector:
    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = 2
    return cv2.aruco.ArucoDetector(_dictionary(dictionary), parameters)


@dataclass(frozen=True)
class CameraImages:
    """A camera by the folder of its images ("" = all): COLMAP's model, width and height in pixels, number of images."""

    name: str
    folder: str
    model: str
    size: tuple[int, int]
    count: int


@dataclass(frozen=True)
class View:
    """What a camera (number) sees of the board at an instant: ``corners`` (K,) at ``xy`` (K, 2), COLMAP's pixels."""

    camera: int
    instant: int
    name: str
    corners: np.ndarray
    xy: np.ndarray


@dataclass(frozen=True)
class Observations:
    """All views of a calibration."""

    board: Board
    cameras: tuple[CameraImages, ...]
    views: tuple[View, ...]

    def of_camera(self, camera: int) -> "Observations":
        """One camera and its views, in which it is the first."""
        views = tuple(replace(v, camera=0) for v in self.views if v.camera == camera)
        return Observations(self.board, self.cameras[camera : camera + 1], views)

    def instants(self) -> list[int]:
        """The instants at which any camera sees the board."""
        return sorted({v.instant for v in self.views})

    def corners(self) -> np.ndarray:
        """(K,) numbers of the corners that any view has, ascending."""
        return np.unique(np.concatenate([view.corners for view in self.views]))

    def among(self, instants: Collection[int]) -> "Observations":
        """The views of these instants."""
        return replace(self, views=tuple(v for v in self.views if v.instant in instants))

    def without(self, views: Collection[str]) -> "Observations":
        """All views but those of these names."""
        return replace(self, views=tuple(v for v in self.views if v.name not in views))


def check_views(seen: Observations) -> None:
    """Raise InputError for a camera that sees the board in no image or too few, for cameras that number its corners
    differently, and for cameras that nothing ties together."""
    for number, camera in enumerate(seen.cameras):
        views = len(seen.of_camera(number).views)
        if views == 0:
            raise InputError(
                f"{camera.name}: the board was found in none of its {camera.count} images: does --board say what was "
                f"printed ({' x '.join(map(str, seen.board.counts))} {seen.board.counted}), and is the board sharp and "
                "whole in them?"
            )
        if views < LEAST_VIEWS:
            raise InputError(
                f"{camera.name}: the board was found in {views} of its {camera.count} images, and {LEAST_VIEWS} "
                "are the least: take 20 or more, near and far, tilted, in every part of the image"
            )
    if len(seen.cameras) > 1 and seen.board.turnable:
        raise InputError(
            f"a checkerboard of {seen.board.counts[0]} x {seen.board.counts[1]} inner corners looks the same after "
            "half a turn, so cameras may number its corners differently: take one with an odd and an even count, or "
            "ChArUco"
        )
    a, b = np.nonzero(joint_instants(seen) >= _LEAST_JOINT)
    part = parts(a, b, len(seen.cameras))
    if part.any():
        named = " | ".join(", ".join(c.name for c, own in zip(seen.cameras, part == k) if own) for k in np.unique(part))
        raise InputError(
            f"nothing ties these cameras together: {named}. At {_LEAST_JOINT} instants or more one of each group "
            "must see the board together with one of another (a part of it will do with ChArUco and AprilGrid). Are "
            "images of one instant called alike?"
        )


def check_count(folder: Path, images: int) -> None:
    """Raise InputError for fewer images than views that a camera needs."""
    if 0 < images < LEAST_VIEWS:
        raise InputError(
            f"{folder}: {images} image{'s' * (images > 1)}, and a camera needs the board in {LEAST_VIEWS} at "
            "least: take 20 or more, near and far, tilted, in every part of the image"
        )


def check_one_camera(names: Sequence[str]) -> None:
    """Raise InputError for images of one folder that are numbered like those of two cameras: left01 and right01."""
    numbers: dict[str, dict[str, set[int]]] = {}  # by folder and beginning of the name
    for name in map(PurePosixPath, names):
        if found := re.fullmatch(r"(.*?)(\d+)", name.stem):
            numbers.setdefault(str(name.parent), {}).setdefault(found[1], set()).add(int(found[2]))
    for begun in numbers.values():
        for (a, one), (b, two) in combinations(sorted(begun.items()), 2):
            if len(one & two) >= LEAST_VIEWS:
                raise InputError(
                    f"images in one folder: {len(one & two)} numbers stand behind {a!r} and behind {b!r}. If two "
                    f"cameras took them, give each a folder of its own ({a.strip('_- ')}/, {b.strip('_- ')}/); if one "
                    "did, say --layout sequence"
                )


def joint_instants(seen: Observations) -> np.ndarray:
    """(C, C) number of instants at which two cameras see the board together."""
    there = np.zeros((len(seen.cameras), max(seen.instants(), default=0) + 1), int)
    for view in seen.views:
        there[view.camera, view.instant] = 1
    return there @ there.T
