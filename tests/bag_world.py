"""Small bags of ROS 1 and ROS 2, written by rosbags itself: for the tests of bags."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pytest

pytest.importorskip("rosbags")
from rosbags import rosbag1, rosbag2
from rosbags.rosbag2.enums import StoragePlugin
from rosbags.typesys import Stores, get_typestore

FORMS = ("ros1", "sqlite", "mcap")
START_S = 1714564800.0  # 2024-05-01 12:00:00 UTC
LATE_S = 0.25  # between a stamp and its receipt

Make = Callable[[str, dict[str, Any]], Any]  # a message of a kind with some fields


@dataclass(frozen=True)
class Row:
    """A message to be written; ``built`` makes it with the types of a release of ROS."""

    topic: str
    kind: str
    received_s: float
    built: Callable[[Make, Any], Any]


def bag(folder: Path, form: str, rows: Iterable[Row], name: str = "run", packed: tuple[Any, ...] = ()) -> Path:
    """Write messages in the order of their receipt; the path of the bag. ``packed``: what ``set_compression`` takes."""
    store = get_typestore(Stores.ROS1_NOETIC if form == "ros1" else Stores.ROS2_HUMBLE)
    folder.mkdir(parents=True, exist_ok=True)
    path = folder / (f"{name}.bag" if form == "ros1" else name)
    plugin = StoragePlugin.MCAP if form == "mcap" else StoragePlugin.SQLITE3
    writer: Any = rosbag1.Writer(path) if form == "ros1" else rosbag2.Writer(path, version=9, storage_plugin=plugin)

    def make(kind: str, fields: dict[str, Any]) -> Any:
        known = {n for n, _ in store.fielddefs[_full(kind)][1]}
        given = {n if n in known else n.upper(): v for n, v in fields.items()}  # K of ROS 1 is k of ROS 2
        return store.types[_full(kind)](**given)

    def header(stamp_s: float, frame: str) -> Any:
        nanoseconds = round(stamp_s * 1e9)
        stamp = make("builtin_interfaces/Time", {"sec": nanoseconds // 10**9, "nanosec": nanoseconds % 10**9})
        more = {"seq": 0} if form == "ros1" else {}
        return store.types["std_msgs/msg/Header"](stamp=stamp, frame_id=frame, **more)

    if packed:
        writer.set_compression(*packed)
    with writer:
        connections: dict[tuple[str, str], Any] = {}
        for row in sorted(rows, key=lambda r: r.received_s):
            key = row.topic, _full(row.kind)
            if key not in connections:
                connections[key] = writer.add_connection(*key, typestore=store)
            encode = store.serialize_ros1 if form == "ros1" else store.serialize_cdr
            data = encode(row.built(make, header), key[1])
            writer.write(connections[key], round(row.received_s * 1e9), data)
    return path


def _full(kind: str) -> str:
    return kind.replace("/", "/msg/")


def image(topic: str, stamp_s: float, pixels: np.ndarray, encoding: str = "bgr8", padding: int = 0, **more: Any) -> Row:
    """sensor_msgs/Image of (H, W[, C]) u1 or u2, each row followed by some bytes; ``received_s``, ``stamped``."""
    rows = np.ascontiguousarray(pixels).view(np.uint8).reshape(len(pixels), -1)
    rows = np.hstack([rows, np.full((len(rows), padding), 77, np.uint8)])
    fields = {
        "height": pixels.shape[0],
        "width": pixels.shape[1],
        "encoding": encoding,
        "is_bigendian": 0,
        "step": rows.shape[1],
        "data": rows.ravel(),
    }
    return _stamped(topic, "sensor_msgs/Image", stamp_s, fields, "camera", **more)


def compressed(topic: str, stamp_s: float, pixels: np.ndarray, ending: str = "png", form: str = "", **more: Any) -> Row:
    """sensor_msgs/CompressedImage of (H, W, 3) BGR."""
    data = cv2.imencode(f".{ending}", pixels)[1].ravel()
    fields = {"format": form or f"bgr8; {ending} compressed bgr8", "data": data}
    return _stamped(topic, "sensor_msgs/CompressedImage", stamp_s, fields, "camera", **more)


def _stamped(
    topic: str, kind: str, stamp_s: float, fields: dict[str, Any], frame: str, received_s: float | None = None,
    stamped: bool = True,
) -> Row:  # fmt: skip
    def built(make: Make, header: Any) -> Any:
        return make(kind, {"header": header(stamp_s if stamped else 0.0, frame), **fields})

    return Row(topic, kind, stamp_s + LATE_S if received_s is None else received_s, built)


def camera_info(
    topic: str, size: tuple[int, int], k: Sequence[float], d: Sequence[float] = (), model: str = "plumb_bob",
    p: Sequence[float] = (0.0,) * 12, binning: int = 0,
) -> Row:  # fmt: skip
    """sensor_msgs/CameraInfo with fx, fy, cx, cy as ``k``."""
    fx, fy, cx, cy = k
    fields = {
        "width": size[0],
        "height": size[1],
        "distortion_model": model,
        "d": np.array(d, float),
        "k": np.array([fx, 0, cx, 0, fy, cy, 0, 0, 1]),
        "r": np.eye(3).ravel(),
        "p": np.array(p, float),
        "binning_x": binning,
        "binning_y": binning,
    }

    def built(make: Make, header: Any) -> Any:
        zeros = {"x_offset": 0, "y_offset": 0, "height": 0, "width": 0, "do_rectify": False}
        roi = make("sensor_msgs/RegionOfInterest", zeros)
        return make("sensor_msgs/CameraInfo", {"header": header(START_S, "camera"), "roi": roi, **fields})

    return Row(topic, "sensor_msgs/CameraInfo", START_S, built)


def fix(topic: str, stamp_s: float, place: Sequence[float], sigma_m: Sequence[float] = (), status: int = 0) -> Row:
    """sensor_msgs/NavSatFix at latitude, longitude, height; without sigmas its covariance is not known."""
    covariance = np.diag(np.square(sigma_m)).ravel() if len(sigma_m) else np.zeros(9)

    def built(make: Make, header: Any) -> Any:
        fields = {
            "header": header(stamp_s, "gps"),
            "status": make("sensor_msgs/NavSatStatus", {"status": status, "service": 1}),
            **dict(zip(("latitude", "longitude", "altitude"), map(float, place))),
            "position_covariance": covariance,
            "position_covariance_type": 2 if len(sigma_m) else 0,
        }
        return make("sensor_msgs/NavSatFix", fields)

    return Row(topic, "sensor_msgs/NavSatFix", stamp_s + LATE_S, built)


def _pose(make: Make, place: Sequence[float], quaternion_xyzw: Sequence[float]) -> Any:
    position = make("geometry_msgs/Point", dict(zip("xyz", map(float, place))))
    turn = make("geometry_msgs/Quaternion", dict(zip("xyzw", map(float, quaternion_xyzw))))
    return make("geometry_msgs/Pose", {"position": position, "orientation": turn})


def pose(topic: str, stamp_s: float, place: Sequence[float], quaternion_xyzw: Sequence[float]) -> Row:
    """geometry_msgs/PoseStamped."""

    def built(make: Make, header: Any) -> Any:
        posed = {"header": header(stamp_s, "map"), "pose": _pose(make, place, quaternion_xyzw)}
        return make("geometry_msgs/PoseStamped", posed)

    return Row(topic, "geometry_msgs/PoseStamped", stamp_s + LATE_S, built)


def path(topic: str, received_s: float, poses: Sequence[tuple[float, Sequence[float], Sequence[float]]]) -> Row:
    """nav_msgs/Path of (stamp, place, quaternion)."""

    def built(make: Make, header: Any) -> Any:
        inside = [pose(topic, *row).built(make, header) for row in poses]
        return make("nav_msgs/Path", {"header": header(received_s, "map"), "poses": inside})

    return Row(topic, "nav_msgs/Path", received_s, built)


def odometry(topic: str, stamp_s: float, place: Sequence[float], quaternion_xyzw: Sequence[float]) -> Row:
    """nav_msgs/Odometry of base_link in odom, standing still."""

    def built(make: Make, header: Any) -> Any:
        zero = make("geometry_msgs/Vector3", {"x": 0.0, "y": 0.0, "z": 0.0})
        speed = make("geometry_msgs/Twist", {"linear": zero, "angular": zero})
        here = {"pose": _pose(make, place, quaternion_xyzw), "covariance": np.zeros(36)}
        return make(
            "nav_msgs/Odometry",
            {
                "header": header(stamp_s, "odom"),
                "child_frame_id": "base_link",
                "pose": make("geometry_msgs/PoseWithCovariance", here),
                "twist": make("geometry_msgs/TwistWithCovariance", {"twist": speed, "covariance": np.zeros(36)}),
            },
        )

    return Row(topic, "nav_msgs/Odometry", stamp_s + LATE_S, built)
