"""Image topics of ROS bags, each a camera: distinguished, and read like videos, picture by picture with stamps.

ROS has a convention but no rule: the topics below one name are of one camera (/left/image_raw, /left/image_rect,
/left/camera_info), and a topic compressed by ``image_transport`` has its source's name, /left/image_raw/compressed. So
the folder of the pictures has the name before ``image``: left.
"""

import re
from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tiegraph.errors import InputError
from tiegraph.scan.folders import is_camera
from tiegraph.scan.recording import RECORDED_RANGE_S, Recording
from tiegraph.scan.rigfiles.camerafile import check_lens
from tiegraph.scan.rigfiles.cameraread import FoundCamera, opencv
from tiegraph.scan.videos.videotime import VideoClock
from tiegraph.scene.bags import METADATA, SUFFIXES, Bag, Topic, in_full, is_bag, of_topic, open_bag, shown, stamp_ns
from tiegraph.scene.cells import date_text
from tiegraph.scene.gnss.solutions import KINDS as FIXES
from tiegraph.scene.images import files_below

KINDS = ("sensor_msgs/Image", "sensor_msgs/CompressedImage")
# Encoding (sensor_msgs/image_encodings.hpp): bytes a pixel, and OpenCV's conversion to BGR.
_ENCODINGS: dict[str, tuple[int, int | None]] = {
    "mono8": (1, cv2.COLOR_GRAY2BGR),
    "8uc1": (1, cv2.COLOR_GRAY2BGR),
    "mono16": (2, cv2.COLOR_GRAY2BGR),
    "bgr8": (3, None),
    "8uc3": (3, None),
    "rgb8": (3, cv2.COLOR_RGB2BGR),
    "bgra8": (4, cv2.COLOR_BGRA2BGR),
    "rgba8": (4, cv2.COLOR_RGBA2BGR),
    "bayer_rggb8": (1, cv2.COLOR_BayerRGGB2BGR),
    "bayer_bggr8": (1, cv2.COLOR_BayerBGGR2BGR),
    "bayer_gbrg8": (1, cv2.COLOR_BayerGBRG2BGR),
    "bayer_grbg8": (1, cv2.COLOR_BayerGRBG2BGR),
    "uyvy": (2, cv2.COLOR_YUV2BGR_UYVY),
    "yuv422": (2, cv2.COLOR_YUV2BGR_UYVY),
    "yuyv": (2, cv2.COLOR_YUV2BGR_YUY2),
    "yuv422_yuy2": (2, cv2.COLOR_YUV2BGR_YUY2),
}
_INFO = "sensor_msgs/CameraInfo"
_COMPRESSED = "/compressed"
_RATE_FRAMES = 50  # messages of a topic, from its start, whose stamps give its rate
_IMAGE = re.compile(r"image(_\w+)?")


def find_bags(root: Path) -> list[Path]:
    """The bags below a folder, sorted; or ``root`` alone, if it is one."""
    if is_bag(root):
        return [root]
    if not root.is_dir():
        return []
    files = list(files_below(root))
    folders = {f.parent for f in files if f.name == METADATA and is_bag(f.parent)}
    return sorted(folders | {f for f in files if f.suffix.lower() in SUFFIXES and f.parent not in folders})


def bag_films(bag_path: Path, folder: str, asked: Sequence[str]) -> tuple[list[tuple[Recording, str]], list[str]]:
    """The image topics of a bag, each with the folder for its pictures below ``folder``, and notes.

    Without topics that are ``asked`` for, all are cameras except those of depths and repeated ones. Raises
    InputError for a damaged bag, one without images, and several topics of one camera.
    """
    with open_bag(bag_path) as bag:
        found = bag.of_kinds(KINDS, asked)
        names, notes = {t.name for t in found}, []
        cameras: dict[str, list[Topic]] = {}
        for topic in found:
            source = topic.name.removesuffix(_COMPRESSED)
            why = (
                f"as {source} is" if source != topic.name and source in names else unread(next(bag.messages(topic))[0])
            )
            if why:
                notes.append(f"{shown(bag_path, topic.name)}: left out: {why}")
            else:
                cameras.setdefault(_camera_name(topic.name), []).append(topic)
    if not cameras:
        raise InputError(f"{bag_path}: no topic with pictures: {'; '.join(notes)}")
    several = next((topics for topics in cameras.values() if len(topics) > 1), None)
    if several is not None:
        one = ",".join(topics[0].name for topics in cameras.values())
        raise InputError(
            f"{bag_path}: {' and '.join(map(str, several))} are of one camera by their names: name all topics that "
            f"are cameras behind the bag or the folder of the images, as in {of_topic(bag_path, one)}"
        )
    films = [(Recording(bag_path, topic=in_full(t.name)), f"{folder}/{c}") for c, (t,) in cameras.items()]
    return films, notes


def fixes_notes(bag_path: Path) -> list[str]:
    """Notes on the positions in a bag, if none were given. Raises as ``open_bag``."""
    with open_bag(bag_path) as bag:
        found = [t for t in bag.topics if t.kind in FIXES and t.count]
    return [f"{bag_path.name} has positions, {t}: --gnss {of_topic(bag_path, t.name)} uses them" for t in found]


def _source(topic: str) -> list[str]:
    """The parts of a topic's name without that of its compression."""
    return [p for p in topic.removesuffix(_COMPRESSED).split("/") if p]


def _camera_name(topic: str) -> str:
    """The name of a topic's camera: it contains a word that marks folders of cameras."""
    parts = _source(topic)
    name = re.sub(r"[^A-Za-z0-9]+", "_", "_".join(parts[:-1] if _IMAGE.fullmatch(parts[-1]) else parts)).strip("_")
    return name if is_camera(name) else f"cam_{name}" if name else "cam"


class BagFilm:
    """An opened image topic: its frames as those of an ``OpenVideo``, and their faults."""

    def __init__(self, bag: Bag, topic: Topic) -> None:
        self._bag, self._topic = bag, topic
        self.count = self.late = 0
        first, received_ns = next(bag.messages(topic))
        self._start_ns = stamp_ns(first.header, received_ns)
        self._received_ns, self._stamped = received_ns, self._start_ns != received_ns

    broken = "has no picture that can be decoded: record it again as sensor_msgs/Image, or as JPEG or PNG"

    @property
    def fps(self) -> float:
        """Frames a second, by the stamps of the first messages."""
        first = islice(self._bag.messages(self._topic), _RATE_FRAMES)
        steps = np.diff([stamp_ns(m.header, t) for m, t in first]) * 1e-9
        return float(1 / np.median(steps[steps > 0])) if (steps > 0).any() else 1.0

    def frames(self) -> Iterator[tuple[float, np.ndarray]]:
        """(stamp in s since the first message, BGR picture) in order; frames that are not later than the previous
        ones are left out."""
        last = -1.0
        for message, received_ns in self._bag.messages(self._topic):
            stamp = (stamp_ns(message.header, received_ns) - self._start_ns) * 1e-9
            picture = bgr(message)
            if picture is not None and stamp > last:
                self.count, last = self.count + 1, stamp
                yield stamp, picture
            elif picture is not None:
                self.late += 1

    def doubts(self) -> str:
        """Faults of the frames read, to follow other words; "" for none."""
        lost = self._topic.count - self.count - self.late
        said = f"; {lost} of its {self._topic.count} messages have no whole picture" if lost > 0 else ""
        return said + (f"; {self.late} have a stamp that is not later than the one before" if self.late else "")

    def clock(self, shift_s: float) -> VideoClock:
        """The clock of the headers, ``shift_s`` later: one for all topics of a bag."""
        start_s, name = self._start_ns * 1e-9, shown(self._bag.path, self._topic.name)
        low, high = RECORDED_RANGE_S
        dated = low <= start_s <= high
        when = f"{date_text(start_s)} UTC" if dated else f"{start_s:.3f} s"
        late = f"which was received {(self._received_ns - self._start_ns) * 1e-9:.3f} s later"
        by = f"the stamp of its first message, {late}" if self._stamped else "its receipt: its headers have no stamps"
        return VideoClock(
            start_s=start_s + shift_s, known=True, utc=dated, shared=True, note=f"{name}: begins at {when} by {by}"
        )

    def camera(self, size: tuple[int, int]) -> tuple[FoundCamera | None, str]:
        """The bag's calibration for images of a size (width, height), and a note."""
        parts = _source(self._topic.name)
        beside = {"/" + "/".join([*above, "camera_info"]) for above in (parts[:-1], parts)}
        info = next((t for t in self._bag.topics if t.kind == _INFO and t.count and t.name in beside), None)
        if info is None:
            return None, ""
        message, _ = next(self._bag.messages(info))
        where = shown(Path(self._bag.path.name), info.name)
        try:
            found = _camera(message, where, rectified=parts[-1].startswith("image_rect"))
            if found is not None and found.size is not None and found.size != size:
                raise InputError(f"{where}: of images of {found.size[0]} x {found.size[1]}, not {size[0]} x {size[1]}")
            if found is not None:
                check_lens(found)
        except InputError as error:
            return None, f"no calibration is taken from {error}"
        return found, "" if found else f"{where}: a camera that was not calibrated (K = 0): not used"


def _camera(info: Any, where: str, rectified: bool) -> FoundCamera | None:
    """The camera of a CameraInfo, read like ROS's YAML; None if it was not calibrated."""
    given = {key: [float(v) for v in getattr(info, key, getattr(info, key.upper(), ()))] for key in "kdp"}
    matrix = [*given["p"][0:3], *given["p"][4:7], *given["p"][8:11]] if rectified else given["k"]
    if not any(matrix[:1]):
        return None
    text = {
        "image_width": info.width,
        "image_height": info.height,
        "distortion_model": "plumb_bob" if rectified or not any(given["d"]) else info.distortion_model,
        "camera_matrix": f"{{data: {matrix}}}",
        "distortion_coefficients": f"{{data: {[] if rectified else given['d']}}}",
        "binning_x": info.binning_x,
        "binning_y": info.binning_y,
        "x_offset": info.roi.x_offset,
        "y_offset": info.roi.y_offset,
    }
    return opencv("\n".join(f"{key}: {value}" for key, value in text.items()), where)[0]


def unread(message: Any) -> str:
    """Why the pictures of a topic with such a message are not read; "" if they are."""
    if hasattr(message, "encoding"):
        known = message.encoding.lower() in _ENCODINGS
        return "" if known else f"encoding {message.encoding}, no picture of 8 bits (depths, perhaps)"
    return f"format {message.format}" if "compresseddepth" in message.format.lower() else ""


def bgr(message: Any) -> np.ndarray | None:
    """(H, W, 3) u1 of a message; None if it contains no picture, or too few bytes."""
    try:
        if not hasattr(message, "encoding"):
            return cv2.imdecode(message.data, cv2.IMREAD_COLOR | cv2.IMREAD_IGNORE_ORIENTATION)
        size, conversion = _ENCODINGS[message.encoding.lower()]
        rows = message.data[: message.height * message.step].reshape(message.height, message.step)
        pixels = rows[:, : size * message.width].reshape(message.height, message.width, size)
        if message.encoding.lower() == "mono16":  # like cv_bridge: of the whole range
            pixels = pixels[:, :, :1] if message.is_bigendian else pixels[:, :, 1:]
        return pixels if conversion is None else cv2.cvtColor(np.ascontiguousarray(pixels), conversion)
    except (KeyError, ValueError, cv2.error):
        return None
