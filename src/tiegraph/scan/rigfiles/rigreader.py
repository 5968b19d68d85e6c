"""Checks of the keys and values of a rig file that name the file, the line and the key."""

import difflib
import re
import sys
from pathlib import Path
from typing import Any, ClassVar

import numpy as np
import pycolmap

from tiegraph.errors import InputError
from tiegraph.geometry.transforms import from_quaternion_wxyz
from tiegraph.scan.rigfiles.rigfaults import Fault
from tiegraph.scan.rigfiles.rigspec import UNIT, RigSpec
from tiegraph.scan.tuning import RigTuning
from tiegraph.scene.textfile import text_lines


class Reader:
    """Checks of keys and values that name the file, the line and the key."""

    tables: ClassVar[dict[str, str]] = {}  # patterns by which the tables of sensors and pairs begin
    words: ClassVar[dict[str, str]] = {}  # keys that have another name in this form of file

    def __init__(self, path: Path, text: str, tuning: RigTuning) -> None:
        self.path, self.lines, self.tuning = path, text_lines(text), tuning

    def rigs(self) -> tuple[RigSpec, ...]:
        """The rigs of the file."""
        raise NotImplementedError

    def fail(self, key: str, message: str, table: str = "", number: int = 0) -> InputError:
        """The error of a key, with file and line."""
        return InputError(f"{self.at(key, table, number)}: {message}")

    def at(self, key: str, table: str = "", number: int = 0) -> str:
        """File and line of a key."""
        line = self.line(key, table, number)
        return f"{self.path}{f', line {line}' if line else ''}"

    def fault(self, fault: Fault, rig: RigSpec) -> InputError:
        """The error of what is wrong with a rig read from this file."""
        number = rig.sensors[fault.number].number if fault.table == "sensors" else fault.number
        return self.fail(self.words.get(fault.key, fault.key), fault.message, self.tables.get(fault.table, ""), number)

    def line(self, key: str, table: str, number: int) -> int:
        """Line of a key in the ``number``-th table, else that of the table, 0 if there is none."""
        first, last = self.span(table, number) if table else (0, len(self.lines))
        pattern = re.compile(rf'(^|[\s{{,"]){re.escape(key)}"?\s*[=:]')
        for k in range(first, last):
            text = self.lines[k].split("#", 1)[0]
            if pattern.search(text) or re.match(rf"\s*\[+\s*{re.escape(key)}\s*\]", text):
                return k + 1
        return first + 1 if table and first < last else 0

    def span(self, table: str, number: int) -> tuple[int, int]:
        """Lines [first, last) of the ``number``-th table whose header matches; (0, 0) if there is none.

        A table ends at the next header that is no table within it ([sensors.camera] is within [[sensors]]).
        """
        heads = [k for k, text in enumerate(self.lines) if re.match(table, text)]
        if number >= len(heads):
            return 0, 0
        inner = re.sub(r"[^\w]", "", self.lines[heads[number]].split("#", 1)[0])
        ends = (
            k
            for k in range(heads[number] + 1, len(self.lines))
            if re.match(r"\s*\[+\s*[A-Za-z_]", self.lines[k]) and not re.match(rf"\s*\[+\s*{inner}\s*\.", self.lines[k])
        )
        return heads[number], next(ends, len(self.lines))

    def known(self, data: dict, valid: tuple[str, ...], where: str, table: str = "", number: int = 0) -> None:
        """Raise InputError for a key that is not valid, with a near match."""
        for key in data:
            if key not in valid:
                near = difflib.get_close_matches(key, valid, n=1)
                hint = f"; perhaps you meant {near[0]!r}?" if near else ""
                raise self.fail(key, f"unknown key {key!r} in {where}{hint} (valid: {', '.join(valid)})", table, number)

    def numbers(
        self, data: dict, key: str, count: tuple[int, ...], table: str = "", number: int = 0
    ) -> tuple[float, ...] | None:
        """A list of finite numbers of given length, None if the key is not there."""
        value = data.get(key)
        if value is None:
            return None
        good = isinstance(value, list) and all(is_number(v) for v in value)
        if not good or (count and len(value) not in count):
            many = f"{' or '.join(map(str, count))} " if count else ""
            raise self.fail(key, f"{key} = {value!r:.99}: expected a list of {many}finite numbers", table, number)
        return tuple(float(v) for v in value)

    def choice(self, data: dict, key: str, valid: tuple[Any, ...], table: str = "", number: int = 0) -> Any:
        """One of the valid values, the first if the key is not there."""
        value = data.get(key, valid[0])
        if value not in valid or isinstance(value, bool) != isinstance(valid[0], bool):
            words = ", ".join(str(v).lower() if isinstance(v, bool) else str(v) for v in valid)
            raise self.fail(key, f"{key} = {value!r}: valid are {words}{nearest(value, valid)}", table, number)
        return value

    def model(self, value: Any, params: Any, table: str = "", number: int = 0, key: str = "model") -> str:
        """A COLMAP camera model name, with the right number of parameters."""
        valid = tuple(m for m in pycolmap.CameraModelId.__members__ if m not in ("INVALID", "EQUIRECTANGULAR"))
        if value not in valid:
            raise self.fail(
                key, f"unknown camera model {value!r}{nearest(value, valid)} (COLMAP's names)", table, number
            )
        info = pycolmap.Camera.create_from_model_name(0, value, 1.0, 1, 1)
        if params is not None and len(params) != len(info.params):
            message = f"{value} has {len(info.params)} parameters ({info.params_info}), got {len(params)}"
            raise self.fail(key, message, table, number)
        return str(value)

    def quaternion(self, q: tuple[float, ...], key: str, table: str = "", number: int = 0) -> np.ndarray:
        """Rotation (3, 3) of a unit quaternion, w first."""
        if abs(np.linalg.norm(q) - 1) > UNIT:
            raise self.fail(key, f"{key}: the quaternion has length {np.linalg.norm(q):.4g}, not 1", table, number)
        return from_quaternion_wxyz(np.array(q), np.zeros(3))[:3, :3]


def is_number(value: Any) -> bool:
    """Whether a value of a file is a finite number that a float can hold."""
    if isinstance(value, bool) or not isinstance(value, (int, float)):
        return False
    return abs(value) < sys.float_info.max


def nearest(value: Any, valid: tuple[Any, ...]) -> str:
    """A hint at the valid word nearest to a wrong one, "" if none is near."""
    near = difflib.get_close_matches(str(value), [str(v) for v in valid], n=1, cutoff=0.5)
    return f"; perhaps you meant {near[0]!r}?" if near else ""
