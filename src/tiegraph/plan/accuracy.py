"""What a planned network is expected to know: positions and points, in shape and in the world, by place on the path;
and what ties it to the world: positions of a receiver, with outages, and control points.

The covariance comes from a function that is handed in: that of the stage ``sparse``, run on the synthetic network. The
world is universal kriging: the shape's covariance C is free of any similarity, the similarity is unknown, and fixes
(positions, control points) tell both it and the bends of the shape, as an adjustment with them does.
"""

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pycolmap

from tiegraph.errors import InputError
from tiegraph.geometry.align import rms_length
from tiegraph.geometry.gravity import UpTuning
from tiegraph.geometry.transforms import motions
from tiegraph.plan.figures import above_zero
from tiegraph.plan.network import MountedCamera, Network
from tiegraph.plan.path import Path
from tiegraph.plan.tuning import WorldTuning


@dataclass(frozen=True)
class Shape:
    """What the covariance of ``sparse`` says of a network, after the best similarity, metres.

    ``frames``: those (f,) whose positions are in ``covariance`` (3f, 3f); ``scale``: relative sigma, None = unknown.
    """

    frames: np.ndarray
    covariance: np.ndarray
    scale: float | None
    pixel_sigma: float
    points: np.ndarray  # (P,) ids
    point_sigma: np.ndarray  # (P, 3)

    def sigma(self) -> np.ndarray:
        """(f,) root sum of squares of each position."""
        return np.asarray(np.sqrt(np.clip(np.diag(self.covariance), 0, None).reshape(-1, 3).sum(axis=1)))


Propagate = Callable[[pycolmap.Reconstruction, bool], Shape]
"""The covariance of an adjusted model; True: as if its lenses were calibrated."""


@dataclass(frozen=True)
class Fix:
    """Something known in the world: a place (3,), its sigmas (3,), and the frame (row of ``Shape.frames``) nearest."""

    frame: int
    place: np.ndarray
    sigma: np.ndarray


@dataclass(frozen=True)
class Known:
    """What ties the path to the world. ``common``: sigmas (3,) that all positions of a receiver share, none = 0;
    ``vertical_deg``: how well the cameras tell the vertical, None = they do not."""

    fixes: tuple[Fix, ...]
    common: np.ndarray
    vertical_deg: float | None

    @property
    def placed(self) -> bool:
        """Whether there is enough for a place and a heading: two fixes apart."""
        return len(self.fixes) > 1


@dataclass(frozen=True)
class Expected:
    """Sigmas of positions (f,) and points (P,), metres, root sum of squares; NaN where nothing places them."""

    frames: np.ndarray  # (f,)
    shape: np.ndarray
    world_axes: np.ndarray  # (f, 3) along x, y, z
    near: np.ndarray  # (P,) row of the frame nearest to each point
    point_shape: np.ndarray
    point_world: np.ndarray

    @property
    def world(self) -> np.ndarray:
        """(f,) of positions in the world."""
        return np.asarray(np.linalg.norm(self.world_axes, axis=1))


def propagate(network: Network, by: Propagate, tie_px: float, calibrated: bool = False) -> Shape:
    """The shape's sigmas, of all the points that there will be. ``calibrated``: as if the lenses were."""
    found = by(network.model, calibrated)
    own = own_variance(network.model, found.points)
    shared = np.clip(found.point_sigma**2 - found.pixel_sigma**2 * own, 0, None)
    return Shape(
        frames=found.frames,
        covariance=found.covariance,
        scale=found.scale,
        pixel_sigma=tie_px,
        points=found.points,
        point_sigma=np.sqrt(shared + tie_px**2 * own),
    )


def own_variance(model: pycolmap.Reconstruction, points: np.ndarray) -> np.ndarray:
    """(P, 3) variances of points by their own rays, poses known, for observations of sigma 1 px."""
    out = np.empty((len(points), 3))
    for row, key in enumerate(points):
        point = model.point3D(int(key))
        information = np.zeros((3, 3))
        for element in point.track.elements:
            image = model.image(element.image_id)
            pose = image.cam_from_world().matrix()
            at = pose[:, :3] @ point.xyz + pose[:, 3]
            step = 1e-5 * np.linalg.norm(at)
            ends = model.camera(image.camera_id).img_from_cam(at + step * np.concatenate([np.eye(3), -np.eye(3)]))
            jacobian = (ends[:3] - ends[3:]).T / (2 * step) @ pose[:, :3]
            information += jacobian.T @ jacobian
        out[row] = np.diag(np.linalg.inv(information))
    return out


def expected(shape: Shape, network: Network, path: Path, known: Known) -> Expected:
    """Sigmas of all that is asked, by the frames of ``shape``."""
    centres = path.centres[shape.frames]
    xyz = np.array([network.model.point3D(int(k)).xyz for k in shape.points]).reshape(-1, 3)
    near = np.argmin(np.linalg.norm(xyz[:, None] - centres[None], axis=2), axis=1)
    world, placed = _world(shape, centres, xyz, known)
    return Expected(
        frames=shape.frames,
        shape=shape.sigma(),
        world_axes=world,
        near=near,
        point_shape=np.linalg.norm(shape.point_sigma, axis=1),
        point_world=np.sqrt(np.sum(shape.point_sigma**2, axis=1) + np.clip(placed, 0, None)),
    )


def _world(shape: Shape, centres: np.ndarray, xyz: np.ndarray, known: Known) -> tuple[np.ndarray, np.ndarray]:
    """Sigmas (f, 3) of the positions in the world, and the variances (P,) that the placement adds to points."""
    if not known.placed:
        return np.full(centres.shape, np.nan), np.full(len(xyz), np.nan)
    middle = centres.mean(axis=0)
    extent = max(rms_length(centres - middle), 1e-9)
    moved = motions(centres - middle).reshape(-1, 7)
    frames = [f.frame for f in known.fixes]
    rows = (3 * np.array(frames)[:, None] + np.arange(3)).ravel()
    fixed = motions(np.array([f.place for f in known.fixes]) - middle).reshape(-1, 7)
    noise = np.concatenate([f.sigma for f in known.fixes]) ** 2
    inverse = np.linalg.inv(shape.covariance[np.ix_(rows, rows)] + np.diag(noise))
    sigma = np.repeat([np.pi, 1e6 * extent, 1.0], [3, 3, 1])  # of turn, shift and scale, where nothing tells them
    if known.vertical_deg is not None:
        sigma[:2] = np.radians(known.vertical_deg)
    if shape.scale is not None:
        sigma[6] = shape.scale
    prior = np.diag(1 / sigma**2)
    placement = np.linalg.inv(fixed.T @ inverse @ fixed + prior)
    gain = shape.covariance[:, rows] @ inverse
    bent = np.einsum("ij,ij->i", gain, shape.covariance[:, rows])
    rest = moved - gain @ fixed
    variance = np.diag(shape.covariance) - bent + np.einsum("ij,jk,ik->i", rest, placement, rest)
    positions = np.clip(variance, 0, None).reshape(-1, 3) + known.common**2
    of_points = motions(xyz - middle)
    placed = np.einsum("nij,jk,nik->n", of_points, placement, of_points) + float(np.sum(known.common**2))
    return np.sqrt(positions), placed


@dataclass(frozen=True)
class Receiver:
    """Positions: sigma in plan and height, metres, and the stretches (from, to), metres from the start, without any."""

    sigma_m: float
    height_sigma_m: float
    outages_m: tuple[tuple[float, float], ...] = ()

    def __post_init__(self) -> None:
        if not (self.sigma_m > 0 and self.height_sigma_m > 0):
            raise InputError(f"--gnss {self.sigma_m:g},{self.height_sigma_m:g}: sigmas in metres, above zero")
        for a, b in self.outages_m:
            if not a < b:
                raise InputError(f"--outage {a:g}-{b:g}: give FROM-TO, metres from the start of the way, FROM below TO")


@dataclass(frozen=True)
class ControlPoints:
    """Control points on the surface, evenly along the path: how many, and their sigma, metres."""

    count: int
    sigma_m: float

    def __post_init__(self) -> None:
        if self.count < 0:
            raise InputError(f"--control {self.count}: give how many control points there are")
        above_zero("control-sigma", self.sigma_m, "metres")


def known_of(
    path: Path,
    cameras: list[MountedCamera],
    network: Network,
    shape: Shape,
    told: tuple[Receiver | None, ControlPoints],
    tuning: WorldTuning,
) -> Known:
    """The fixes of a path, by the frames that the shape is known of."""
    receiver, control = told
    fixes: list[Fix] = []
    common = np.zeros(3)
    if receiver is not None:
        sigma = np.array([receiver.sigma_m, receiver.sigma_m, receiver.height_sigma_m])
        # from where the first leg starts, whichever way a leg goes: a bridge is on every pass
        at = (path.way_m if path.legs[0].startswith("ring") else path.centres[:, 0])[shape.frames]
        out = np.any([(at >= a) & (at <= b) for a, b in receiver.outages_m] or [np.zeros(len(at), bool)], axis=0)
        thinned = np.sqrt(len(shape.frames) / len(path))  # each stands for its neighbours, too
        fixes += [Fix(k, path.centres[shape.frames[k]], sigma * thinned) for k in np.flatnonzero(~out).tolist()]
        if not control.count:
            common = sigma
    marked = np.linspace(0, len(shape.frames) - 1, control.count).round().astype(int).tolist()
    fixes += [control_point(path, network, shape, k, control.sigma_m, tuning) for k in marked]
    axes = np.stack([c.sensor_from_body[2, :3] for c in cameras])
    level = axes[np.abs(axes[:, 1]) < 0.7]  # less than 45 degrees up or down: cameras all round tell the vertical
    all_round = len(level) > 1 and float(np.linalg.norm(level.mean(axis=0))) < UpTuning().round
    return Known(tuple(fixes), common, UpTuning().ring_sigma_deg if all_round else None)


def control_point(path: Path, network: Network, shape: Shape, frame: int, sigma_m: float, tuning: WorldTuning) -> Fix:
    """A control point on the surface that a frame (row of the shape's) sees, where the images' marks meet."""
    images = network.model.frame(int(shape.frames[frame]) + 1).image_ids
    ids = {p.point3D_id for k in images for p in network.model.image(k.id).get_observation_points2D()}
    if not ids:
        return Fix(frame, path.centres[shape.frames[frame]], np.full(3, np.inf))
    well = [k for k in sorted(ids) if network.model.point3D(k).track.length() >= tuning.least_marks] or sorted(ids)
    here = path.centres[shape.frames[frame]]
    best = min(well, key=lambda k: float(np.linalg.norm(network.model.point3D(k).xyz - here)))
    met = tuning.mark_px**2 * own_variance(network.model, np.array([best]))[0]
    return Fix(frame, network.model.point3D(best).xyz, np.sqrt(sigma_m**2 + met))
