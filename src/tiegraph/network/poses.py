"""Source ``poses``: pairs from prior positions and orientations by distance, line of sight and baseline (paper 003).

Paper 003 tests the distance between cameras, the line of sight and the length of the base. Here the line of sight is
the shared visible surface (``visible``) of points at an assumed range, and a prior refuses only what it determines:
frames whose positions are less accurate than the test needs are not refused.
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
import pycolmap
from scipy.spatial import cKDTree

from tiegraph.network.axes import vertical
from tiegraph.network.coarse.proxy import assumed_proxy
from tiegraph.network.coarse.visible import Overlap, shared_surface
from tiegraph.network.passes import Pass, image_table
from tiegraph.network.settings import CandidatesSettings
from tiegraph.network.tuning import PosesTuning, Tuning, VisibleTuning
from tiegraph.scene.evidence import LIMIT
from tiegraph.scene.pairs import REASONS, Pairs, pair_key
from tiegraph.scene.scene import Scene

_UP = np.array([0.0, 0.0, 1.0])


@dataclass(frozen=True)
class PoseResult:
    """Pairs of the source, the frames that its poses compare, notes, and the assumed range."""

    pairs: Pairs
    world: np.ndarray  # (F,) i4: frames of one number were compared; -1 = no usable prior
    notes: tuple[str, ...]
    range_m: float = float("nan")
    apart: bool = False  # according to the images the poses of different passes are not in one world

    @property
    def without(self) -> np.ndarray:
        """(W,) frames without a usable prior."""
        return np.flatnonzero(self.world < 0)


@dataclass(frozen=True)
class Views:
    """Prior views of N images: their positions, axes, and accuracy.

    ``pose`` (N, 4, 4) world_from_sensor, rotation NaN = unknown; ``trusted`` (N,): rotation measured, not derived
    from the track; ``sigma_m`` (N,) of the position; ``path_m`` (N,) length of the trajectory up to there, NaN =
    none; ``world`` (N,): poses with the same number may be compared, -1 = no position.
    """

    pose: np.ndarray
    trusted: np.ndarray
    sigma_m: np.ndarray
    path_m: np.ndarray
    world: np.ndarray

    def centre(self) -> np.ndarray:
        """(N, 3) projection centres; those of the frame where the extrinsics are unknown."""
        return self.pose[:, :3, 3]

    def axis(self) -> np.ndarray:
        """(N, 3) optical axes, NaN = unknown."""
        return self.pose[:, :3, 2]


def pose_pairs(scene: Scene, passes: Sequence[Pass], settings: CandidatesSettings, tuning: Tuning) -> PoseResult:
    """Pairs of images by their prior poses; refused pairs carry the reason of the test.

    Distance (reason ``distance``), angle between optical axes (``axes``), too short a base of one camera
    (``baseline``), no shared surface (``sight``) or too little (``overlap``). The surface consists of points at an
    assumed range. Tests with unknown inputs are omitted.
    """
    with_prior = np.all(np.isfinite(scene.world_from_rig[:, :3, 3]), axis=1)
    world = scene.pose_world()
    if with_prior.sum() < 2:
        nowhere = np.full(scene.frames, -1)
        return PoseResult(Pairs.empty(), nowhere, ("poses: fewer than two frames have a prior position",))
    poses, headings = with_headings(scene, passes)
    reach = settings.range_m or assumed_range(scene, passes, tuning.poses)
    views = prior_views(scene, poses, headings, passes)
    found = predicted_overlap(scene, views, reach, settings, tuning)
    i, j = _image_pairs(scene, *_frame_pairs(scene, np.flatnonzero(with_prior), reach, tuning.poses))
    # Those of near frames, and all that share surface
    key = np.unique(np.r_[pair_key(np.minimum(i, j), np.maximum(i, j)), pair_key(found.i, found.j)])
    i, j = key >> 32, key & 0xFFFFFFFF
    code, share = _tests(scene, (i, j), views, found, reach, settings, tuning.poses)
    base = np.linalg.norm(views.centre()[i] - views.centre()[j], axis=1)
    pairs = Pairs.make(
        i, j, "poses", dropped=code, overlap=share, baseline_m=base, angle_deg=_angle(views.axis()[i], views.axis()[j])
    )
    return PoseResult(
        pairs=pairs, world=world, notes=_notes(scene, settings, reach, headings, ~with_prior), range_m=reach
    )


def _notes(
    scene: Scene, settings: CandidatesSettings, reach: float, headings: np.ndarray, without: np.ndarray
) -> tuple[str, ...]:
    notes = []
    if not settings.range_m:
        unit = "m" if scene.metric_positions() else "units"
        notes.append(
            f"poses: distance to the object taken as {reach:.2g} {unit} (ten times the distance between frames)"
        )
    if headings.any():
        notes.append(
            f"poses: the heading of {int(headings.sum())} frames is derived from their positions; only angles between "
            "axes are tested there, not lines of sight"
        )
    if without.any():
        notes.append(f"poses: {int(without.sum())} of {scene.frames} frames have no prior position")
    return tuple(notes)


def assumed_range(scene: Scene, passes: Sequence[Pass], tuning: PosesTuning) -> float:
    """A multiple of the distance between consecutive frames; for loose photographs, of the median distance to the
    nearest different position (a telephone writes one position into several photographs).

    The distance is the median weighted by length: a vehicle that stands most of the time has a median step that is
    unrelated to the distance of the surface (PandaSet, every fifth frame: 0.15 m; weighted 1.3 m).
    """
    position = scene.world_from_rig[:, :3, 3]
    steps = [np.linalg.norm(np.diff(position[p.frames], axis=0), axis=1) for p in passes if len(p) > 1]
    gaps = np.concatenate(steps) if steps else np.zeros(0)
    gaps = np.sort(gaps[np.isfinite(gaps) & (gaps > 0)])
    if len(gaps):
        way = np.cumsum(gaps)
        step = float(gaps[np.searchsorted(way, 0.5 * way[-1])])
    else:
        known = np.unique(position[np.isfinite(position).all(axis=1)], axis=0)
        step = float(np.median(np.asarray(cKDTree(known).query(known, k=2)[0])[:, 1])) if len(known) > 1 else 0.0
    return tuning.range_spacings * max(step, 1e-3)


def prior_views(scene: Scene, poses: np.ndarray, headings: np.ndarray, passes: Sequence[Pass]) -> Views:
    """Views of the images by ``poses`` (F, 4, 4) of the rig, of which ``headings`` (F,) are derived from the track."""
    pose = scene.with_(world_from_rig=poses).image_priors()
    known = np.isfinite(pose[:, :3]).all(axis=(1, 2))
    pose[~known, :3, :3] = np.nan
    pose[~known, :3, 3] = poses[scene.frame[~known], :3, 3]
    sigma = np.nan_to_num(scene.position_sigma_m).max(axis=1)
    path = _path(scene, poses, passes)
    if np.isfinite(scene.position_sigma_m).any():
        path = np.full(scene.frames, np.nan)  # the accuracy is given
    frame = scene.frame
    world = np.where(np.isfinite(poses[:, :3, 3]).all(axis=1), scene.pose_world(), -1)
    return Views(
        pose=pose, trusted=known & ~headings[frame], sigma_m=sigma[frame], path_m=path[frame], world=world[frame]
    )


def _path(scene: Scene, poses: np.ndarray, passes: Sequence[Pass]) -> np.ndarray:
    """(F,) length of the path up to each frame, pass after pass; NaN on no pass or without position."""
    out = np.full(scene.frames, np.nan)
    gone = 0.0
    for p in passes:
        frames = p.frames[np.isfinite(poses[p.frames][:, :3, 3]).all(axis=1)]
        if len(frames):
            steps = np.linalg.norm(np.diff(poses[frames][:, :3, 3], axis=0), axis=1)
            out[frames] = gone + np.concatenate([[0.0], np.cumsum(steps)])
            gone = out[frames[-1]]
    return out


def view_cameras(scene: Scene, tuning: VisibleTuning) -> list[pycolmap.Camera | None]:
    """The camera of each image with its largest possible field of view, so that a guessed focal length hides nothing.

    The cameras of a rig are mounted to overlap, so a guess is widened to ``shared_view`` of the angle to the next one.
    """
    made: list[pycolmap.Camera | None] = []
    for rig in scene.rigs:
        angles = rig.axis_angles_deg()
        angles = np.where(angles > 5.0, angles, np.nan)  # axes closer than that have the same direction
        for k, sensor in enumerate(rig.sensors):
            next_ = np.nanmin(angles[k]) if np.isfinite(angles[k]).any() else np.nan
            made.append(_wide_enough(sensor.camera, float(next_), tuning))
    return [made[k] for k in scene.sensor_key]


def _wide_enough(camera: pycolmap.Camera | None, next_deg: float, tuning: VisibleTuning) -> pycolmap.Camera | None:
    if camera is None or camera.has_prior_focal_length:
        return camera
    shared = min(1.25 * next_deg, 120.0) if np.isfinite(next_deg) else 0.0  # neighbours overlap by a quarter
    view = max(tuning.guessed_view_deg, shared)
    focal = camera.width / 2 / np.tan(np.radians(view) / 2)
    if camera.mean_focal_length() <= focal:
        return camera
    params = [focal, camera.width / 2, camera.height / 2]
    return pycolmap.Camera(model="SIMPLE_PINHOLE", width=camera.width, height=camera.height, params=params)


def predicted_overlap(
    scene: Scene, views: Views, reach: float, settings: CandidatesSettings, tuning: Tuning
) -> Overlap:
    """Shared surface of all images with trusted poses, world by world."""
    cameras = view_cameras(scene, tuning.coarse.visible)
    cam_from_world = np.full((len(scene), 4, 4), np.nan)
    cam_from_world[views.trusted] = np.linalg.inv(views.pose[views.trusted])
    slack = np.minimum(views.sigma_m / reach, 0.3)
    parts = []
    for world in np.unique(views.world[views.world >= 0]):
        own = np.where((views.world == world)[:, None, None], cam_from_world, np.nan)
        points = assumed_proxy(own, cameras, reach, tuning.coarse)
        parts.append(shared_surface(own, cameras, points, tuning.coarse.visible, settings.axes_deg, slack))
    return Overlap.together(parts)


def _frame_pairs(scene: Scene, frames: np.ndarray, reach: float, tuning: PosesTuning) -> tuple[np.ndarray, np.ndarray]:
    """Pairs of frames (K,), (K,), first <= second: each with itself and its nearest ones of the same world, within a
    multiple of the distance beyond which they share nothing."""
    position, world = scene.world_from_rig[frames, :3, 3], scene.pose_world()[frames]
    radius = 2.0 * (tuning.far_ranges * reach)
    out = [np.stack([frames, frames], axis=1)]
    for group in np.unique(world):
        member = np.flatnonzero(world == group)
        count = min(tuning.neighbours + 1, len(member))
        distance, near = cKDTree(position[member]).query(position[member], k=count)
        distance, near = np.reshape(distance, (len(member), -1)), np.reshape(near, (len(member), -1))
        a, b = np.nonzero(distance <= radius)
        out.append(np.stack([frames[member[a]], frames[member[near[a, b]]]], axis=1))
    pairs = np.unique(np.sort(np.concatenate(out), axis=1), axis=0)
    return pairs[:, 0], pairs[:, 1]


def _image_pairs(scene: Scene, first: np.ndarray, second: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Every image of one frame with every image of the other, i != j."""
    table = image_table(scene)
    most = table.shape[1]
    i = np.repeat(table[first], most, axis=1).ravel()
    j = np.tile(table[second], (1, most)).ravel()
    there = (i >= 0) & (j >= 0) & (i != j)
    return i[there], j[there]


def _angle(a: np.ndarray, b: np.ndarray) -> np.ndarray:
    return np.degrees(np.arccos(np.clip(np.einsum("ij,ij->i", a, b), -1, 1)))


def _tests(
    scene: Scene,
    pairs: tuple[np.ndarray, np.ndarray],
    views: Views,
    found: Overlap,
    reach: float,
    settings: CandidatesSettings,
    tuning: PosesTuning,
) -> tuple[np.ndarray, np.ndarray]:
    """Index into REASONS of each pair (K,) for the first test that refuses it, 0 = none; predicted overlap (K,)."""
    i, j = pairs
    base = np.linalg.norm(views.centre()[i] - views.centre()[j], axis=1)
    # (K,) standard deviation of the distance of image pairs, with the drift of the path between them
    drifted = tuning.drift * np.abs(views.path_m[i] - views.path_m[j])
    sigma = np.sqrt(views.sigma_m[i] ** 2 + views.sigma_m[j] ** 2 + np.nan_to_num(drifted) ** 2)
    noise = LIMIT * sigma
    axis = views.axis()
    # Without orientation only the number of neighbours limits the distance (as in COLMAP's spatial matching).
    oriented = np.isfinite(axis[i]).all(axis=1) & np.isfinite(axis[j]).all(axis=1)
    apart = scene.frame[i] != scene.frame[j]
    same_camera = (scene.sensor_key[i] == scene.sensor_key[j]) & apart
    both = views.trusted[i] & views.trusted[j]
    share = np.where(both, found.between(i, j), np.nan)
    sure = both & apart & (sigma < 0.25 * reach)  # less accurate frames are not refused by sight
    refused = {
        "distance": oriented & (base - noise > tuning.far_ranges * reach),
        "axes": _angle(axis[i], axis[j]) > settings.axes_deg,
        "baseline": same_camera & oriented & (base + noise < tuning.near_ranges * reach),
        "sight": sure & (share <= 0),
        "overlap": sure & (share < settings.min_overlap),
    }
    return np.select(list(refused.values()), [REASONS.index(r) for r in refused], 0), share


def with_headings(scene: Scene, passes: Sequence[Pass]) -> tuple[np.ndarray, np.ndarray]:
    """Poses (F, 4, 4) with unknown rotations of passes filled by the direction of travel, and where (F,) bool.

    Reference camera forward, rig upright: if it is mounted differently, the error is a constant rotation about the
    vertical, which does not affect angles between axes.
    """
    poses = scene.world_from_rig.copy()
    filled = np.zeros(scene.frames, bool)
    for p in passes:
        unknown = np.isnan(poses[p.frames][:, :3, :3]).any(axis=(1, 2))
        where = poses[p.frames][:, :3, 3]
        if not unknown.any() or len(p) < 2:
            continue
        sigma = np.nan_to_num(np.nanmax(scene.position_sigma_m[p.frames], axis=1, initial=0.0))
        noise = LIMIT * np.maximum(sigma, 1e-3)
        for k in np.flatnonzero(unknown):
            way = _direction(where, noise, int(k))
            if way is not None and np.isfinite(where[k]).all():
                up = vertical(p.rig) if p.rig.known() else -np.eye(3)[1]
                poses[p.frames[k], :3, :3] = _upright(way, up)
                poses[p.frames[k], 3] = (0, 0, 0, 1)
                filled[p.frames[k]] = True
    return poses, filled


def _direction(where: np.ndarray, noise: np.ndarray, k: int) -> np.ndarray | None:
    """Horizontal unit vector of travel at frame k over the shortest section that is longer than its noise."""
    for half in range(1, len(where)):
        a, b = max(0, k - half), min(len(where) - 1, k + half)
        step = (where[b] - where[a]) * (1, 1, 0)
        if np.isfinite(step).all() and np.linalg.norm(step) > max(noise[a], noise[b]):
            return step / np.linalg.norm(step)
        if a == 0 and b == len(where) - 1:
            return None
    return None


def _upright(way: np.ndarray, up_in_rig: np.ndarray) -> np.ndarray:
    """world_from_rig (3, 3) that maps the rig's vertical to the world's and the reference axis to ``way``."""
    ahead = np.array([0.0, 0.0, 1.0])
    ahead = ahead - (ahead @ up_in_rig) * up_in_rig
    if np.linalg.norm(ahead) < 1e-3:  # the reference camera looks up: any direction in the plane will do
        ahead = np.cross(up_in_rig, [1.0, 0.0, 0.0])
    ahead /= np.linalg.norm(ahead)
    rig = np.stack([ahead, np.cross(up_in_rig, ahead), up_in_rig], axis=1)
    world = np.stack([way, np.cross(_UP, way), _UP], axis=1)
    return world @ rig.T
