"""Files of poses: TUM (``t x y z qx qy qz qw``), KITTI (12 numbers, 3x4 row by row), and tables whose header names the
columns, such as EuRoC's (time in nanoseconds, w first).

The order of a quaternion's components cannot be seen in it. A header gives it. Without one, eight columns between
blanks are TUM's, and rows with nanoseconds between commas EuRoC's, unless the path contradicts that; other
columns between commas have the order that the path shows, or are refused. The path shows it by how the rotations fit
it: a vehicle or a hand moves in nearly the same direction of its own body all along.
"""

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

from tiegraph.errors import InputError
from tiegraph.geometry.transforms import are_rotations, quaternion_xyzw, rigid
from tiegraph.scene.cells import number, without_unit
from tiegraph.scene.table import read_table
from tiegraph.scene.times import Times, in_time_order, times_in, times_of

FORMS = "a TUM file: t x y z qx qy qz qw"
_TUM, _KITTI, _EUROC = 8, 12, 17  # columns
_FIELDS = ("t", "x", "y", "z", "qx", "qy", "qz", "qw")
_W_FIRST = (0, 1, 2, 3, 5, 6, 7, 4)  # columns of _FIELDS in a table with w first
_TIME = r"t|ts|t_n?s|.*(time|stamp).*|secs?|seconds?"
_HEADERS = "'# time x y z qx qy qz qw' or '# time x y z qw qx qy qz'"
# Limits of a file of poses, and rules for recognising its form; undecided ones are refused.
_NANOSECONDS = 1e17  # times since 1970 above this are in nanoseconds
_FAR_M = 1e8  # ECEF and grid coordinates are smaller
_PLAY = 1e-2  # tolerance of the length of a quaternion, or of R R^T = 1
_STEPS, _MOVE = 8, 0.1  # moves needed to see the direction of motion in the body, and the least one in median moves
_BETTER, _UNSTEADY = 0.25, 0.01  # how much steadier the other order must be, and how unsteady this one


@dataclass(frozen=True)
class Trajectory:
    """Poses in time order: time_s (T,), NaN where the file has none; poses (T, 4, 4); notes on the file."""

    time_s: np.ndarray
    poses: np.ndarray
    notes: tuple[str, ...] = ()
    names: tuple[str, ...] = ()  # the image of each pose, which then is its camera's, in no order; else ()
    metric: bool = True  # lengths are metres
    period_s: float = 0.0  # times count within a day or an unnamed GPS week; 0 = from an epoch

    def __len__(self) -> int:
        return len(self.time_s)


@dataclass(frozen=True)
class _Rows:
    """(T, C) numbers and their lines; with a header columns of _FIELDS, which of the table they are and the
    times."""

    path: Path
    numbers: np.ndarray
    lines: list[int]
    times: Times
    header: tuple[int, ...] | None = None
    commas: bool = False
    notes: tuple[str, ...] = ()

    def fail(self, row: int, message: str) -> InputError:
        return InputError(f"{self.path}, line {self.lines[row]}: {message}")


def read_poses(path: Path) -> Trajectory:
    """Read a file of poses.

    Rows are sorted by time; of rows of one time the first stays, both with a note. Raises InputError with the line for
    a file without text, a wrong number of columns, an invalid number, quaternion or rotation, positions out of any
    survey, times or poses that are all the same, and quaternions of undecided order.
    """
    rows = _rows(Path(path))
    if rows.header is None and rows.numbers.shape[1] == _KITTI:
        matrices = rows.numbers.reshape(-1, 3, 4)
        bad = np.flatnonzero(~are_rotations(matrices[:, :, :3], _PLAY))
        if len(bad):
            raise rows.fail(bad[0], "columns 1-3, 5-7, 9-11 are not a rotation")
        poses = rigid(Rotation.from_matrix(matrices[:, :, :3]).as_matrix(), matrices[:, :, 3])
        _check_places(rows, poses[:, :3, 3])
        _check_moves(rows, poses)
        return Trajectory(np.full(len(poses), np.nan), poses, rows.notes)
    columns, said = _columns(rows)
    table = rows.numbers[:, columns]
    found = _checked(rows, rows.times.seconds, table, (*rows.notes, *said))
    return replace(found, period_s=rows.times.period_s)


def checked_poses(path: Path, time_s: np.ndarray, xyz: np.ndarray, quaternion_xyzw: np.ndarray) -> Trajectory:
    """Poses of a binary file as from ``read_poses``, by their columns (T, ...); lines are their numbers."""
    table = np.column_stack([time_s, xyz, quaternion_xyzw])
    rows = _Rows(path, table, lines=list(range(1, len(table) + 1)), times=Times(time_s, {}))
    if not len(table):
        raise InputError(f"{path}: no poses")
    bad = np.flatnonzero(~np.isfinite(table).all(axis=1))
    if len(bad):
        raise rows.fail(bad[0], "not a finite number; leave lost poses out of the file")
    return _checked(rows, time_s, table)


def _checked(rows: _Rows, time_s: np.ndarray, table: np.ndarray, said: tuple[str, ...] = ()) -> Trajectory:
    """Poses of (T, 8) columns of _FIELDS in time order. Raises InputError for impossible trajectories."""
    bad = np.flatnonzero(~np.isfinite(time_s))
    if len(bad):
        raise rows.fail(bad[0], f"the time {table[bad[0], 0]:g} is none: seconds, or nanoseconds since 1970")
    with np.errstate(over="ignore"):
        length = np.linalg.norm(table[:, 4:], axis=1)
    bad = np.flatnonzero(~(np.abs(length - 1) <= _PLAY))
    if len(bad):
        raise rows.fail(bad[0], f"the quaternion qx qy qz qw has length {length[bad[0]]:.3g}, not 1")
    _check_places(rows, table[:, 1:4])
    poses = rigid(Rotation.from_quat(table[:, 4:]).as_matrix(), table[:, 1:4])
    _check_moves(rows, poses)
    keep, notes = in_time_order(time_s, rows.lines, rows.path)
    return Trajectory(time_s[keep], poses[keep], (*said, *notes))


def _rows(path: Path) -> _Rows:
    example = "time x y z qx qy qz qw, or give " + FORMS
    table = read_table(path, "trajectory", example, lambda rows: ("",) * len(rows[0]))
    named = _names(table.columns)
    stamp = next((k for k, c in enumerate(table.columns) if re.fullmatch(_TIME, c)), 0 if named is None else None)
    times = None if named is None else times_of(table)
    times = times_in(table, stamp) if times is None and stamp is not None else times
    if (named is None and table.head[0]) or times is None:
        message = f"a header of other columns, {table.head[1][:80]!r}; name them as in {_HEADERS}"
        raise InputError(f"{path}, line {table.head[0]}: {message}")
    short = next((k for k, (_, cells) in enumerate(table.rows) if len(cells) < len(table.columns)), None)
    if short is not None:
        message = f"{len(table.rows[short][1])} columns, but the lines above have {len(table.columns)}"
        raise InputError(f"{table.where(short)}: {message}")
    notes = list(table.notes)
    order = tuple(range(len(table.columns))) if named is None else (times.column, *named)
    numbers = np.stack([table.numbers(k) for k in order], axis=1)
    if named is not None:
        notes += [table.said({**times.used, **dict(zip(_FIELDS[1:], named))}), *times.notes]
        numbers[:, 0] = times.seconds
        numbers[:, 1:4] *= table.unit_m(named[0]) or 1.0
    bad = np.flatnonzero(~np.isfinite(numbers).all(axis=1))
    if len(bad):
        cells = [table.cell(int(bad[0]), k) for k in order]
        words = any(np.isnan(number(c)) and c.lower() != "nan" for c in cells)
        why = "not all cells are numbers" if words else "not a finite number; leave lost poses out of the file"
        raise InputError(f"{table.where(int(bad[0]))}: {why}: {' '.join(cells)!r:.99}")
    return _Rows(
        path=path,
        numbers=numbers,
        lines=[line for line, _ in table.rows],
        times=times,
        header=None if named is None else order,
        commas=(table.delimiter or "\t") in ",;",
        notes=tuple(notes),
    )


def _names(columns: tuple[str, ...]) -> tuple[int, ...] | None:
    """Columns of _FIELDS behind the time among those that a header names; None if it lacks some.

    The quaternion has components x, y, z and w under one prefix (q, rot, orientation_, r ...), the position is the
    first other one with x, y and z.
    """
    groups: dict[str, dict[str, int]] = {}
    for k, cell in enumerate(columns):
        part = re.fullmatch(r"(|.*?[a-z0-9])_?([wxyz])", without_unit(cell)[0])
        if part and not re.fullmatch(_TIME, cell):
            groups.setdefault(part[1], {}).setdefault(part[2], k)
    turn = next((g for g in groups.values() if set(g) == set("wxyz")), None)
    place = next((g for g in groups.values() if g is not turn and set("xyz") <= set(g)), None)
    if turn is None or place is None:
        return None
    return (*(place[c] for c in "xyz"), *(turn[c] for c in "xyzw"))


def _columns(rows: _Rows) -> tuple[tuple[int, ...], tuple[str, ...]]:
    """Columns of _FIELDS, and notes."""
    name, as_named = rows.path.name, tuple(range(_TUM))
    if rows.header is not None:  # its components are in our order already
        w_first, why = _w_first(rows.numbers[:, 1:4], rows.numbers[:, 4:])
        said = [f"{name}: quaternions with w first, as its header says"] if rows.header[7] < rows.header[4] else []
        said += [f"{name}: {why}: is the header right about the order of the quaternions?"] if w_first else []
        return as_named, tuple(said)
    width, euroc = rows.numbers.shape[1], rows.commas and rows.numbers[0, 0] > _NANOSECONDS
    if width != _TUM and not (euroc and width == _EUROC):
        raise rows.fail(
            0, f"{width} columns; expected 8 (TUM: t x y z qx qy qz qw) or 12 (KITTI), or a header that names them"
        )
    w_first, why = _w_first(rows.numbers[:, 1:4], rows.numbers[:, 4:8])
    if rows.commas and not euroc and w_first is not None:
        order = "first" if w_first else "last"
        return _W_FIRST if w_first else as_named, (f"{name}: quaternions with w {order}: {why}",)
    if w_first is (not euroc) or (rows.commas and not euroc):
        form = "EuRoC's table has w first, but " if euroc else "" if why else "the path does not show it; "
        why = why or "values between commas can be TUM's (w last) or EuRoC's (w first)"
        raise rows.fail(0, f"the order of the quaternions is not sure: {form}{why}; give it in a first line {_HEADERS}")
    if euroc:
        return _W_FIRST, (f"{name}: no header; read as EuRoC's table, quaternions with w first",)
    return as_named, ()


def _check_places(rows: _Rows, xyz: np.ndarray) -> None:
    away = np.abs(xyz - np.median(xyz, axis=0)).max(axis=1)
    far = np.flatnonzero((np.abs(xyz).max(axis=1) > _FAR_M) | ~(away <= 1e6))  # no survey is wider
    if len(far):
        k = far[int(np.argmax(away[far]))]
        x, y, z = xyz[k]
        raise rows.fail(
            k, f"the position ({x:g}, {y:g}, {z:g}) lies {away[k] / 1000:.3g} km from the others: leave that pose out"
        )


def _check_moves(rows: _Rows, poses: np.ndarray) -> None:
    if len(poses) > 1 and np.abs(poses - poses[0]).max() < 1e-9:  # poses that differ less are the same
        raise rows.fail(0, f"all {len(poses)} poses are the same: a trajectory without information; omit it")


def _w_first(position: np.ndarray, quaternion: np.ndarray) -> tuple[bool | None, str]:
    """The order of quaternions (T, 4) by positions (T, 3): whether w is first, None = undecided, and why."""
    words = ("first", "last")
    for is_first, unit in ((True, [1, 0, 0, 0]), (False, [0, 0, 0, 1])):
        if not position[0].any() and np.allclose(quaternion[0], unit, atol=1e-6):
            one, other = words if is_first else words[::-1]
            zero = f"the first pose is at zero with {' '.join(map(str, unit))}"
            return is_first, f"{zero}, no turn with w {one} but half a turn with w {other}"
    no_places = not np.abs(position).max(initial=0.0) < 1e12  # products of larger numbers overflow
    if no_places or not ((np.abs(quaternion) <= 2).all() and (np.abs(quaternion).max(axis=1) > 0.1).all()):
        return None, ""  # the reader reports them
    last, first = _unsteady(position, quaternion), _unsteady(position, np.roll(quaternion, -1, axis=1))
    for is_first, this, other in ((True, first, last), (False, last, first)):
        if other > _UNSTEADY and this < _BETTER * other:
            one, rest = words if is_first else words[::-1]
            return is_first, f"with w {one} the body moves in one direction of its own, with w {rest} it does not"
    return None, ""


def _unsteady(position: np.ndarray, xyzw: np.ndarray) -> float:
    """How much the direction of motion in the body's own frame varies: 0 = not at all, 1 = evenly spread."""
    step = np.diff(position, axis=0)
    length = np.sqrt(np.square(step / max(np.abs(step).max(initial=0.0), 1e-300)).sum(axis=1))
    moved = length > _MOVE * np.median(length[length > 0]) if (length > 0).any() else length > 0
    if moved.sum() < _STEPS:
        return 0.0
    ahead = step[moved] / np.linalg.norm(step[moved], axis=1, keepdims=True)
    own = Rotation.from_quat(xyzw[:-1][moved]).apply(ahead, inverse=True)
    return float(1 - np.linalg.norm(own.mean(axis=0)))


FREE_UNIT = "# unit: free (a single camera gives no scale)"
"""A line of a TUM file whose lengths are not in metres."""


def write_tum(path: Path, time_s: np.ndarray, world_from_rig: np.ndarray, said: Sequence[str] = ()) -> None:
    """Write poses (T, 4, 4) as TUM; unknown poses are left out, unknown times become the row's number. The texts
    ``said`` precede them, a line each."""
    lines = [*said, "# time_s x y z qx qy qz qw"]
    for k, (t, pose) in enumerate(zip(time_s, world_from_rig)):
        if np.isfinite(pose[:3]).all():
            values = [*pose[:3, 3], *quaternion_xyzw(pose[:3, :3])]
            lines.append(f"{t if np.isfinite(t) else k:.6f} " + " ".join(f"{v:.9f}" for v in values))
    Path(path).write_text("\n".join(lines) + "\n")
