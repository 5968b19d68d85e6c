"""Poses of a bag: odometry, poses with stamps, and paths. Quaternions are read by the names of their components."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import numpy as np

from tiegraph.scene.bags.bag import Bag, Topic, open_bag, stamp_ns
from tiegraph.scene.bags.topics import split_topics
from tiegraph.scene.names import clean
from tiegraph.scene.posefile import PoseFile, checked_poses

_PATH = "nav_msgs/Path"
KINDS = ("nav_msgs/Odometry", "geometry_msgs/PoseStamped", "geometry_msgs/PoseWithCovarianceStamped", _PATH)


def read_bag_poses(path: Path) -> PoseFile:
    """The poses of a bag's only topic of such, or of the one behind the path (``topics.split_topics``).

    A path that is sent again and again is read as it was last. Raises InputError for several topics, none, a damaged
    bag, and what ``posefile.read_poses`` raises of values; its lines are the numbers of the messages.
    """
    bag_path, asked = split_topics(path)
    with open_bag(bag_path) as bag:
        topic = bag.only(KINDS, asked)
        rows, frames = [], set()
        for pose, stamp, frame in _poses(bag, topic):
            p, q = pose.position, pose.orientation
            rows.append((stamp, p.x, p.y, p.z, q.x, q.y, q.z, q.w))
            frames.add(frame)
    said = f"{bag_path.name}: poses of {topic}: {' and '.join(sorted(frames)[:2])}"
    table = np.array([[float(v) for v in row] for row in rows]).reshape(-1, 8)
    found = checked_poses(bag_path, table[:, 0] * 1e-9, table[:, 1:4], table[:, 4:])
    return PoseFile(found.time_s, found.poses, (said, *found.notes))


def _poses(bag: Bag, topic: Topic) -> Iterator[tuple[Any, int, str]]:
    """Pose, stamp (ns) and frames of reference."""
    last = None
    for message, received_ns in bag.messages(topic):
        if topic.kind == _PATH:
            last = message, received_ns
            continue
        pose = message.pose if hasattr(message.pose, "position") else message.pose.pose
        child = getattr(message, "child_frame_id", "") or "the body"
        yield pose, stamp_ns(message.header, received_ns), clean(f"{child} in {message.header.frame_id!r}")
    if last is not None:
        message, received_ns = last
        for pose in message.poses:
            yield pose.pose, stamp_ns(pose.header, received_ns), clean(f"the body in {message.header.frame_id!r}")
