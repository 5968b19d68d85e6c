"""Names of coded targets: ``tag36h11:12``, ``tag25h9:3``, ``4x4_50:7``, ``aruco_original:5``, ``DICT_6X6_250:1``."""

import re
from dataclasses import dataclass
from functools import cache

import cv2

FORM = "a target is named by its family and number, such as tag36h11:12 or 4x4_50:7"
_NAME = re.compile(r"\s*([A-Za-z][\w ]*|\d[xX]\d_\d+)\s*:\s*(\d{1,6})\s*")
_APRILTAG, _ARUCO = "apriltag_", "aruco_"


@dataclass(frozen=True, order=True)
class Target:
    """A coded target: the name of its family, as OpenCV calls it in lower case without DICT_, and its number."""

    family: str
    number: int

    @property
    def name(self) -> str:
        """As a user writes it."""
        return f"{self.family.replace(_APRILTAG, 'tag')}:{self.number}"


def target_of(name: str) -> Target | None:
    """The target that a point's name means, None if it is the name of no target."""
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
    """How many targets a family has, numbered from 0."""
    return len(dictionary(family).bytesList)
