"""Trajectories of visual odometry, SLAM or an INS: which file is of which pass, reading and writing them."""

from collections.abc import Iterator, Sequence
from itertools import islice
from pathlib import Path
from typing import Any

import numpy as np

from tiegraph.errors import InputError
from tiegraph.geometry.transforms import angle_deg, quaternion_xyzw
from tiegraph.scan.folders import words
from tiegraph.scan.tuning import TrajectoryTuning
from tiegraph.scene.bags import Bag, Topic, is_bag, open_bag, split_topics, stamp_ns
from tiegraph.scene.namedposes import has_named_poses, read_named_poses
from tiegraph.scene.names import clean
from tiegraph.scene.posefile import PoseFile, checked_poses, read_poses
from tiegraph.scene.results import Trajectory
from tiegraph.text import composed

_PATH = "nav_msgs/Path"
KINDS = ("nav_msgs/Odometry", "geometry_msgs/PoseStamped", "geometry_msgs/PoseWithCovarianceStamped", _PATH)
_HEAD_LINES = 10
_SUFFIXES = ((".tum",), (".txt", ".kitti"), (".csv",))  # the first kind that a folder has


def read_trajectory(path: Path) -> Trajectory:
    """Poses of a file of TUM, KITTI (its times are NaN) or EuRoC, as ``scene.posefile.read_poses`` reads it, of a ROS
    bag, or those of the images of a COLMAP model or a transforms.json.

    Sorted by time; rows with the time of another row are left out. Raises InputError with the line number for a wrong
    number of columns, text, and values that are none or make no sense.
    """
    if has_named_poses(path):
        named = read_named_poses(path)
        unknown = np.full(len(named), np.nan)
        return Trajectory(unknown, np.array(list(named.values())), unknown, names=tuple(named))
    found = read_bag_poses(path) if is_bag(path) else read_poses(path)
    unknown = np.full(len(found.poses), np.nan)
    return Trajectory(
        found.time_s, found.poses, unknown, notes=found.notes, metric=not _says_free(path), period_s=found.period_s
    )


FREE_UNIT = "# unit: free (a single camera tells no scale)"
"""A line of a TUM file whose lengths are no metres."""


def _says_free(path: Path) -> bool:
    if is_bag(path):
        return False
    with path.open(errors="replace") as stream:
        return FREE_UNIT in (line.rstrip() for line in islice(stream, _HEAD_LINES))


def write_tum(path: Path, time_s: np.ndarray, world_from_rig: np.ndarray) -> None:
    """Write poses (T, 4, 4) as TUM; unknown poses are left out, unknown times become the row's number."""
    lines = ["# time_s x y z qx qy qz qw"]
    for k, (t, pose) in enumerate(zip(time_s, world_from_rig)):
        if np.isfinite(pose[:3]).all():
            values = [*pose[:3, 3], *quaternion_xyzw(pose[:3, :3])]
            lines.append(f"{t if np.isfinite(t) else k:.6f} " + " ".join(f"{v:.9f}" for v in values))
    Path(path).write_text("\n".join(lines) + "\n")


def trajectory_files(path: Path, sequences: Sequence[str]) -> dict[int, Path]:
    """Trajectory file of each pass: ``path`` is one file for all (key -1), or a folder with one a pass. A COLMAP model,
    a folder with a transforms.json and a ROS bag are one for all, too.

    In a folder the file's name contains the name of the pass: vo_up.tum, vo_down.tum. Raises InputError if the path is
    not there, or if no file of the folder fits a pass.
    """
    path = Path(path)
    if (path.exists() and not path.is_dir()) or is_bag(path) or has_named_poses(path):
        return {-1: path}
    if not path.exists():
        raise InputError(f"--trajectory {path}: no such file or folder")
    every = sorted(f for f in path.iterdir() if not f.name.startswith("."))
    kinds = ([f for f in every if f.suffix.lower() in kind] for kind in _SUFFIXES)
    files = next((found for found in kinds if found), [])
    if len(files) == 1:
        return {-1: files[0]}
    found = {k: f for k, name in enumerate(sequences) if (f := _for_pass(name, files)) is not None}
    if not found:
        there = ", ".join(f.name for f in files) or "none ends in .tum, .txt, .csv"
        inside = next((f for f in every if has_named_poses(f)), None)
        if inside is not None and not files:
            raise InputError(f"--trajectory {path}: no poses in it; {inside} has some: give that")
        raise InputError(
            f"--trajectory {path}: none of its files ({there}) "
            f"has the name of a pass in its own ({', '.join(sequences) or 'there is no pass'}), as in vo_up.tum"
        )
    return found


def _for_pass(name: str, files: Sequence[Path]) -> Path | None:
    slug = name.lower().replace("/", "_").replace(" ", "_")
    stems = [(f, composed(f.stem)) for f in files]
    if slug.isalpha():
        exact = [f for f, stem in stems if slug in words(stem)]
    else:
        exact = [f for f, stem in stems if f"_{stem.lower()}".endswith("_" + slug)]
    exact = exact or [f for f, stem in stems if slug in stem.lower().replace(" ", "_")]
    return exact[0] if len(exact) == 1 else None


def same_start(trajectories: Sequence[Trajectory], tuning: TrajectoryTuning) -> bool:
    """Whether trajectories all begin at the same pose: each then has a world of its own, as odometry starts at zero."""
    first = [t.world_from_rig[0] for t in trajectories]
    return all(
        np.linalg.norm(p[:3, 3] - first[0][:3, 3]) < tuning.same_start_m
        and angle_deg(p[:3, :3], first[0][:3, :3]) < tuning.same_start_deg
        for p in first[1:]
    )


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
