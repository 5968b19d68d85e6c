"""Frame after frame: corners are followed, the pose is that of known points, keyframes hold the map up; and the path
that comes out."""

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, replace

import numpy as np

from tiegraph.geometry import transforms
from tiegraph.odometry.cameras import FAR_BASELINES, Cameras, Images, Tracks, corners, followed, in_partners
from tiegraph.odometry.covariance import keyframe_covariances, resection_covariance
from tiegraph.odometry.recall import Read, Recall, Recalled, scale_to, thumbnails
from tiegraph.odometry.tuning import MapTuning, Tuning
from tiegraph.odometry.worldmap import Keyframe, WorldMap, adjust, errors_px, moved_share, relative_pose, resect, scaled

_LEAST_POINTS = 30  # with a place, from which a segment is begun
_LONG = 60  # iterations of Ceres where the start is not the pose that was found a moment ago


@dataclass(frozen=True)
class Posed:
    """A frame with a pose: number of the keyframe it hangs on, rig_from_keyframe (4, 4), the points it agrees with."""

    keyframe: int
    rig_from_keyframe: np.ndarray
    seen: Tracks


@dataclass(frozen=True)
class _Before:
    """The last frame that was followed: images, corners, pose (of a segment that has begun)."""

    images: Images
    tracks: Tracks
    pose: np.ndarray | None


class Odometry:
    """The odometry of one rig; ``add`` frames in their order, then ``finish``.

    ``read`` gives an image of an earlier frame again; ``masks``: camera -> (H, W), 0 where nothing is to be looked for
    (of the platform), or what ``mask`` of ``add`` says for a single frame.
    """

    def __init__(self, cameras: Cameras, read: Read, tuning: Tuning) -> None:
        self.cameras, self.world, self._tuning = cameras, WorldMap(cameras), tuning
        self.partners = cameras.partners()
        self.posed: dict[int, Posed] = {}
        self.segment = 0
        self.loops = 0
        self._recall = Recall(self.world, read, tuning.recall, tuning.pose)
        self._before: _Before | None = None
        self._waiting: list[tuple[int, Tracks]] = []  # frames of a segment that has not begun
        self._together = Tracks.none()  # what the cameras saw in the first of them
        self._velocity = np.eye(4)
        self._lost = 0
        self._first = 0  # the first keyframe of the segment

    @property
    def metric(self) -> bool:
        """Whether lengths are in metres: a single camera has no length."""
        return len(self.cameras) > 1

    def add(self, frame: int, images: Images, masks: Mapping[int, np.ndarray] | None = None) -> None:
        """The next frame. Nothing is raised for a frame that has no pose: it is not in ``posed``."""
        masks = masks or {}
        if self._before is None:
            self._begin(frame, images, masks)
        elif self._before.pose is None:
            self._continue_start(frame, images, masks)
        else:
            self._continue(frame, images, masks)

    def _begin(self, frame: int, images: Images, masks: Mapping[int, np.ndarray]) -> None:
        """Begin with this frame: at once if the cameras see enough together, else wait for the next ones."""
        tracks = self._filled(images, Tracks.none(), masks)
        self._waiting, self._together, self._velocity = [(frame, tracks)], tracks, np.eye(4)
        self._first = len(self.world.keyframes)
        self._before = _Before(images, tracks, None) if len(tracks) >= _LEAST_POINTS else None
        if self._before is None or not any(self.partners.values()):
            return
        seen = tracks.plus(self._in_partners(images, tracks, np.eye(4)))
        self._together = seen
        self.world.keyframes.append(self._keyframe(frame, np.eye(4), seen, images))
        self.world.triangulate([self._first], self._tuning.map.outlier_px)
        placed = self._placed(tracks)
        # A ring of cameras, which share the edges of their views only, is begun from two frames.
        if placed.sum() >= max(_LEAST_POINTS, 0.25 * len(tracks)):
            self._begun(images, tracks, np.eye(4))
            self._look_back(images, self._first)
        else:
            self.world.keyframes.pop()
            self.world.xyz[seen.point] = np.nan

    def _continue_start(self, frame: int, images: Images, masks: Mapping[int, np.ndarray]) -> None:
        """Follow the corners until the frame is far enough from the first to place them."""
        assert self._before is not None
        tuning, (first_frame, first) = self._tuning.map, self._waiting[0]
        tracks = self._followed(images, self._before.tracks, self._before.tracks.xy)
        if len(tracks) < max(0.2 * len(first), _LEAST_POINTS):
            self._begin(frame, images, masks)
            return
        self._waiting.append((frame, tracks))
        self._before = _Before(images, tracks, None)
        same = first.where(np.isin(first.point, tracks.point))
        if moved_share(self.cameras, same, tracks) < 0.04:
            return
        pose = relative_pose(self.cameras, same, tracks)
        if pose is None:
            return
        numbers = [self._first, self._first + 1]
        self.world.keyframes.append(self._keyframe(first_frame, np.eye(4), self._together, {}))
        if self.metric:
            self.world.triangulate(numbers[:1], tuning.outlier_px)
            pose = scaled(self.cameras, pose, tracks, self.world.xyz[tracks.point])
            self.world.xyz[self._together.point] = np.nan
        self.world.keyframes.append(self._keyframe(frame, pose, tracks, images))
        self.world.triangulate(numbers, tuning.outlier_px)
        held = numbers[:1] if self.metric else numbers
        adjust(self.world, numbers, held, tuning, tuning.loss_px, _LONG)
        if self._placed(tracks).sum() < _LEAST_POINTS:
            del self.world.keyframes[self._first :]
            self.world.xyz[first.point] = np.nan
            return
        for number, (waited, seen) in enumerate(self._waiting[:-1]):
            seen = seen.where(self._placed(seen))
            guess = _part(self.world.keyframes[-1].rig_from_world, number / max(len(self._waiting) - 1, 1))
            found = resect(self.cameras, seen.camera, seen.xy, self.world.xyz[seen.point], guess, self._tuning.pose)
            if found is not None:
                self._hang(waited, self._first, found.rig_from_world, seen.where(found.inlier))
        last = self.world.keyframes[-1].rig_from_world
        self._velocity = _part(last, 1 / max(len(self._waiting) - 1, 1))
        self._begun(images, tracks, last)
        self._fill(frame, images, masks)

    def _begun(self, images: Images, tracks: Tracks, pose: np.ndarray) -> None:
        last = len(self.world.keyframes) - 1
        for number in range(self._first, last + 1):
            at = self.world.keyframes[number]
            self._hang(at.frame, number, at.rig_from_world, at.seen)
        self._before, self._lost, self._waiting = _Before(images, tracks, pose), 0, []

    def _continue(self, frame: int, images: Images, masks: Mapping[int, np.ndarray]) -> None:
        assert self._before is not None and self._before.pose is not None
        guess = self._velocity @ self._before.pose
        tracks = self._followed(images, self._before.tracks, self._expected(self._before.tracks, guess))
        placed = tracks.where(self._placed(tracks))
        found = resect(self.cameras, placed.camera, placed.xy, self.world.xyz[placed.point], guess, self._tuning.pose)
        if found is None:
            self._recover(frame, images, masks)
            return
        off = np.zeros(len(tracks), bool)
        off[self._placed(tracks)] = ~found.inlier
        tracks, pose = tracks.where(~off), found.rig_from_world
        if not self._lost:
            self._velocity = pose @ transforms.invert(self._before.pose)
        self._lost, self._before = 0, _Before(images, tracks, pose)
        self._hang(frame, len(self.world.keyframes) - 1, pose, tracks.where(self._placed(tracks)))
        if self._needs_keyframe(tracks):
            self.world.keyframes.append(self._keyframe(frame, pose, tracks, images))
            self._fill(frame, images, masks)

    def _needs_keyframe(self, tracks: Tracks) -> bool:
        last = self.world.keyframes[-1].seen
        own = last.where(np.isin(last.camera, list(self.partners)))
        own = own.where(self._placed(own))
        both, mine, theirs = np.intersect1d(tracks.point, own.point, return_indices=True)
        if len(both) < 0.6 * len(np.unique(own.point)):
            return True
        return moved_share(self.cameras, own.where(theirs), tracks.where(mine)) > 0.06

    def _fill(self, frame: int, images: Images, masks: Mapping[int, np.ndarray]) -> None:
        """Give the last keyframe new corners and what the other cameras see of all, place them, adjust the window."""
        assert self._before is not None
        number = len(self.world.keyframes) - 1
        last = self.world.keyframes[number]
        tracks = self._filled(images, self._before.tracks, masks)
        seen = tracks.plus(self._in_partners(images, tracks, last.rig_from_world))
        self.world.keyframes[number] = replace(last, seen=seen)
        tuning = self._tuning.map
        window = list(range(max(self._first, number + 1 - 8), number + 1))
        self.world.triangulate(window, tuning.outlier_px)
        whole = len(window) == number + 1 - self._first and self.metric
        held = window[:1] if whole else window[:3]
        adjust(self.world, window, held, tuning, tuning.loss_px, iterations=8)
        pose = self.world.keyframes[number].rig_from_world
        placed = self._placed(tracks)
        off = errors_px(self.cameras, pose, tracks.camera, tracks.xy, self.world.xyz[tracks.point])
        bad = placed & (off > tuning.outlier_px)
        self._before = _Before(images, tracks.where(~bad), pose)
        self._hang(frame, number, pose, tracks.where(placed & ~bad))
        self._look_back(images, number)

    def _recover(self, frame: int, images: Images, masks: Mapping[int, np.ndarray]) -> None:
        """A frame that could not be followed: by what the last keyframes saw, else by any; else it is lost."""
        fresh = self._filled(images, Tracks.none(), masks)
        numbers = list(range(self._first, len(self.world.keyframes)))
        alike = self._recall.most_alike(thumbnails(images), numbers)
        recent = numbers[-2:][::-1]
        found = self._recall.find(images, fresh, [*recent, *(k for k in alike if k not in recent)])
        if found is None:
            self._lost += 1
            if self._lost >= self._tuning.recall.patience:
                self.segment = 1 + max(k.segment for k in self.world.keyframes)
                self._begin(frame, images, masks)
            return
        self._lost, self._velocity = 1, np.eye(4)
        self._before = _Before(images, found.seen, found.rig_from_world)
        self._hang(frame, len(self.world.keyframes) - 1, found.rig_from_world, found.seen)
        self.world.keyframes.append(self._keyframe(frame, found.rig_from_world, found.seen, images))
        self._fill(frame, images, masks)
        self._lost = 0

    def _look_back(self, images: Images, number: int) -> None:
        """Join the segment to an earlier one, or close a loop, if the keyframe shows a known place."""
        last = self.world.keyframes[number]
        here = last.segment
        others = [k for k, other in enumerate(self.world.keyframes) if other.segment != here]
        far = others or list(range(max(number - 19, 0)))  # nearer ones share points anyway
        candidates = self._recall.most_alike(last.thumbnails, far)
        if self._first - 1 in others:  # the place of the loss may be near
            candidates = list(dict.fromkeys([self._first - 1, *candidates]))
        own = last.seen.where(np.isin(last.seen.camera, list(self.partners)))
        found = self._recall.find(images, own, candidates)
        if found is None:
            return
        other = next(k for k in candidates if np.isin(self.world.keyframes[k].seen.point, found.seen.point).any())
        if self.world.keyframes[other].segment != here:
            if not self._join(number, found, self.world.keyframes[other].segment, own):
                return
        else:
            self.loops += 1
        last = self.world.keyframes[number]
        self.world.keyframes[number] = replace(last, seen=last.seen.plus(found.seen))

    def _join(self, number: int, found: Recalled, segment: int, own: Tracks) -> bool:
        """Bring the segment of a keyframe into the world of another; whether it can be."""
        last = self.world.keyframes[number]
        scale = 1.0 if self.metric else scale_to(found, self.world, own, last.rig_from_world)
        if not np.isfinite(scale):
            return False

        def stretched(pose: np.ndarray) -> np.ndarray:
            return transforms.rigid(pose[:3, :3], scale * pose[:3, 3])

        old_from_new = transforms.invert(found.rig_from_world) @ stretched(last.rig_from_world)
        mine = [k for k, frame in enumerate(self.world.keyframes) if frame.segment == last.segment]
        points = np.unique(self.world.observations(mine).point)
        self.world.xyz[points] = transforms.apply(old_from_new, scale * self.world.xyz[points])
        for k in mine:
            moved = stretched(self.world.keyframes[k].rig_from_world) @ transforms.invert(old_from_new)
            self.world.keyframes[k] = replace(self.world.keyframes[k], rig_from_world=moved, segment=segment)
        for frame, posed in self.posed.items():
            if posed.keyframe in set(mine):
                self.posed[frame] = replace(posed, rig_from_keyframe=stretched(posed.rig_from_keyframe))
        assert self._before is not None
        self._before = replace(self._before, pose=self.world.keyframes[number].rig_from_world)
        self._velocity = stretched(self._velocity)
        self.segment = segment
        self.loops += 1
        return True

    def finish(self) -> None:
        """Adjust all keyframes of worlds in which a loop was closed or segments were joined."""
        if not self.loops:
            return
        for segment in sorted({k.segment for k in self.world.keyframes}):
            numbers = [n for n, k in enumerate(self.world.keyframes) if k.segment == segment]
            held = numbers[: 1 if self.metric else 2]
            for loss in (30.0, 3.0, 1.0):  # a loop stands off by the drift at first
                adjust(self.world, numbers, held, self._tuning.map, loss, _LONG)

    def _placed(self, tracks: Tracks) -> np.ndarray:
        return np.asarray(~np.isnan(self.world.xyz[tracks.point, 0]))

    def _keyframe(self, frame: int, pose: np.ndarray, seen: Tracks, images: Images) -> Keyframe:
        thumbs = thumbnails(images)
        return Keyframe(frame=frame, segment=self.segment, rig_from_world=pose, seen=seen, thumbnails=thumbs)

    def _hang(self, frame: int, keyframe: int, pose: np.ndarray, seen: Tracks) -> None:
        step = pose @ transforms.invert(self.world.keyframes[keyframe].rig_from_world)
        self.posed[frame] = Posed(keyframe, step, seen)

    def _filled(self, images: Images, tracks: Tracks, masks: Mapping[int, np.ndarray]) -> Tracks:
        for camera in (c for c in self.partners if c in images):
            taken = tracks.xy[tracks.camera == camera]
            xy = corners(images[camera], masks.get(camera), taken)
            tracks = tracks.plus(Tracks(self.world.new_points(len(xy)), np.full(len(xy), camera), xy))
        return tracks

    def _followed(self, images: Images, tracks: Tracks, guess: np.ndarray) -> Tracks:
        assert self._before is not None
        keep, xy = np.zeros(len(tracks), bool), tracks.xy.copy()
        for camera in (c for c in self.partners if c in images and c in self._before.images):
            at = np.flatnonzero(tracks.camera == camera)
            place, found = followed(self._before.images[camera], images[camera], tracks.xy[at], guess[at])
            xy[at], keep[at] = place, found
        return Tracks(tracks.point, tracks.camera, xy).where(keep)

    def _expected(self, tracks: Tracks, pose: np.ndarray) -> np.ndarray:
        """(K, 2) where corners will be in a frame of a predicted pose."""
        assert self._before is not None and self._before.pose is not None
        guess = self.cameras.project(tracks.camera, transforms.apply(pose, self._about(tracks, self._before.pose)))
        away = np.any(np.isnan(guess), axis=1)
        for camera in np.unique(tracks.camera).tolist():
            at = tracks.camera == camera
            away[at] |= ~self.cameras.inside(camera, guess[at])
        return np.where(away[:, None], tracks.xy, guess)

    def _about(self, tracks: Tracks, pose: np.ndarray) -> np.ndarray:
        """(K, 3) where corners are in the world; those without a place at the median distance of their camera's."""
        out = self.world.xyz[tracks.point].copy()
        world_from_rig = transforms.invert(pose)
        rays = self.cameras.rays(tracks.camera, tracks.xy) @ world_from_rig[:3, :3].T
        centres = transforms.apply(world_from_rig, self.cameras.rig_from_sensor[:, :3, 3])[tracks.camera]
        distance = np.linalg.norm(out - centres, axis=1)
        baseline = np.linalg.norm(self.cameras.rig_from_sensor[:, :3, 3], axis=1).max()
        usual = float(max(FAR_BASELINES * baseline, 1.0))  # where the cameras of the rig see about the same, m
        for camera in np.unique(tracks.camera).tolist():
            at = tracks.camera == camera
            known = distance[at & ~np.isnan(distance)]
            far = float(np.median(known)) if len(known) else usual
            missing = at & np.isnan(distance)
            out[missing] = centres[missing] + far * rays[missing]
        return out

    def _in_partners(self, images: Images, tracks: Tracks, pose: np.ndarray) -> Tracks:
        in_rig = transforms.apply(pose, self._about(tracks, pose))
        return in_partners(self.cameras, self.partners, images, tracks, in_rig)


def _part(motion: np.ndarray, share: float) -> np.ndarray:
    """A share of a motion (4, 4)."""
    return transforms.interpolate(np.array([0.0, 1.0]), np.stack([np.eye(4), motion]), np.array([share]))[0]


@dataclass(frozen=True)
class OdometryPath:
    """F frames in their order: world_from_rig (F, 4, 4), NaN = no pose; segment (F,), -1 = none, else 0, 1, ... in
    order of their first frames, each in a world of its own; keyframe (F,) bool; covariance (F, 6, 6) of position (units
    of the path) and turn (rad), both along the axes of the world, zero of the first; ``metric``: lengths are metres.

    ``loops``: known places that were seen again and tied (loops, joined segments).
    """

    world_from_rig: np.ndarray
    segment: np.ndarray
    keyframe: np.ndarray
    covariance: np.ndarray
    metric: bool
    loops: int

    def main(self) -> int:
        """The segment with the most frames; -1 if there is none."""
        there = self.segment[self.segment >= 0]
        return int(np.argmax(np.bincount(there))) if len(there) else -1

    def sigmas(self) -> tuple[np.ndarray, np.ndarray]:
        """Of the position (F, 3), units of the path, and of the turn (F, 3), degrees; NaN = no pose."""
        sigma = np.sqrt(np.einsum("kii->ki", self.covariance))
        return sigma[:, :3], np.degrees(sigma[:, 3:])


def path_of(odometry: Odometry, frames: Sequence[int], tuning: MapTuning) -> OdometryPath:
    """The path of frames that were added to an odometry, which is finished."""
    world, count = odometry.world, len(frames)
    poses, covariance = np.full((count, 4, 4), np.nan), np.full((count, 6, 6), np.nan)
    segment, keyframe = np.full(count, -1), np.zeros(count, bool)
    of_keyframe = np.full((len(world.keyframes), 6, 6), np.nan)
    for number in {k.segment for k in world.keyframes}:
        own = [n for n, k in enumerate(world.keyframes) if k.segment == number]
        of_keyframe[own] = keyframe_covariances(world, own, tuning.loss_px, odometry.metric)
    for row, frame in enumerate(frames):
        posed = odometry.posed.get(frame)
        if posed is None:
            continue
        at = world.keyframes[posed.keyframe]
        pose = posed.rig_from_keyframe @ at.rig_from_world
        poses[row], segment[row], keyframe[row] = transforms.invert(pose), at.segment, at.frame == frame
        step = np.eye(6)  # the frame hangs on its keyframe rigidly: a turn of the one moves the other
        step[:3, 3:] = -transforms.skew(transforms.centre(pose) - transforms.centre(at.rig_from_world))
        carried = step @ of_keyframe[posed.keyframe] @ step.T
        if at.frame != frame:
            seen = posed.seen.where(~np.isnan(world.xyz[posed.seen.point, 0]))
            carried = carried + resection_covariance(world.cameras, pose, seen, world.xyz[seen.point], tuning.loss_px)
        covariance[row] = tuning.shared**2 * carried
    order = {old: new for new, old in enumerate(dict.fromkeys(segment[segment >= 0].tolist()))}
    named = np.array([order.get(s, -1) for s in segment.tolist()], int)
    return OdometryPath(
        world_from_rig=poses, segment=named, keyframe=keyframe, covariance=covariance,
        metric=odometry.metric, loops=odometry.loops,
    )  # fmt: skip
