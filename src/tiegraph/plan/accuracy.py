"""What a planned network is expected to know of positions and points, in shape and in the world, place by place on the
path; what is worst, and what would help. The covariance comes from a function that is handed in.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np
import pycolmap

from tiegraph.geometry.gravity import UpTuning
from tiegraph.geometry.transforms import motions, rms_length
from tiegraph.plan.network import MountedCamera, Network, make_network
from tiegraph.plan.path import Path
from tiegraph.plan.request import WorldRequest
from tiegraph.text import finite


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
    return replace(found, pixel_sigma=tie_px, point_sigma=np.sqrt(shared + tie_px**2 * own))


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
    alone = np.linalg.norm(shape.point_sigma, axis=1)
    point_world = np.sqrt(np.sum(shape.point_sigma**2, axis=1) + np.clip(placed, 0, None))
    return Expected(shape.frames, shape.sigma(), world, near=near, point_shape=alone, point_world=point_world)


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


def known_of(path: Path, cameras: list[MountedCamera], network: Network, shape: Shape, world: WorldRequest) -> Known:
    """The fixes of a path, by the frames that the shape is known of."""
    positions = world.positions()
    fixes: list[Fix] = []
    common = np.zeros(3)
    if positions is not None:
        sigma, outages = positions
        # from where the first leg starts, whichever way a leg goes: a bridge is on every pass
        at = (path.way_m if path.legs[0].startswith("ring") else path.centres[:, 0])[shape.frames]
        out = np.any([(at >= a) & (at <= b) for a, b in outages] or [np.zeros(len(at), bool)], axis=0)
        thinned = np.sqrt(len(shape.frames) / len(path))  # each stands for its neighbours, too
        fixes += [Fix(k, path.centres[shape.frames[k]], sigma * thinned) for k in np.flatnonzero(~out).tolist()]
        if not world.control:
            common = sigma
    marked = np.linspace(0, len(shape.frames) - 1, world.control).round().astype(int).tolist()
    fixes += [control_point(path, network, shape, k, world.control_sigma) for k in marked]
    axes = np.stack([c.sensor_from_body[2, :3] for c in cameras])
    level = axes[np.abs(axes[:, 1]) < 0.7]  # less than 45 degrees up or down: cameras all round tell the vertical
    all_round = len(level) > 1 and float(np.linalg.norm(level.mean(axis=0))) < UpTuning().round
    return Known(tuple(fixes), common, UpTuning().ring_sigma_deg if all_round else None)


def control_point(path: Path, network: Network, shape: Shape, frame: int, sigma_m: float) -> Fix:
    """A control point on the surface that a frame (row of the shape's) sees, where the images' marks meet."""
    images = network.model.frame(int(shape.frames[frame]) + 1).image_ids
    ids = {p.point3D_id for k in images for p in network.model.image(k.id).get_observation_points2D()}
    if not ids:
        return Fix(frame, path.centres[shape.frames[frame]], np.full(3, np.inf))
    well = [k for k in sorted(ids) if network.model.point3D(k).track.length() >= _LEAST_MARKS] or sorted(ids)
    here = path.centres[shape.frames[frame]]
    best = min(well, key=lambda k: float(np.linalg.norm(network.model.point3D(k).xyz - here)))
    met = _MARK_PX**2 * own_variance(network.model, np.array([best]))[0]
    return Fix(frame, network.model.point3D(best).xyz, np.sqrt(sigma_m**2 + met))


_MARK_PX = 0.5  # of a control point marked in an image
_LEAST_MARKS = 3  # images that a control point is marked in, where as many see it
_SECTIONS = 8  # of a way that are told apart
_GAIN = 0.15  # by which a change must lower the worst sigma to be advised
_WORST = 3  # places of the largest sigmas that are named


@dataclass(frozen=True)
class Place:
    """A section of a leg; sigmas are medians over its frames and the points near them, NaN = nothing tells."""

    leg: str
    from_m: float
    to_m: float
    frames: int
    ties: int  # observations of tie points of a frame, median
    shape_m: float
    world_m: float
    point_shape_m: float
    point_world_m: float

    def row(self) -> dict[str, str | float | None]:
        """JSON-ready."""
        return finite(self.__dict__)


@dataclass(frozen=True)
class PathPlan:
    """A path with its synthetic network and what it is expected to give."""

    path: Path
    cameras: list[MountedCamera]
    network: Network
    known: Known
    expected: Expected
    places: tuple[Place, ...]
    worst: tuple[str, ...]
    advice: tuple[str, ...]
    scale: float | None  # relative sigma of all lengths by the rig alone, None = the rig tells none

    def summary(self) -> dict[str, float | int | None]:
        """Medians and largest values, JSON-ready; names as in the receipts of `sparse` and in world.json."""
        e = self.expected
        sigmas = {
            "position_shape": e.shape, "position_world": e.world, "height_world": e.world_axes[:, 2],
            "place_world": np.linalg.norm(e.world_axes[:, :2], axis=1), "point_shape": e.point_shape,
            "point_world": e.point_world,
        }  # fmt: skip
        out: dict[str, float | int | None] = {
            "frames": len(self.path), "images": len(self.path) * len(self.cameras),
            "points": round(self.network.model.num_points3D() / self.network.share), "scale_sigma": self.scale,
        }  # fmt: skip
        out |= self.network.figures()
        for name, values in sigmas.items():
            if len(values):
                out |= {f"{name}_sigma_median_m": np.median(values), f"{name}_sigma_max_m": np.max(values)}
        return finite(out)  # type: ignore[no-any-return]


def plan_path(
    path: Path, cameras: list[MountedCamera], by: Propagate, world: WorldRequest, relief_m: float
) -> PathPlan:
    """What a path is expected to give; ``relief_m``: sigma of the unevenness of the surface."""
    network = make_network(path, cameras, world, relief_m)
    shape = propagate(network, by, world.tie_px)
    known = known_of(path, cameras, network, shape, world)
    lenses = propagate(network, by, world.tie_px, calibrated=True)
    found = expected(shape, network, path, known)
    return PathPlan(
        path=path, cameras=cameras, network=network, known=known, expected=found,
        places=tuple(_places(path, network, found)), worst=tuple(_worst(path, found, known)),
        advice=(*_lens_advice(shape, lenses), *_advice(path, network, shape, known, world)),
        scale=shape.scale,
    )  # fmt: skip


def _places(path: Path, network: Network, e: Expected) -> list[Place]:
    out = []
    for leg, name in enumerate(path.legs):
        own = np.flatnonzero(path.leg == leg)
        most = max(1, _SECTIONS // len(path.legs))
        for part in np.array_split(own, min(most, len(own))):
            rows = np.flatnonzero(np.isin(e.frames, part))
            near = np.flatnonzero(np.isin(e.near, rows))
            out.append(Place(
                leg=name, from_m=float(path.way_m[part[0]]), to_m=float(path.way_m[part[-1]]), frames=len(part),
                ties=int(np.median(network.seen[part])), shape_m=_middle(e.shape[rows]), world_m=_middle(e.world[rows]),
                point_shape_m=_middle(e.point_shape[near]), point_world_m=_middle(e.point_world[near]),
            ))  # fmt: skip
    return out


def _worst(path: Path, e: Expected, known: Known) -> list[str]:
    """The places of the largest sigmas, each with what is special there; places beside one another are one."""
    sigma, what = (e.world, "in the world") if known.placed else (e.shape, "in shape")
    centres = path.centres[e.frames]
    apart = np.linalg.norm(np.ptp(centres, axis=0)) / (2 * _SECTIONS)
    chosen: list[int] = []
    for k in np.argsort(-sigma, kind="stable").tolist():
        if len(chosen) < _WORST and all(np.linalg.norm(centres[k] - centres[c]) > apart for c in chosen):
            chosen.append(k)
    out = []
    for k in chosen:
        text = f"{path.place(int(e.frames[k]))}: {_metres(sigma[k])} {what}"
        if known.placed:
            far = min(float(np.linalg.norm(centres[f.frame] - centres[k])) for f in known.fixes)
            text += f", {_metres(e.shape[k])} in shape" + (f", {far:.0f} m from the nearest fix" if far >= 1 else "")
        out.append(text)
    return out


def _lens_advice(shape: Shape, calibrated: Shape) -> list[str]:
    now, then = (float(np.median(np.linalg.norm(s.point_sigma, axis=1))) for s in (shape, calibrated))
    text = "lenses calibrated beforehand (tiegraph calibrate, --rig) bring points from {} to {} in shape (medians)"
    return [] if then > (1 - _GAIN) * now else [text.format(_metres(now), _metres(then))]


def _advice(path: Path, network: Network, shape: Shape, known: Known, world: WorldRequest) -> list[str]:
    """What would help, worked out; nothing that was not."""
    if not known.placed:
        return ["nothing places the path in the world: with --gnss or --control its accuracy there is worked out, too"]
    now = expected(shape, network, path, known)
    row = int(np.argmax(now.world))
    added = control_point(path, network, shape, row, world.control_sigma)
    common = np.zeros(3) if world.control else known.common
    then = expected(shape, network, path, replace(known, fixes=(*known.fixes, added), common=common))
    before, after, place = float(now.world.max()), float(then.world.max()), path.place(int(now.frames[row]))
    change = f"{_metres(before)} to {_metres(after)}"
    if after > (1 - _GAIN) * before:
        return [f"one more control point at {place}, the worst place, would change little ({change})"]
    return [f"a control point of {_metres(world.control_sigma)} at {place} brings the worst position from {change}"]


def _middle(values: np.ndarray) -> float:
    return float(np.median(values)) if len(values) else float("nan")


def _metres(value: float) -> str:
    return f"{value:.2g} m" if value >= 1 else f"{100 * value:.2g} cm" if value >= 0.01 else f"{1000 * value:.2g} mm"
