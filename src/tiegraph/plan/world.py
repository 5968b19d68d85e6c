"""What ties a planned path to the world: positions of a receiver, with outages, and control points."""

from dataclasses import dataclass

import numpy as np

from tiegraph.errors import InputError
from tiegraph.geometry.gravity import UpTuning
from tiegraph.plan.accuracy import Fix, Known, Shape, looks_round, own_variance
from tiegraph.plan.network import MountedCamera, Network
from tiegraph.plan.path import Path
from tiegraph.plan.tuning import WorldTuning


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
        if not self.sigma_m > 0:
            raise InputError(f"--control-sigma {self.sigma_m:g}: give metres, above zero")


def along(path: Path) -> np.ndarray:
    """(F,) metres from where the first leg starts, whichever way a leg goes: where a bridge is on every pass."""
    if np.ptp(path.way_m - path.centres[:, 0]) > 0 and path.legs[0].startswith("ring"):
        return path.way_m
    return path.centres[:, 0]


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
        at = along(path)[shape.frames]
        out = np.any([(at >= a) & (at <= b) for a, b in receiver.outages_m] or [np.zeros(len(at), bool)], axis=0)
        thinned = np.sqrt(len(shape.frames) / len(path))  # each stands for its neighbours, too
        fixes += [Fix(k, path.centres[shape.frames[k]], sigma * thinned) for k in np.flatnonzero(~out).tolist()]
        if not control.count:
            common = sigma
    marked = np.linspace(0, len(shape.frames) - 1, control.count).round().astype(int).tolist()
    fixes += [control_point(path, network, shape, k, control.sigma_m, tuning) for k in marked]
    axes = np.stack([c.sensor_from_body[2, :3] for c in cameras])
    return Known(tuple(fixes), common, UpTuning().ring_sigma_deg if looks_round(axes) else None)


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
