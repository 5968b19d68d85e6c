"""Start values: cameras from a search over the focal length, the rig from poses of the board at the same instants."""

import cv2
import numpy as np
import pycolmap

from tiegraph.calibrate.adjust import State, adjust, residuals
from tiegraph.calibrate.observations import Observations, View, joint_instants
from tiegraph.calibrate.tuning import AdjustTuning
from tiegraph.geometry import transforms
from tiegraph.scene.rig import on_plane

_CLIP_PX = 50.0


def start(seen: Observations, tuning: AdjustTuning) -> State:
    """Every camera by itself, then the cameras against each other, then the board at every instant."""
    stages, single = tuning.stages_px, []
    for own in map(seen.of_camera, range(len(seen.cameras))):
        state = adjust(own, _resected(own, _by_focal_length(own)), tuning, stages, principal_point=False)
        # Poses seen with a wrong lens may have fallen over: a plane has two resections that are nearly as good.
        single.append(adjust(own, _resected(own, state.cameras[0]), tuning, stages))
    cameras = tuple(state.cameras[0] for state in single)
    poses = {(v.camera, v.instant): _poses(cameras[v.camera], seen, v) for v in seen.views}
    for (camera, instant), said in poses.items():
        said.insert(0, single[camera].rig_from_board[instant])  # adjusted: better than those of a resection
    sensors = _rig(seen, {key: found[0] for key, found in poses.items()})
    return State(cameras, sensors, _boards(seen, cameras, sensors, poses))


def _resected(own: Observations, camera: pycolmap.Camera) -> State:
    boards = {v.instant: _poses(camera, own, v)[0] for v in own.views}
    return State((camera,), np.eye(4)[None], boards)


def _by_focal_length(own: Observations) -> pycolmap.Camera:
    """The camera without distortion whose focal length explains the views best."""
    images = own.cameras[0]
    # In longer sides of the image: 380 to 29 degrees of view, or 127 to 7; neighbours of 24 are 16 % apart.
    bounds = (0.15, 2.0) if "FISHEYE" in images.model else (0.25, 8.0)
    fullest = sorted(own.views, key=lambda v: -len(v.corners))[:20]

    def cost(camera: pycolmap.Camera) -> float:
        best = (_poses(camera, own, v)[0] for v in fullest)
        return sum(_error(camera, pose, own, v) for v, pose in zip(fullest, best))

    longer, cameras = max(images.size), []
    for focal in np.geomspace(*bounds, 24):
        camera = pycolmap.Camera.create_from_model_name(1, images.model, float(focal) * longer, *images.size)
        camera.has_prior_focal_length = True
        cameras.append(camera)
    return min(cameras, key=cost)


def _error(camera: pycolmap.Camera, pose: np.ndarray, seen: Observations, view: View) -> float:
    """Mean distance of a view's corners from where a pose (4, 4) of the board projects them, each at most 50 px."""
    off = residuals(camera, pose, seen.board.points[view.corners], view.xy)
    return float(np.minimum(np.nan_to_num(np.hypot(*off.T), nan=_CLIP_PX), _CLIP_PX).mean())


def _poses(camera: pycolmap.Camera, seen: Observations, view: View) -> list[np.ndarray]:
    """camera_from_board (4, 4): the resections of a view, the best one first."""
    plane, points = on_plane(camera, view.xy), seen.board.points[view.corners]
    good = np.isfinite(plane).all(axis=1)
    found: list[np.ndarray] = []
    if good.sum() >= 4:
        _, turns, places, _ = cv2.solvePnPGeneric(
            points[good], plane[good][:, None], np.eye(3), None, flags=cv2.SOLVEPNP_IPPE
        )
        found = [transforms.rigid(cv2.Rodrigues(r)[0], t.ravel()) for r, t in zip(turns, places)]
        found = [pose for pose in found if np.isfinite(pose).all()]
    # Of a view that no resection explains the board is straight ahead, and the adjustment will leave the view out.
    ahead = np.append(-points.mean(axis=0)[:2], 2 * float(np.ptp(points, axis=0).max()))
    return sorted(found, key=lambda p: _error(camera, p, seen, view)) or [transforms.rigid(np.eye(3), ahead)]


# --- the rig --------------------------------------------------------------------------------------------------------


def _rig(seen: Observations, poses: dict[tuple[int, int], np.ndarray]) -> np.ndarray:
    """sensor_from_rig (C, 4, 4): along the pairs of cameras that see the board together most often."""
    joint = joint_instants(seen)
    out = {0: np.eye(4)}
    while len(out) < len(seen.cameras):
        pairs = [(a, b) for a in out for b in range(len(seen.cameras)) if b not in out]
        a, b = max(pairs, key=lambda pair: joint[pair])
        shared = [i for i in seen.instants() if (a, i) in poses and (b, i) in poses]
        # The statement from which the others differ least, by the median: half of them may be wrong.
        each = np.stack([poses[b, i] @ transforms.invert(poses[a, i]) for i in shared])
        length = max(float(np.median(np.linalg.norm(each[:, :3, 3], axis=1))), 1e-6)
        turn = np.radians(transforms.angle_deg(each[:, None, :3, :3], each[None, :, :3, :3]))
        place = np.linalg.norm(each[:, None, :3, 3] - each[None, :, :3, 3], axis=-1) / length
        out[b] = each[int(np.argmin(np.median(turn + place, axis=1)))] @ out[a]
    return np.stack([out[k] for k in range(len(out))])


def _boards(
    seen: Observations,
    cameras: tuple[pycolmap.Camera, ...],
    sensors: np.ndarray,
    poses: dict[tuple[int, int], list[np.ndarray]],
) -> dict[int, np.ndarray]:
    """rig_from_board of every instant: of the poses that its views say, the one that explains all of them best."""
    out = {}
    for instant in seen.instants():
        views = [v for v in seen.views if v.instant == instant]
        said = [transforms.invert(sensors[v.camera]) @ p for v in views for p in poses[v.camera, instant]]

        def cost(board: np.ndarray, views: list[View] = views) -> float:
            return sum(_error(cameras[v.camera], sensors[v.camera] @ board, seen, v) for v in views)

        out[instant] = min(said, key=cost)
    return out
