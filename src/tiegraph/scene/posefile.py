"""Files of poses: TUM (``t x y z qx qy qz qw``), KITTI (12 numbers, 3x4 row by row), and tables whose header names the
columns, such as EuRoC's (time in nanoseconds, w first).

Which component of a quaternion comes first cannot be seen in it. A header tells; without one, eight columns are TUM's,
as long as nothing speaks against it: commas, or a path that only makes sense with w first.
"""

from __future__ import annotations

import re
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from tiegraph.errors import InputError
from tiegraph.geometry.transforms import rigid
from tiegraph.scene.regular import regular
from tiegraph.scene.table import in_seconds, out_of_order, text_lines

FORMS = "a TUM file: t x y z qx qy qz qw"
_TUM, _KITTI = 8, 12
_FIELDS = ("t", "x", "y", "z", "qx", "qy", "qz", "qw")
_W_FIRST = (0, 1, 2, 3, 5, 6, 7, 4)  # columns of _FIELDS in a table with w first
_HEADERS = "'# time x y z qx qy qz qw' or '# time x y z qw qx qy qz'"
# What a file of poses can mean, and how its form is told; where that is not sure it is refused.
_NANOSECONDS = 1e17  # times since 1970 above this are in nanoseconds
_LAST_S = 1e11  # a time later than this is none, in seconds
_FAR_M = 1e8  # ECEF and grid coordinates are smaller
_EXTENT_M = 1e6  # of a survey
_MOVED = 1e-9  # poses that differ less are the same
_STEPS, _MOVE = 8, 0.1  # moves needed to see which way a body drives, and the least one in median moves
_BETTER, _UNSTEADY = 0.25, 0.01  # how much steadier the other order must be, and how unsteady this one


@dataclass(frozen=True)
class PoseFile:
    """Poses in time order: time_s (T,), NaN where the file has none; poses (T, 4, 4); what to say of the file."""

    time_s: np.ndarray
    poses: np.ndarray
    notes: tuple[str, ...] = ()


@dataclass(frozen=True)
class _Rows:
    """(T, C) numbers and the lines they stand in; the header's columns of _FIELDS, None without one."""

    path: Path
    numbers: np.ndarray
    lines: list[int]
    header: tuple[int, ...] | None
    nanoseconds: bool
    commas: bool

    def fail(self, row: int, message: str) -> InputError:
        return InputError(f"{self.path}, line {self.lines[row]}: {message}")


def read_poses(path: Path) -> PoseFile:
    """Read a file of poses.

    Rows are sorted by time; of rows of one time the first stays, and both is said. Raises InputError with the line for
    what is no text, a wrong number of columns, a number, quaternion or rotation that is none, positions out of any
    survey, times or poses that are all the same, and quaternions whose order is not sure.
    """
    rows = _rows(Path(path))
    if rows.header is None and rows.numbers.shape[1] == _KITTI:
        poses = _kitti(rows)
        _check_places(rows, poses[:, :3, 3])
        _check_moves(rows, poses)
        return PoseFile(np.full(len(poses), np.nan), poses)
    columns, said = _columns(rows)
    table = rows.numbers[:, columns]
    time_s = table[:, 0] * 1e-9 if rows.nanoseconds else in_seconds(table[:, 0])
    bad = np.flatnonzero(np.abs(time_s) > _LAST_S)
    if len(bad):
        raise rows.fail(bad[0], f"the time {table[bad[0], 0]:g} is none: seconds, or nanoseconds since 1970")
    with np.errstate(over="ignore"):
        length = np.linalg.norm(table[:, 4:], axis=1)
    bad = np.flatnonzero(~(np.abs(length - 1) <= 1e-2))
    if len(bad):
        raise rows.fail(bad[0], f"the quaternion qx qy qz qw has length {length[bad[0]]:.3g}, not 1")
    _check_places(rows, table[:, 1:4])
    poses = rigid(Rotation.from_quat(table[:, 4:]).as_matrix(), table[:, 1:4])
    _check_moves(rows, poses)
    keep, notes = _in_time(rows, time_s)
    return PoseFile(time_s[keep], poses[keep], (*said, *notes))


# --- text -----------------------------------------------------------------------------------------------------------


def _rows(path: Path) -> _Rows:
    try:
        text = regular(path).read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise InputError(f"{path}: cannot be read ({error.strerror}); give {FORMS}") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: no text file in UTF-8 (byte {error.start + 1}); give {FORMS}") from None
    lines = [(k + 1, line.strip()) for k, line in enumerate(text_lines(text)) if line.strip()]
    data = [k for k, (_, line) in enumerate(lines) if line[0] not in "#%"]
    start = next((k for k in data if not re.match(r"[A-Za-z_\"']", lines[k][1])), len(lines))
    rows = [lines[k] for k in data if k >= start]
    if not rows:
        raise InputError(f"{path}: no poses; give {FORMS}")
    named = [(n, _names(line)) for n, line in lines[:start]]
    header = next(((n, found) for n, found in reversed(named) if found is not None), None)
    if header is None and start > 0 and lines[start - 1][1][0] not in "#%":
        n, line = lines[start - 1]
        raise InputError(f"{path}, line {n}: a header of other columns, {line[:80]!r}; name them as in {_HEADERS}")
    numbers = _numbers(path, rows)
    if header is not None and numbers.shape[1] != header[1][1]:
        message = f"the header names {header[1][1]} columns, but the rows have {numbers.shape[1]}"
        raise InputError(f"{path}, line {header[0]}: {message}")
    where = [n for n, _ in rows]
    above = dict(lines)[header[0]].lower() if header is not None else ""
    nanoseconds = bool(re.search(r"\[ns\]|nanosec|nsec|_ns\b", above))
    return _Rows(
        path=path,
        numbers=numbers,
        lines=where,
        header=header[1][0] if header else None,
        nanoseconds=nanoseconds,
        commas="," in rows[0][1],
    )


def _numbers(path: Path, rows: list[tuple[int, str]]) -> np.ndarray:
    out, width = [], 0
    for n, line in rows:
        cells = re.split(r"\s*[,;]\s*|\s+", line.rstrip(",; "))
        width = width or len(cells)
        if len(cells) != width:
            raise InputError(f"{path}, line {n}: {len(cells)} columns, but the lines above have {width}")
        try:
            values = [float(c) for c in cells]
        except ValueError:
            raise InputError(f"{path}, line {n}: not all cells are numbers: {line[:99]!r}") from None
        if not np.isfinite(values).all():
            raise InputError(f"{path}, line {n}: not a finite number; leave lost poses out of the file")
        out.append(values)
    return np.array(out)


def _names(header: str) -> tuple[tuple[int, ...], int] | None:
    """Columns of _FIELDS that a header names and how many it has in all; None if it is none."""
    bare = re.sub(r"[(\[].*?[)\]]", "", header.strip("#%/ ").lower())
    cells = [c.strip(" \"'") for c in (re.split(r"[,;]", bare) if re.search("[,;]", bare) else bare.split())]
    found: dict[str, int] = {}
    for k, cell in enumerate(cells):
        turn = re.fullmatch(r"(?:q|.*(?:quat|orient|rot)|q[._].*).*?([wxyz])", cell)
        place = re.fullmatch(r"(?:[pt]?[._]?|[pt][._].*|.*(?:pos|trans).*)([xyz])", cell)
        if turn:
            found.setdefault(f"q{turn[1]}", k)
        elif re.fullmatch(r"t|.*(time|stamp).*|secs?|seconds?", cell):
            found.setdefault("t", k)
        elif place:
            found.setdefault(place[1], k)
    return (tuple(found[f] for f in _FIELDS), len(cells)) if set(_FIELDS) <= set(found) else None


# --- which column is which ------------------------------------------------------------------------------------------


def _columns(rows: _Rows) -> tuple[tuple[int, ...], tuple[str, ...]]:
    if rows.header is not None:
        said = (f"{rows.path.name}: quaternions with w first, as its header says",)
        return rows.header, said if rows.header[7] < rows.header[4] else ()
    width = rows.numbers.shape[1]
    if width != _TUM:
        raise rows.fail(
            0, f"{width} columns; expected 8 (TUM: t x y z qx qy qz qw) or 12 (KITTI), or a header that names them"
        )
    why = _speaks_for_w_first(rows.numbers)
    if rows.commas and (why or rows.numbers[0, 0] > _NANOSECONDS):
        return _W_FIRST, (f"{rows.path.name}: no header; read as EuRoC's table, quaternions with w first",)
    if why or rows.commas:
        why = why or "values between commas may be TUM's (w last) or EuRoC's (w first)"
        raise rows.fail(0, f"the order of the quaternions is not sure: {why}; say it in a first line {_HEADERS}")
    return tuple(range(_TUM)), ()


def _speaks_for_w_first(table: np.ndarray) -> str:
    """Why eight columns without header seem to hold w first, "" if nothing says so.

    A vehicle or hand drives in much the same direction of its own body all along. The angle between neighbours tells
    nothing: it is the same in any order of the components.
    """
    if not table[0, 1:4].any() and np.allclose(table[0, 4:], [1, 0, 0, 0], atol=1e-6):
        return "the first pose is at zero with 1 0 0 0, no turn with w first but half a turn with w last"
    last, first = _unsteady(table[:, 1:4], table[:, 4:]), _unsteady(table[:, 1:4], table[:, [5, 6, 7, 4]])
    if last > _UNSTEADY and first < _BETTER * last:
        return "with w first the body moves in one direction of its own, with w last it does not"
    return ""


def _unsteady(position: np.ndarray, xyzw: np.ndarray) -> float:
    """How much the direction of motion in the body's own frame varies: 0 = not at all, 1 = evenly spread."""
    step = np.diff(position, axis=0)
    length = np.sqrt(np.square(step / max(np.abs(step).max(initial=0.0), 1e-300)).sum(axis=1))
    moved = length > _MOVE * np.median(length[length > 0]) if (length > 0).any() else length > 0
    if moved.sum() < _STEPS or not ((np.abs(xyzw) <= 2).all() and (np.abs(xyzw).max(axis=1) > 0.1).all()):
        return 0.0
    ahead = step[moved] / np.linalg.norm(step[moved], axis=1, keepdims=True)
    own = Rotation.from_quat(xyzw[:-1][moved]).apply(ahead, inverse=True)
    return float(1 - np.linalg.norm(own.mean(axis=0)))


# --- what no trajectory can be --------------------------------------------------------------------------------------


def _kitti(rows: _Rows) -> np.ndarray:
    matrices = rows.numbers.reshape(-1, 3, 4)
    turns = matrices[:, :, :3]
    with np.errstate(over="ignore", invalid="ignore"):
        off = np.abs(turns @ np.swapaxes(turns, 1, 2) - np.eye(3)).max(axis=(1, 2))
        bad = np.flatnonzero(~(off <= 1e-2) | (np.linalg.det(turns) < 0))
    if len(bad):
        raise rows.fail(bad[0], "columns 1-3, 5-7, 9-11 are not a rotation")
    return rigid(Rotation.from_matrix(turns).as_matrix(), matrices[:, :, 3])


def _check_places(rows: _Rows, xyz: np.ndarray) -> None:
    away = np.abs(xyz - np.median(xyz, axis=0)).max(axis=1)
    far = np.flatnonzero((np.abs(xyz).max(axis=1) > _FAR_M) | ~(away <= _EXTENT_M))
    if len(far):
        k = far[int(np.argmax(away[far]))]
        x, y, z = xyz[k]
        raise rows.fail(
            k, f"the position ({x:g}, {y:g}, {z:g}) lies {away[k] / 1000:.3g} km from the others: leave that pose out"
        )


def _check_moves(rows: _Rows, poses: np.ndarray) -> None:
    if len(poses) > 1 and np.abs(poses - poses[0]).max() < _MOVED:
        raise rows.fail(0, f"all {len(poses)} poses are the same: a trajectory that says nothing; leave it away")


def _in_time(rows: _Rows, time_s: np.ndarray) -> tuple[np.ndarray, list[str]]:
    """Rows in time order without repeated times, and what to say of that."""
    name, notes = rows.path.name, []
    order = np.argsort(time_s, kind="stable")
    first = np.concatenate([[True], np.diff(time_s[order]) > 1e-9])
    if len(order) > 1 and first.sum() == 1:
        raise rows.fail(0, f"all {len(order)} poses have the same time, {time_s[0]:g}")
    odd = out_of_order(time_s)
    if len(odd):
        notes.append(f"{name}, line {rows.lines[odd[0]]}: rows are not in the order of time; they were sorted")
    if not first.all():
        again = min(rows.lines[k] for k in order[~first])
        notes.append(f"{name}, line {again}: {(~first).sum()} rows have the time of another row and are left out")
    return order[first], notes
