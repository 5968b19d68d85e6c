"""Trajectories of visual odometry, SLAM or an INS, and poses of images by their names, as poses of the frames' rigs."""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import replace
from itertools import combinations, islice
from pathlib import Path
from typing import Any

import numpy as np

from tiegraph.errors import InputError
from tiegraph.geometry.transforms import angle_deg, centre, rigid
from tiegraph.scan.folders import words
from tiegraph.scan.priors.positions import Frames
from tiegraph.scan.priors.times import absent
from tiegraph.scene.bags import Bag, Topic, is_bag, open_bag, split_topics, stamp_ns
from tiegraph.scene.namedposes import called, has_named_poses, read_named_poses
from tiegraph.scene.names import all_found, clean
from tiegraph.scene.posefile import FREE_UNIT, Trajectory, checked_poses, read_poses
from tiegraph.text import composed

_PATH = "nav_msgs/Path"
KINDS = ("nav_msgs/Odometry", "geometry_msgs/PoseStamped", "geometry_msgs/PoseWithCovarianceStamped", _PATH)
_SAME_M, _SAME_DEG = 1e-3, 0.1  # poses within these are equal
_SUFFIXES = ((".tum",), (".txt", ".kitti"), (".csv",))  # the first kind that a folder has


def read_trajectory(path: Path) -> Trajectory:
    """Poses of a file of TUM, KITTI (its times are NaN) or EuRoC, as ``scene.posefile.read_poses`` reads it, of a ROS
    bag, or those of the images of a COLMAP model or a transforms.json.

    Sorted by time; rows with the time of another row are left out. Raises InputError with the line number for a wrong
    number of columns, text, and impossible values.
    """
    if has_named_poses(path):
        return of_images(read_named_poses(path))
    if is_bag(path):
        return read_bag_poses(path)
    found = read_poses(path)
    with path.open(errors="replace") as stream:
        free = FREE_UNIT in (line.rstrip() for line in islice(stream, 10))
    return replace(found, metric=not free)


def of_images(poses: Mapping[str, np.ndarray]) -> Trajectory:
    """Poses (4, 4) by image name as a trajectory without times."""
    return Trajectory(np.full(len(poses), np.nan), np.array(list(poses.values())), names=tuple(poses))


def trajectory_files(path: Path, sequences: Sequence[str]) -> dict[int, Path]:
    """Trajectory file of each pass: ``path`` is one file for all (key -1), or a folder with one a pass. A COLMAP model,
    a folder with a transforms.json and a ROS bag are one for all, too.

    In a folder the file's name contains the name of the pass: vo_up.tum, vo_down.tum. Raises InputError if the path
    does not exist, or if no file of the folder fits a pass.
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
            raise InputError(f"--trajectory {path}: no poses in it; {inside} has some: give that path")
        raise InputError(
            f"--trajectory {path}: none of its files ({there}) "
            f"contains the name of a pass ({', '.join(sequences) or 'there is no pass'}), as in vo_up.tum"
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


def same_start(trajectories: Sequence[Trajectory]) -> bool:
    """Whether all trajectories begin at the same pose: each then has its own world, as odometry starts at zero."""
    first = [t.poses[0] for t in trajectories]
    return all(
        np.linalg.norm(p[:3, 3] - first[0][:3, 3]) < _SAME_M and angle_deg(p[:3, :3], first[0][:3, :3]) < _SAME_DEG
        for p in first[1:]
    )


def read_bag_poses(path: Path) -> Trajectory:
    """The poses of a bag's only topic of poses, or of the topic behind the path (``bags.split_topics``).

    Of a path that is sent repeatedly the last message is read. Raises InputError for several topics, none, a damaged
    bag, and wrong values as ``posefile.read_poses`` does; its lines are the numbers of the messages.
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
    return replace(found, notes=(said, *found.notes))


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


def poses_by_image(
    trajectory: Trajectory, path: Path, frames: Frames, notes: list[str], metric: bool = True
) -> np.ndarray:
    """world_from_rig (F, 4, 4) of the frames by the poses of their images; NaN where none has one.

    Of several images of a frame the rig's reference camera counts, else the first with a known pose in the rig. A
    world that is not ``metric`` is scaled to the baselines of the rigs, if there are frames with several images. Poses
    that are not used are in the notes. Raises InputError if no name is that of an image here, or one is ambiguous.
    """
    found = images_by_name(trajectory.names, path, frames.names)
    pose_of = {k: trajectory.poses[row] for k, row in found.items()}
    strange = sorted(set(range(len(trajectory))) - set(found.values()))
    if strange:
        name = trajectory.names[strange[0]]
        count, why = f"{len(strange)} of {len(trajectory)} poses", absent(name, frames.names)
        notes.append(f"{called(path)}: {count} are of images that are not here, such as {name}; {why}")
    if not metric:
        unit = _metres_per_unit(pose_of, frames)
        if unit is not None:
            pose_of = {k: rigid(p[:3, :3], unit * p[:3, 3]) for k, p in pose_of.items()}
            notes.append(f"{called(path)}: its unit is {unit:.4g} m by the distances between the rig's cameras")
    out = np.full((len(frames.rows), 4, 4), np.nan)
    for k, row in enumerate(frames.rows):
        for image in sorted(row.images, key=lambda i: frames.sensors[i]):
            on_rig = _on_rig(frames, k, image)
            if image in pose_of and on_rig is not None:
                out[k] = pose_of[image] @ on_rig
                break
    missing = int(np.isnan(out[:, 0, 0]).sum())
    lacking = f"; {missing} of {len(out)} frames have none" if missing else ""
    notes.append(f"{called(path)}: the trajectory is read as poses of {len(pose_of)} images by their names{lacking}")
    return out


def _on_rig(frames: Frames, frame: int, image: int) -> np.ndarray | None:
    """sensor_from_rig (4, 4) of an image of a frame, None = unknown."""
    sensor = frames.sensors[image]
    return np.eye(4) if sensor == 0 else frames.rigs[frames.rows[frame].rig].sensors[sensor].sensor_from_rig


def _metres_per_unit(pose_of: dict[int, np.ndarray], frames: Frames) -> float | None:
    """Length of a world's unit by the rigs' baselines between images of one frame; None with fewer than three."""
    ratios = []
    for k, row in enumerate(frames.rows):
        known = [(i, on_rig) for i in row.images if i in pose_of and (on_rig := _on_rig(frames, k, i)) is not None]
        for (a, of_a), (b, of_b) in combinations(known, 2):
            apart = float(np.linalg.norm(pose_of[a][:3, 3] - pose_of[b][:3, 3]))
            baseline = float(np.linalg.norm(centre(of_a) - centre(of_b)))
            if apart > 0 and baseline > 0:
                ratios.append(baseline / apart)
    return float(np.median(ratios)) if len(ratios) >= 3 else None


def images_by_name(given: Sequence[str], path: Path, names: Sequence[str]) -> dict[int, int]:
    """Row of ``given`` for each image of ``names`` that it names, as in ``names.all_found``.

    Raises InputError, naming them, if two can be of one image, and if none is here.
    """
    found: dict[int, int] = {}
    for row, image in enumerate(all_found(given, ((name, k) for k, name in enumerate(names)))):
        other = row if image is None else found.setdefault(image, row)
        if given[other] != given[row]:
            raise InputError(
                f"{path}: {given[other]} and {given[row]} can both be {names[image or 0]}: give the folder above as "
                "that of the images, so that folders distinguish them"
            )
    if not found:
        raise InputError(f"{path}: none of its {len(given)} images is here: {given[0]} ...; {absent(given[0], names)}")
    return found
