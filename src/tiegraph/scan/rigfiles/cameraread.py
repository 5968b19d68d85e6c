"""What readers of camera files share: what they find, and the few forms that values take in YAML, XML and JSON."""

import re
from collections.abc import Iterable
from dataclasses import dataclass

from tiegraph.errors import InputError

NUMBER = r"[-+]?(?:\d+\.?\d*|\.\d+)(?:[eE][-+]?\d+)?"
_ENDLESS_PX = 1e9  # no image is so large, and whole numbers of COLMAP hold it
CENTRE = 0.5  # OpenCV, ROS and Kalibr count pixels from the centre of the first one, COLMAP from its corner


@dataclass(frozen=True)
class FoundCamera:
    """A camera as a file has it, in COLMAP's model and order of parameters; ``where`` is file and, if known, line.

    ``name``: what the file calls it, "" = nothing.
    """

    model: str
    params: tuple[float, ...]
    size: tuple[int, int] | None
    where: str
    name: str = ""


def only_one(cameras: list[FoundCamera], where: str) -> FoundCamera:
    """The camera of a file that must have one. Raises InputError, naming them."""
    if len(cameras) == 1:
        return cameras[0]
    names = [c.name for c in cameras if c.name]
    listed = f" ({', '.join(names[:4])}{' ...' if len(names) > 4 else ''})" if names else ""
    raise InputError(
        f"{where}: {len(cameras)} cameras{listed}; keep the one that took the images, or give each its folder and "
        "camera in a rig.toml (`tiegraph init` writes one)"
    )


def zero(values: dict[str, float], names: Iterable[str], where: str, remedy: str) -> None:
    """Refuse terms that no camera model of COLMAP has beside the others. Raises InputError naming term and value."""
    for name in names:
        if values.get(name, 0.0) != 0.0:
            raise InputError(f"{where}: {name} = {values[name]:g}, which no camera model of COLMAP has here; {remedy}")


def word(content: str, key: str) -> str:
    """The word that YAML, XML or a JSON key gives, "" if it is not there."""
    found = re.search(rf"(?m)^[\s-]*{key}\s*:\s*[\"']?([\w+-]+)", content)
    found = found or re.search(rf"<{key}>\s*[\"']?([\w+-]+)", content)
    return found[1] if found else ""


def numbers_of(content: str, *keys: str) -> tuple[float, ...]:
    """The numbers of the first key that is there: ``key: [..]``, ``key: {data: [..]}``, one a line, XML's ``data``."""
    for key in keys:
        xml = re.search(rf"<{key}\b[^>]*>(.*?)</{key}>", content, re.DOTALL)
        if xml:
            data = re.search(r"<data>(.*?)</data>", xml[1], re.DOTALL)
            return numbers(data[1] if data else xml[1])
        head = re.search(rf"(?m)^[ \t-]*{key}[ \t]*:", content)
        if head is None:
            continue
        rest = content[head.end() :]
        same = re.match(rf"[ \t]*({NUMBER})[ \t]*(?:$|#)", rest, re.MULTILINE)
        if same:
            return numbers(same[1])
        rows = re.match(rf"[ \t]*\n((?:\s*-\s*{NUMBER}[ \t]*\n?)+)", rest)
        if rows:
            return numbers(re.sub(r"(?m)^\s*-\s+", "", rows[1]))
        brackets = re.match(r"[^\[]{0,200}\[([^\]]*)\]", rest)
        if brackets:
            return numbers(brackets[1])
    return ()


def matrix_of(content: str, key: str) -> tuple[float, ...]:
    """All numbers of a YAML key, in rows or not, up to the next key; () if it is not there."""
    head = re.search(rf"(?m)^[ \t-]*{key}[ \t]*:", content)
    if head is None:
        return ()
    rest = re.split(r"(?m)^[ \t]*[A-Za-z_]\w*[ \t]*:", content[head.end() :])[0]
    return numbers(re.sub(r"(?m)(?:(?<=^)|(?<=\s))-(?=\s)", " ", rest))


def numbers(text: str) -> tuple[float, ...]:
    """The numbers in a text."""
    return tuple(map(float, re.findall(NUMBER, text)))


def exactly(values: tuple[float, ...], count: int, what: str) -> tuple[float, ...]:
    """The values, if there are so many. Raises InputError."""
    if len(values) != count:
        raise InputError(f"{what}: {len(values)} numbers, {count} expected")
    return values


def size_of(values: tuple[float, ...]) -> tuple[int, int] | None:
    """Width and height, None if there are not two that can be meant; no more than ``_ENDLESS_PX`` of an endless one."""
    if len(values) != 2 or min(values) < 1:
        return None
    return int(min(values[0], _ENDLESS_PX)), int(min(values[1], _ENDLESS_PX))
