"""The trailer that Insta360's cameras write behind an MP4: positions and times of their receiver or the remote's.

The file ends with 32 bytes, the length of the trailer, a version and 32 letters. Records precede them, each
followed by its format, its kind and its length; newer cameras leave gaps between the records, and record 0, the last,
lists their places. Record 7 has rows of 53 bytes: UTC since 1970 in seconds and milliseconds, A or V (acquired, void),
latitude with N or S, longitude with E or W (O in French), speed, course, height. As ExifTool (QuickTimeStream) and
telemetry-parser read it.

The factory's calibration of the two lenses is in the file too, as numbers joined by "_", the first the number of
lenses; the last gives the form (above its lowest 16 bits). The oldest, 0, has for each lens radius, centre x, y, yaw,
pitch, roll, then width, height and kind (ExifTool's Parameters). Form 3 has for each the mirror parameter xi of a
unified sphere (Mei 2007), fx, fy, cx, cy, yaw, pitch, roll, three metres, k1, k2, k3, p1, p2, width, height, kind.
Lengths are pixels of both lenses side by side, angles degrees. telemetry-parser reads them so (insta360/rig.rs). The
strings of an X5 are public (Insta360Develop/Desktop-CameraSDK-Cpp, issue 85): form 3 meets the radius that form 0
states at 100 degrees to 0.2 %, and form 2, another model, to 0.4 % from 20 degrees on. The exact relative pose of the
lenses is not used, only the rolls. Form 2 needs a table by the kind of lens, form 6 adds terms that no
second source describes.
"""

from dataclasses import dataclass
from pathlib import Path
from typing import BinaryIO

import numpy as np

from tiegraph.scan.recording import Readings
from tiegraph.scan.recording.tracks import BrokenTrack
from tiegraph.scene.atomic import regular

_OLD, _SPHERE = 0, 3
_A_LENS = {_OLD: 6, _SPHERE: 19}  # numbers
_BEHIND = {_OLD: 4, _SPHERE: 2}  # the number of lenses before, and the numbers after the lenses
_LENSES = 2
_FITTED = np.radians(np.arange(1.0, 88.5))  # COLMAP's fisheyes end at 90 degrees
_LETTERS = b"8db42d694ccc418790edff439fe026bf"
_FOOT, _HEAD = 72, 6
_INDEX, _GPS, _BINARY = 0, 7, 0
_MOST_RECORDS = 1000
_ROW = np.dtype(
    [("s", "<u8"), ("ms", "<u2"), ("state", "S1"), ("lat", "<f8"), ("ns", "S1"), ("lon", "<f8"), ("ew", "S1"),
     ("speed", "<f8"), ("course", "<f8"), ("height", "<f8")]
)  # fmt: skip
_ENTRY = np.dtype([("kind", "u1"), ("format", "u1"), ("size", "<u4"), ("offset", "<u4")])
_Places = dict[int, tuple[int, int]]  # first byte and length of a record by its kind


def read_trailer(video: Path) -> Readings | None:
    """The receiver's readings, their stamps NaN; None for a file without such a trailer or record.

    Raises BrokenTrack, and OSError for a file that cannot be read.
    """
    with regular(video, None).open("rb") as file:
        end = file.seek(0, 2)
        if end < _FOOT:
            return None
        file.seek(end - _FOOT)
        foot = file.read(_FOOT)
        if not foot.endswith(_LETTERS):
            return None
        length = int.from_bytes(foot[32:36], "little")
        if not _FOOT <= length <= end:
            raise BrokenTrack(f"its stated length is {length} bytes, but the file has {end}")
        begin, size = _records(file, end - length, end).get(_GPS, (0, 0))
        if not size:
            return None
        file.seek(begin)
        rows = np.frombuffer(file.read(size - size % _ROW.itemsize), _ROW)
    return _readings(rows)


def _records(file: BinaryIO, begin: int, end: int) -> _Places:
    """Records between two places of a file: by the index, or one by one from the end until a gap."""
    walked = _walk(file, begin, end)
    if _INDEX not in walked:
        return walked
    file.seek(walked[_INDEX][0])
    data = file.read(walked[_INDEX][1])
    found = dict(walked)
    for entry in np.frombuffer(data[: len(data) - len(data) % _ENTRY.itemsize], _ENTRY)[:_MOST_RECORDS]:
        kind, form, size, offset = (int(v) for v in entry)
        if form != _BINARY or not size:
            continue
        if begin + offset + size > end - _FOOT:
            raise BrokenTrack(f"its index lists record {kind} with {size} bytes at {offset}, which is outside of it")
        found[kind] = begin + offset, size
    return found


def _walk(file: BinaryIO, begin: int, end: int) -> _Places:
    found: _Places = {}
    at = end - _FOOT
    for _ in range(_MOST_RECORDS):
        if at - _HEAD < begin:
            break
        file.seek(at - _HEAD)
        form, kind, *size = file.read(_HEAD)
        length = int.from_bytes(bytes(size), "little")
        at -= _HEAD + length
        if at < begin:
            if not found:
                raise BrokenTrack(f"its last record, {kind}, announces {length} bytes, more than there are")
            break
        if form == _BINARY:
            found.setdefault(kind, (at, length))
    return found


def _readings(rows: np.ndarray) -> Readings:
    signs = [{b"N": 1.0, b"S": -1.0}, {b"E": 1.0, b"W": -1.0, b"O": -1.0}]
    lat, lon = (
        np.abs(rows[angle]) * np.array([sign.get(word, np.nan) for word in rows[letter].tolist()])
        for angle, letter, sign in (("lat", "ns", signs[0]), ("lon", "ew", signs[1]))
    )
    nothing = np.full(len(rows), np.nan)
    return Readings(
        stamp_s=nothing,
        time_s=rows["s"].astype(float) + rows["ms"] / 1000,
        lat_lon_height=np.stack([lat, lon, rows["height"].astype(float)], axis=1).reshape(-1, 3),
        fix=np.where(rows["state"] == b"A", 3.0, 0.0),
        dop=nothing,
    )


@dataclass(frozen=True)
class FactoryLens:
    """A lens: its centre and the size of the picture it was measured in, both lenses' (px), its roll (deg); and if
    the string has them, the parameters of the sphere: xi, f (px), k1, k2, k3."""

    centre_px: tuple[float, float]
    size: tuple[float, float]
    roll_deg: float
    sphere: tuple[float, ...] = ()

    def radius_px(self, angle: np.ndarray) -> np.ndarray:
        """Radial distance in the image of points at angles off the axis, radians. Mei 2007, equation 12;
        tangential distortion, a few pixels of 2700, is omitted."""
        xi, focal, k1, k2, k3 = self.sphere
        r = np.sin(angle) / (np.cos(angle) + xi)
        return np.asarray(focal * r * (1 + r**2 * (k1 + r**2 * (k2 + r**2 * k3))))

    def opencv_fisheye(self, number: int, width: int) -> tuple[float, ...]:
        """Parameters of OPENCV_FISHEYE for the half of that number (0, 1) of a picture, ``width`` px a half: the
        least-squares polynomial up to 88 degrees. () if the numbers are impossible for a lens."""
        scale = _LENSES * width / self.size[0]
        radius = scale * self.radius_px(_FITTED)
        if not np.isfinite(radius).all() or not radius.any():
            return ()
        terms = np.stack([_FITTED**n for n in (1, 3, 5, 7, 9)], axis=1)
        focal, *bent = np.linalg.lstsq(terms, radius, rcond=None)[0]
        x, y = scale * self.centre_px[0] - number * width, scale * self.centre_px[1]
        return tuple(float(v) for v in (focal, focal, x, y, *(b / focal for b in bent)))


def factory_lenses(text: str) -> tuple[FactoryLens, FactoryLens] | None:
    """The two lenses by the newest readable string (separated by blanks); None if none is readable."""
    found = [pair for word in text.split() if (pair := _read(word)) is not None]
    return max(found, key=lambda pair: len(pair[0].sphere), default=None)


def _read(word: str) -> tuple[FactoryLens, FactoryLens] | None:
    numbers = [float(v) for v in word.split("_")]
    if not np.isfinite(numbers).all():
        return None
    form = int(numbers[-1]) >> 16
    count = _A_LENS.get(form, 0)
    if not count or numbers[0] != _LENSES or len(numbers) != _LENSES * count + _BEHIND[form]:
        return None
    size = numbers[-3], numbers[-2]  # of the old form; in the other, each lens has its own
    one, other = (_lens(numbers[1 + k * count : 1 + (k + 1) * count], size) for k in range(_LENSES))
    return (one, other) if one.size == other.size and one.size[0] == _LENSES * one.size[1] > 0 else None


def _lens(n: list[float], size: tuple[float, float]) -> FactoryLens:
    if len(n) == _A_LENS[_OLD]:
        return FactoryLens((n[1], n[2]), size, n[5])
    return FactoryLens((n[3], n[4]), (n[16], n[17]), n[7], sphere=(n[0], (n[1] + n[2]) / 2, *n[11:14]))
