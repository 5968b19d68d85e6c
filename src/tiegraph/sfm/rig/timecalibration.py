"""A rig whose cameras do not fire at one instant: let go of, and held as it really is.

Every image becomes a frame of its own, tied to its frame's reference by the extrinsics, moved by time offset x motion,
with one offset and one constant error of the mounting for each camera as unknowns of the adjustment. The rig is never
bent to take up what is motion.
"""

from collections.abc import Collection, Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.scene.colmapmodel import image_poses, model_rigs, observations
from tiegraph.scene.scene import Scene
from tiegraph.sfm.adjustment.adjust import final_adjustment
from tiegraph.sfm.adjustment.constraints import PoseConstraints, RelativePosePrior
from tiegraph.sfm.adjustment.jacobians import RigConstraint, RigConstraints
from tiegraph.sfm.adjustment.lens import take_cameras
from tiegraph.sfm.adjustment.timecost import TimeOffsetPrior, TimeOffsetPriors
from tiegraph.sfm.model import frame_poses
from tiegraph.sfm.rig.linear import per_camera_frames
from tiegraph.sfm.rig.timeoffset import Motion, TimeOffset, rig_motion
from tiegraph.sfm.tuning import Tuning


@dataclass(frozen=True)
class TimeCalibration:
    """A released model, and when each camera fires against its frame's reference (key -> offset)."""

    model: pycolmap.Reconstruction
    offsets: Mapping[int, TimeOffset]
    note: str
    constraints: RigConstraints = RigConstraints(())  # between the frames of ``model``


@dataclass(frozen=True)
class TrustedCalibration:
    """What is believed of a model whose rig is let go of."""

    metres_per_unit: float
    calibrated: bool  # the extrinsics, but for a small constant
    constant_cameras: Collection[int] = ()  # COLMAP ids
    lenses_held: bool = False  # whatever the images say


@dataclass(frozen=True)
class _Setting:
    scene: Scene
    index: int  # of the rig
    metres_per_unit: float
    motion: Motion
    extrinsics: np.ndarray  # (S, 4, 4) sensor_from_rig, model units
    calibrated: bool
    loose: Mapping[int, float]
    tuning: Tuning

    def columns(self, image: int) -> np.ndarray:
        """(6,) place in model units and attitude a second, of the rig at an image's frame."""
        found = np.nan_to_num(self.motion.columns(np.array([self.scene.frame[image]]))[0])
        return np.concatenate([found[:3] / self.metres_per_unit, found[3:]])

    def covariance(self, image: int) -> np.ndarray:
        """(6, 6) of how far a camera is off from frame to frame."""
        speed, known = float(np.linalg.norm(self.columns(image)[:3])), self.tuning.rig.time_calibration
        place = known.loose_m / self.metres_per_unit + known.loose_s * speed
        keeps = known.held_deg if self.calibrated else known.loose_deg
        turn = max(keeps, self.loose.get(int(self.scene.sensor_key[image]), 0.0))
        return np.diag([np.radians(turn) ** 2] * 3 + [place**2] * 3)


def calibrate_times(
    model: pycolmap.Reconstruction,
    scene: Scene,
    index: int,
    believed: TrustedCalibration,
    tuning: Tuning,
    loose: Mapping[int, float] | None = None,
) -> TimeCalibration:
    """Release rig ``index`` of a model in which it was rigid; its cameras' offsets and constants are estimated.

    ``loose``: scatter in degrees of cameras (sensor keys) that do not keep still.
    """
    metres_per_unit, constant_cameras = believed.metres_per_unit, believed.constant_cameras
    rigs = model_rigs(model, scene)
    metric = frame_poses(image_poses(model, scene), scene.with_(rigs=rigs))
    metric[:, :3, 3] *= metres_per_unit
    places = [np.eye(4) if s.sensor_from_rig is None else s.sensor_from_rig for s in rigs[index].sensors]
    motion = rig_motion(metric, scene)
    setting = _Setting(
        scene=scene,
        index=index,
        metres_per_unit=metres_per_unit,
        motion=motion,
        extrinsics=np.stack(places),
        calibrated=believed.calibrated,
        loose=loose or {},
        tuning=tuning,
    )
    free = per_camera_frames(model, [index + 1], scene)
    soft = _soft(free, setting)
    assert soft.time_offsets is not None
    # A calibrated rig's rotations are held now, so that distortion the calibration leaves out cannot hide in them.
    doubted = constant_cameras if believed.calibrated and not believed.lenses_held else ()
    found = final_adjustment(free, (), constant_cameras, soft, doubted, tuning=tuning.adjust)
    return TimeCalibration(
        model=found.model,
        offsets=_offsets(setting, soft.time_offsets),
        note=found.note,
        constraints=_ties(found.model, soft),
    )


def _ties(model: pycolmap.Reconstruction, soft: PoseConstraints) -> RigConstraints:
    """The ties for the covariance: those of a camera share its time and its constant error, which are unknowns too."""
    assert soft.time_offsets is not None
    out = [_tie(model, tie) for tie in soft.relative_poses]
    out += [replace(_tie(model, t), camera=t.sensor, moves=_moves(model, t)) for t in soft.time_offsets.priors]
    cameras = tuple(sorted(soft.time_offsets.unknowns))
    held = np.tile(soft.time_offsets.sigma, (len(cameras), 1))
    return RigConstraints(constraints=tuple(out), cameras=cameras, held=held, moment=np.diag(held.ravel() ** 2))


def with_errors(ties: RigConstraints, moment: np.ndarray) -> RigConstraints:
    """The ties of a rig whose mountings are off by more than the adjustment held them to: ``moment`` (6S, 6S), mean
    products of place (model units) and turn (rad) of its S cameras."""
    at = np.arange(ties.held.size).reshape(-1, 7)[:, 1:].ravel()
    wide = ties.moment.copy()
    wide[np.ix_(at, at)] = moment
    return replace(ties, moment=wide)


def _tie(model: pycolmap.Reconstruction, tie: TimeOffsetPrior | RelativePosePrior) -> RigConstraint:
    frames = [model.image(i).frame_id for i in (tie.first, tie.second)]
    turn, place = np.sqrt(tie.covariance[0, 0]), np.sqrt(tie.covariance[3, 3])
    return RigConstraint(first=frames[0], second=frames[1], place=float(place), turn=float(turn))


def _moves(model: pycolmap.Reconstruction, tie: TimeOffsetPrior) -> np.ndarray:
    """(6, 7) shift and turn of the second image, along the axes of the model, by its time, place and turn."""
    lever = transforms.centre(tie.sensor_from_first)
    out = np.zeros((6, 7))
    out[:3, 0] = tie.columns[:3] + np.cross(tie.columns[3:], lever)
    out[3:, 0] = tie.columns[3:]
    out[:3, 1:4] = out[3:, 4:] = np.eye(3)
    axes = model.image(tie.first).cam_from_world().rotation.matrix().T
    return np.asarray(np.kron(np.eye(2), axes) @ out)


def _soft(model: pycolmap.Reconstruction, setting: _Setting) -> PoseConstraints:
    """One tie from the first registered image of each frame to each other; timed where it is the reference."""
    scene, timed, ties = setting.scene, [], []
    late_s, known = setting.tuning.rig.late_s, setting.tuning.rig.time_calibration
    for first, other, ids in _pairs(model, setting):
        relative = setting.extrinsics[scene.sensor[other]] @ transforms.invert(setting.extrinsics[scene.sensor[first]])
        covariance = setting.covariance(other)
        if scene.sensor[first] == 0:
            key = int(scene.sensor_key[other])
            timed.append(
                TimeOffsetPrior(
                    first=ids[0],
                    second=ids[1],
                    sensor=key,
                    sensor_from_first=relative,
                    columns=setting.columns(other),
                    covariance=covariance,
                )
            )
        else:
            covariance[3:, 3:] += np.eye(3) * (late_s * np.linalg.norm(setting.columns(other)[:3])) ** 2
            ties.append(RelativePosePrior(*ids, relative, covariance))
    place, turn = known.nominal_m, known.nominal_deg
    if setting.calibrated:
        place, turn = known.expected_m, known.expected_deg
    sigma = np.array([late_s, *[place / setting.metres_per_unit] * 3, *[np.radians(turn)] * 3])
    return PoseConstraints(
        relative_poses=ties, time_offsets=TimeOffsetPriors(timed, {t.sensor: np.zeros(7) for t in timed}, sigma)
    )


def _pairs(model: pycolmap.Reconstruction, setting: _Setting) -> Iterator[tuple[int, int, tuple[int, int]]]:
    """(first, other) scene indices of each frame's registered images, with their COLMAP ids."""
    scene = setting.scene
    ids = {scene.image_index[model.image(i).name]: i for i in model.reg_image_ids()}
    frames: dict[int, list[int]] = {}
    for k in sorted(ids, key=lambda k: int(scene.sensor[k])):
        if scene.rig[scene.frame[k]] == setting.index:
            frames.setdefault(int(scene.frame[k]), []).append(k)
    for first, *others in frames.values():
        for other in others:
            yield first, other, (ids[first], ids[other])


def _offsets(setting: _Setting, timed: TimeOffsetPriors) -> dict[int, TimeOffset]:
    """When each camera fires by the adjustment, and how far that moves it at the highest speed."""
    speed = {tie.sensor: 0.0 for tie in timed.priors}
    for tie in timed.priors:
        own = float(np.linalg.norm(tie.columns[:3])) * setting.metres_per_unit
        speed[tie.sensor] = max(speed[tie.sensor], own)
    late = {key: float(timed.unknowns[key][0]) for key in speed}
    return {key: TimeOffset(late[key], moves_m=abs(late[key]) * top) for key, top in speed.items()}


def with_observations_of(model: pycolmap.Reconstruction, mapped: pycolmap.Reconstruction) -> pycolmap.Reconstruction:
    """The mapped model with the cameras of the adjusted one, which lost the sightings of a loose camera."""
    out = pycolmap.Reconstruction(mapped)
    take_cameras(out, model)
    return out


def lost_images(
    rigid: pycolmap.Reconstruction, free: pycolmap.Reconstruction, scene: Scene, least: int
) -> tuple[int, ...]:
    """Scene indices of images that lose their place in a relaxed model, if that holds fewer images in all.

    What counts is an image that sees the ``least`` number of points: on the rig another would keep its place,
    alone nothing holds it but the tie to its frame. None if the relaxed model gains as many images as it loses.
    """
    before, after = (_placed_by_points(model, scene, least) for model in (rigid, free))
    return tuple(int(k) for k in np.flatnonzero(before & ~after)) if after.sum() < before.sum() else ()


def _placed_by_points(model: pycolmap.Reconstruction, scene: Scene, least: int) -> np.ndarray:
    registered = np.isfinite(image_poses(model, scene)).all(axis=(1, 2))
    return registered & (observations(model, scene) >= least)
