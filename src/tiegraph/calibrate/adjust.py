"""The joint adjustment of interiors, rig and boards, by pycolmap's bundle adjustment over points that are held.

Start values: cameras from a search over the focal length, the rig from poses of the board at the same instants.
"""

from collections.abc import Collection, Mapping, Sequence
from copy import deepcopy
from dataclasses import dataclass, field, replace
from typing import Any

import cv2
import numpy as np
import pycolmap

from tiegraph.calibrate.board import Observations, View, joint_instants
from tiegraph.errors import ReconstructionError
from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import CAUCHY_SIGMAS, robust_sigma
from tiegraph.scene.colmapmodel import add_rig, all_images, matrix, options_of, rigid3d, sensor_id
from tiegraph.scene.rig import on_plane

_RIG = 1
_CLIP_PX = 50.0  # residuals that compare start values
_STAGES_PX = (50.0, 5.0)  # scales of the Cauchy loss at first: undistorted start values are tens of pixels off
LEAST_SCALE_PX = 0.02  # of that of the last adjustments, which the residuals tell
_LEAST_KEPT = 0.5  # share of a camera's views: else board, model or instants are wrong and not the views


@dataclass(frozen=True)
class State:
    """Cameras (COLMAP's, C of them), sensor_from_rig (C, 4, 4), the first camera's being one; rig_from_board (4, 4) by
    instant, metres."""

    cameras: tuple[pycolmap.Camera, ...]
    sensor_from_rig: np.ndarray
    rig_from_board: Mapping[int, np.ndarray]

    def camera_from_board(self, view: View) -> np.ndarray:
        """(4, 4) of a view."""
        return np.asarray(self.sensor_from_rig[view.camera] @ self.rig_from_board[view.instant])

    def at(self, instants: Collection[int]) -> "State":
        """The state with the board of these instants alone."""
        kept = {k: pose for k, pose in self.rig_from_board.items() if k in instants}
        return State(self.cameras, self.sensor_from_rig, kept)


def residuals(camera: pycolmap.Camera, camera_from_board: np.ndarray, points: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """(K, 2) seen minus projected, pixels; NaN where a point is not before the camera."""
    inside = transforms.apply(camera_from_board, points)
    projected = np.asarray(camera.img_from_cam(inside), float)
    return np.where(inside[:, 2:] > 0, xy - projected, np.nan)


def view_residuals(seen: Observations, state: State) -> list[np.ndarray]:
    """Of every view, as of ``residuals``."""
    return [
        residuals(state.cameras[v.camera], state.camera_from_board(v), seen.board.points[v.corners], v.xy)
        for v in seen.views
    ]


def _sigma(values: list[np.ndarray]) -> float:
    """Sigma of one coordinate by the median of the absolute residuals, pixels."""
    every = np.concatenate([v.ravel() for v in values])
    return robust_sigma(every[~np.isnan(every)])


@dataclass(frozen=True)
class Adjusted:
    """The outcome: the views that were kept, the state, why others were left out, sigma of one coordinate, pixels."""

    seen: Observations
    state: State
    left_out: tuple[tuple[str, str], ...]
    sigma_px: float
    bent_m: np.ndarray = field(default_factory=lambda: np.zeros((0, 3)))  # (K, 3) of the board's corners from a plane


def adjust_robustly(seen: Observations, start: State, board_sigma_m: float = 0.0) -> Adjusted:
    """Adjust all, leave out views that contradict the others, adjust the rest; with a sigma the board's corners too.

    Raises ReconstructionError if most of a camera's contradict.
    """
    state = adjust(seen, start, _STAGES_PX)
    left_out: dict[str, str] = {}
    kept = seen
    for _ in range(5):
        found = _doubtful(kept, state)
        if not found:
            break
        left_out |= found
        kept = seen.without(left_out)
        for number, camera in enumerate(seen.cameras):
            before, after = (len(o.of_camera(number).views) for o in (seen, kept))
            if after < _LEAST_KEPT * before:
                name, reason = next(iter(left_out.items()))
                raise ReconstructionError(
                    f"{camera.name}: {before - after} of {before} views of the board contradict the others ({name}: "
                    f"{reason}): is the camera model right (--model), the board as --board says, and are images of "
                    "one instant called alike?"
                )
        state = adjust(kept, state.at(kept.instants()), _STAGES_PX[-1:])
    scale = max(CAUCHY_SIGMAS * _sigma(view_residuals(kept, state)), LEAST_SCALE_PX)
    state = adjust(kept, state, (scale,))
    flat = kept.board.points
    if board_sigma_m > 0:
        kept, state = _with_bent_board(kept, state, scale, board_sigma_m)
    sigma_px = _sigma(view_residuals(kept, state))
    left = tuple(left_out.items())
    return Adjusted(seen=kept, state=state, left_out=left, sigma_px=sigma_px, bent_m=kept.board.points - flat)


def _with_bent_board(seen: Observations, state: State, scale_px: float, sigma_m: float) -> tuple[Observations, State]:
    """Corners of the board adjusted with all else, each held to its place by a sigma. Place, turn and size of the board
    cost the priors and gain nothing, so they stay; what a corner does that no camera explains is the board's."""
    import pyceres

    for _ in range(2):  # the sigma of a pixel falls once the bend is no longer in it
        model = build(seen, state)
        adjuster = problem(model, scale_px, points=True)
        pixel = _sigma(view_residuals(seen, state))
        flat = [np.array(point.xyz) for point in model.points3D.values()]
        priors = [pyceres.factors.NormalPrior(xyz, (sigma_m / pixel) ** 2 * np.eye(3)) for xyz in flat]
        for point, prior in zip(model.points3D.values(), priors):
            adjuster.problem.add_residual_block(prior, None, [point.xyz])
        adjuster.solve()
        del priors  # the problem only borrows them
        points = np.array(seen.board.points)
        for key, corner in zip(sorted(model.point3D_ids()), seen.corners()):
            points[corner] = model.point3D(key).xyz
        seen, state = replace(seen, board=replace(seen.board, points=points)), _state(model, state)
        scale_px = max(CAUCHY_SIGMAS * _sigma(view_residuals(seen, state)), LEAST_SCALE_PX)
    return seen, state


def _doubtful(seen: Observations, state: State) -> dict[str, str]:
    """The worst view of every instant, if off by much more than the others, and why: the rest may fit without it."""
    all_off = view_residuals(seen, state)
    usual = _sigma(all_off)
    limit = max(1.0, 10 * usual)  # pixels: taken at another instant, or the board read wrongly
    worst: dict[int, tuple[float, str]] = {}
    for view, residual in zip(seen.views, all_off):
        off = float(np.median(np.nan_to_num(np.hypot(*residual.T), nan=np.inf)))
        if off > max(limit, worst.get(view.instant, (0.0, ""))[0]):
            worst[view.instant] = off, view.name
    return {
        name: f"its corners are {off:.1f} px off, where one of the others is {usual:.2f} px: another instant than its "
        "name says, or the board was not read rightly"
        for off, name in worst.values()
    }


def adjust(seen: Observations, start: State, scales_px: Sequence[float], principal_point: bool = True) -> State:
    """Interiors, relative orientations and boards adjusted, once for every scale of the Cauchy loss."""
    model = build(seen, start)
    for scale in scales_px:
        problem(model, scale, principal_point).solve()
    return _state(model, start)


def place_boards(seen: Observations, start: State, scale_px: float) -> State:
    """The boards alone adjusted, cameras and rig held."""
    model = build(seen, start)
    problem(model, scale_px, free=False).solve()
    return _state(model, start)


def problem(
    model: pycolmap.Reconstruction,
    scale_px: float,
    principal_point: bool = True,
    free: bool = True,
    points: bool = False,
) -> Any:
    """pycolmap's adjuster over all images, with the points held unless ``points``; ``free`` = False: cameras and rig
    held too."""
    options = options_of(
        200,
        1e-12,
        scale_px,
        refine_focal_length=free,
        refine_extra_params=free,
        refine_principal_point=free and principal_point,
        refine_sensor_from_rig=free,
    )
    config = all_images(model)
    for point in () if points else model.point3D_ids():
        config.add_constant_point(point)
    return pycolmap.create_default_ceres_bundle_adjuster(options, config, model)


def build(seen: Observations, state: State) -> pycolmap.Reconstruction:
    """COLMAP's model: the board is the world, an instant a frame of the rig."""
    model = pycolmap.Reconstruction()
    add_rig(model, state.cameras, [rigid3d(pose) for pose in state.sensor_from_rig])
    black = np.zeros(3, np.uint8)
    # One that no image sees would end the process: it is no block of Ceres' problem, and cannot be held.
    points = {int(k): model.add_point3D(seen.board.points[k], pycolmap.Track(), black) for k in seen.corners()}
    for frame, instant in enumerate(seen.instants(), 1):
        views = [v for v in seen.views if v.instant == instant]
        made = pycolmap.Frame(frame_id=frame, rig_id=_RIG)
        made.rig_from_world = rigid3d(state.rig_from_board[instant])
        images = []
        for number, view in enumerate(views, model.num_images() + 1):
            pixels = [pycolmap.Point2D(xy) for xy in view.xy]
            image = pycolmap.Image(image_id=number, name=view.name, camera_id=view.camera + 1, points2D=pixels)
            image.frame_id = frame
            made.add_data_id(image.data_id)
            images.append(image)
        model.add_frame(made)
        for image, view in zip(images, views):
            model.add_image(image)
            for row, corner in enumerate(view.corners):
                model.add_observation(points[int(corner)], pycolmap.TrackElement(image.image_id, row))
        model.register_frame(frame)
    for point in model.points3D.values():
        if point.track.length() == 1:  # pycolmap refuses it, as nothing could be triangulated; each image counts once
            point.track.add_element(point.track.elements[0])
    return model


def _state(model: pycolmap.Reconstruction, start: State) -> State:
    cameras = tuple(deepcopy(model.camera(k + 1)) for k in range(len(start.cameras)))
    sensors: dict[Any, Any] = dict(model.rigs[_RIG].non_ref_sensors.items())
    poses = [np.eye(4)] + [matrix(sensors[sensor_id(k + 1)]) for k in range(1, len(cameras))]
    frames: Any = model.frames
    boards = {i: matrix(frames[f].rig_from_world) for f, i in enumerate(sorted(start.rig_from_board), 1)}
    return State(cameras, np.stack(poses), boards)


def start(seen: Observations) -> State:
    """Every camera by itself, then the cameras against each other, then the board at every instant."""
    single = []
    for own in map(seen.of_camera, range(len(seen.cameras))):
        state = adjust(own, _resected(own, _by_focal_length(own)), _STAGES_PX, principal_point=False)
        # Poses seen with a wrong lens may have fallen over: a plane has two resections that are nearly as good.
        single.append(adjust(own, _resected(own, state.cameras[0]), _STAGES_PX))
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
