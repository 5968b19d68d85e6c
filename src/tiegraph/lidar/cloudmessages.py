"""Scans of a ROS bag: sensor_msgs/PointCloud2."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from tiegraph.errors import InputError
from tiegraph.lidar.formats import Points, points_of
from tiegraph.scene.bags.bag import open_bag, stamp_ns
from tiegraph.scene.bags.topics import split_topics

KINDS = ("sensor_msgs/PointCloud2",)
_TYPES = ("i1", "u1", "i2", "u2", "i4", "u4", "f4", "f8")  # by PointField.datatype, from 1


def bag_scans(path: Path) -> Iterator[tuple[float, Points]]:
    """Stamp (s) and points of each message of a bag's only topic of such, or of the one behind the path.

    Raises InputError for several topics, none, a damaged bag, and messages that hold less than they say.
    """
    bag_path, asked = split_topics(path)
    with open_bag(bag_path) as bag:
        topic = bag.only(KINDS, asked)
        for number, (message, received_ns) in enumerate(bag.messages(topic), start=1):
            name = f"{bag_path}: message {number} of {topic.name}"
            yield stamp_ns(message.header, received_ns) * 1e-9, message_points(message, name)


def message_points(message: Any, name: str) -> Points:
    """The points of a PointCloud2. Raises InputError for one whose data are shorter than it says."""
    order = ">" if message.is_bigendian else "<"
    fields = [f for f in message.fields if 1 <= f.datatype <= len(_TYPES) and f.count <= 1]
    dtype = np.dtype(
        {
            "names": [f.name for f in fields],
            "formats": [order + _TYPES[f.datatype - 1] for f in fields],
            "offsets": [f.offset for f in fields],
            "itemsize": message.point_step,
        }
    )
    data = np.asarray(message.data, np.uint8)
    if len(data) < message.height * message.row_step or message.width * message.point_step > message.row_step:
        raise InputError(
            f"{name}: {len(data)} bytes for {message.height} rows of {message.width} points: it is cut short"
        )
    rows = data[: message.height * message.row_step].reshape(message.height, message.row_step)
    rows = np.ascontiguousarray(rows[:, : message.width * message.point_step])
    table = rows.reshape(-1).view(dtype)
    return points_of({n: table[n] for n in table.dtype.names or ()}, name)
