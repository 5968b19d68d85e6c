"""The plan of a whole path, place by place: what is expected where, what is worst, what would help."""

from dataclasses import dataclass, replace

import numpy as np

from tiegraph.plan.accuracy import (
    ControlPoints,
    Expected,
    Known,
    Propagate,
    Receiver,
    Shape,
    control_point,
    expected,
    known_of,
    propagate,
)
from tiegraph.plan.network import MountedCamera, Network, Ties, make_network
from tiegraph.plan.path import Path
from tiegraph.plan.tuning import Tuning
from tiegraph.text import finite

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
    path: Path,
    cameras: list[MountedCamera],
    by: Propagate,
    told: tuple[Receiver | None, ControlPoints],
    seen: tuple[Ties, float],
    tuning: Tuning,
) -> PathPlan:
    """What a path is expected to give. ``seen``: the tie points, and the unevenness of the surface, m."""
    ties, relief_m = seen
    network = make_network(path, cameras, ties, relief_m, tuning.network)
    shape = propagate(network, by, ties.sigma_px)
    known = known_of(path, cameras, network, shape, told, tuning.world)
    lenses = propagate(network, by, ties.sigma_px, calibrated=True)
    found = expected(shape, network, path, known)
    return PathPlan(
        path=path, cameras=cameras, network=network, known=known, expected=found,
        places=tuple(_places(path, network, found, tuning)), worst=tuple(_worst(path, found, known, tuning)),
        advice=(*_lens_advice(shape, lenses, tuning), *_advice(path, network, shape, known, told[1], tuning)),
        scale=shape.scale,
    )  # fmt: skip


def _places(path: Path, network: Network, e: Expected, tuning: Tuning) -> list[Place]:
    out = []
    for leg, name in enumerate(path.legs):
        own = np.flatnonzero(path.leg == leg)
        most = max(1, tuning.world.sections // len(path.legs))
        for part in np.array_split(own, min(most, len(own))):
            rows = np.flatnonzero(np.isin(e.frames, part))
            near = np.flatnonzero(np.isin(e.near, rows))
            out.append(Place(
                leg=name, from_m=float(path.way_m[part[0]]), to_m=float(path.way_m[part[-1]]), frames=len(part),
                ties=int(np.median(network.seen[part])), shape_m=_middle(e.shape[rows]), world_m=_middle(e.world[rows]),
                point_shape_m=_middle(e.point_shape[near]), point_world_m=_middle(e.point_world[near]),
            ))  # fmt: skip
    return out


def _worst(path: Path, e: Expected, known: Known, tuning: Tuning) -> list[str]:
    """The places of the largest sigmas, each with what is special there; places beside one another are one."""
    sigma, what = (e.world, "in the world") if known.placed else (e.shape, "in shape")
    centres = path.centres[e.frames]
    apart = np.linalg.norm(np.ptp(centres, axis=0)) / (2 * tuning.world.sections)
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


def _lens_advice(shape: Shape, calibrated: Shape, tuning: Tuning) -> list[str]:
    """What lenses that are calibrated beforehand would bring."""
    now, then = (float(np.median(np.linalg.norm(s.point_sigma, axis=1))) for s in (shape, calibrated))
    if then > (1 - tuning.world.gain) * now:
        return []
    return [
        f"lenses calibrated beforehand (tiegraph calibrate, --rig) bring points from {_metres(now)} to {_metres(then)} "
        "in shape (medians)"
    ]


def _advice(
    path: Path, network: Network, shape: Shape, known: Known, control: ControlPoints, tuning: Tuning
) -> list[str]:
    """What would help, worked out; nothing that was not."""
    if not known.placed:
        return ["nothing places the path in the world: with --gnss or --control its accuracy there is worked out, too"]
    now = expected(shape, network, path, known)
    row = int(np.argmax(now.world))
    added = control_point(path, network, shape, row, control.sigma_m, tuning.world)
    common = np.zeros(3) if control.count else known.common
    then = expected(shape, network, path, replace(known, fixes=(*known.fixes, added), common=common))
    before, after = float(now.world.max()), float(then.world.max())
    if after > (1 - tuning.world.gain) * before:
        return [
            f"one more control point at {path.place(int(now.frames[row]))}, the worst place, would change little "
            f"({_metres(before)} to {_metres(after)})"
        ]
    return [
        f"a control point of {_metres(control.sigma_m)} at {path.place(int(now.frames[row]))} brings the worst "
        f"position from {_metres(before)} to {_metres(after)}"
    ]


def _middle(values: np.ndarray) -> float:
    return float(np.median(values)) if len(values) else float("nan")


def _metres(value: float) -> str:
    return f"{value:.2g} m" if value >= 1 else f"{100 * value:.2g} cm" if value >= 0.01 else f"{1000 * value:.2g} mm"
