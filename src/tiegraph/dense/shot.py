"""One shot of a calibrated rig without any sparse model (paper 004, sections 4 and 5.3): partners by geometry alone.

The unit of a model by the depth maps of shots (section 4): a calibrated rig gives a scaled cloud of each station, so
that one camera will do for the poses; its model has no scale, but its points lie on the surface of the clouds.
"""

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np
import pycolmap

from tiegraph.dense import plan
from tiegraph.dense.settings import DenseSettings
from tiegraph.dense.tuning import Tuning
from tiegraph.dense.undistort import pinhole
from tiegraph.errors import InputError
from tiegraph.geometry.stereo import Pinhole
from tiegraph.geometry.transforms import apply, centre, invert, robust_sigma
from tiegraph.scene.colmapmodel import matrix
from tiegraph.scene.results import DepthMap

NO_OVERLAP = "the images share no part at this distance"
_LEAST_POINTS = 10  # that must fall onto the depth maps of a shot: its median is better than a point by three
_GRID = 0.04  # relative step of the units tried first; half of it is how well a depth must agree there


def depth_range(views: Sequence[plan.ViewPlan], near: float | None, far: float | None) -> plan.DepthRange:
    """The range given, or 5 (11.5 degrees, where images still look alike) to 100 times (0.6 degrees, where rays hardly
    intersect) the longest baseline. Raises InputError for a range that is none, or views in one place."""
    centres = centre(np.array([v.cam_from_world for v in views]))
    longest = float(np.linalg.norm(centres[:, None] - centres[None], axis=-1).max()) if len(views) else 0.0
    if longest == 0 or not np.isfinite(longest):
        raise InputError("a shot needs at least two calibrated cameras in different places: look at the rig file")
    found = plan.DepthRange(5 * longest if near is None else near, 100 * longest if far is None else far)
    if not 0 < found.near < found.far < np.inf:
        raise InputError(f"depth range {found.near:g} to {found.far:g}: near must be above 0 and below far")
    return found


def plan_shot(
    views: Sequence[plan.ViewPlan], sought: plan.DepthRange, settings: DenseSettings, tuning: Tuning
) -> plan.DensePlan:
    """Partners of every image of one shot; cam_from_world of the views is in the rig's frame and metres.

    Raises InputError when no two images can be matched.
    """
    cameras = [pinhole(v, settings) for v in views]
    images: dict[str, plan.ImagePlan] = {}
    dropped: list[tuple[str, str]] = []
    refused: Counter[str] = Counter()
    for k, view in enumerate(views):
        looked = [(*_look(cameras[k], cameras[j], sought, settings, tuning), v) for j, v in enumerate(views) if j != k]
        refused.update(reason for reason, _, _ in looked if reason)
        good = sorted((x for x in looked if not x[0]), key=lambda x: -x[1])[: settings.partners]
        if not good:
            dropped.append((view.name, "; ".join(sorted({reason for reason, _, _ in looked}))))
            continue
        partners = tuple(v for _, _, v in good)
        images[view.name] = plan.ImagePlan(
            view=view, partners=partners, witnesses=tuple(v.name for v in partners), depth_range=sought
        )
    if not images:
        raise InputError(
            f"no two cameras of the shot can be matched between {sought.near:g} and {sought.far:g} m: "
            f"{'; '.join(dict.fromkeys(r for _, r in dropped))}. Give --near and --far, and look at the rig file"
        )
    return plan.DensePlan(images=images, dropped=tuple(dropped), refused=dict(refused))


def plan_hanging(
    model: pycolmap.Reconstruction, names: Collection[str], settings: DenseSettings, tuning: Tuning
) -> plan.DensePlan:
    """Partners of the images of a metric model that hang on their rigs: those of the same frame, by geometry alone,
    between the depths at which the frame's other images see points."""
    images: dict[str, plan.ImagePlan] = {}
    dropped: list[tuple[str, str]] = []
    refused: Counter[str] = Counter()
    for frame in model.frames.values():
        members = [model.image(d.id) for d in frame.data_ids]
        hanging = sorted((i for i in members if i.name in names), key=lambda i: i.name)
        depths = [np.zeros(0)]
        for image in (i for i in members if i.name not in names):
            ids = [p.point3D_id for p in image.get_observation_points2D()]
            xyz, pose = np.array([model.points3D[k].xyz for k in ids]).reshape(-1, 3), matrix(image.cam_from_world())
            depths.append(xyz @ pose[2, :3] + pose[2, 3])
        if not hanging:
            continue
        views = [
            plan.ViewPlan(i.name, plan.CameraModel.of(model.camera(i.camera_id)), matrix(i.cam_from_world()))
            for i in hanging
        ]
        seen = np.concatenate([d[d > 0] for d in depths])
        try:
            if len(seen) < tuning.partners.min_shared:
                raise InputError(f"the wide images of its frame see {len(seen)} points: too few to tell where to look")
            found = plan_shot(views, plan.range_of(seen), settings, tuning)
        except InputError as error:
            dropped += [(v.name, str(error)) for v in views]
            continue
        images |= found.images
        dropped += found.dropped
        refused.update(found.refused)
    return plan.DensePlan(images=images, dropped=tuple(dropped), refused=dict(refused))


def _look(
    reference: Pinhole, other: Pinhole, sought: plan.DepthRange, settings: DenseSettings, tuning: Tuning
) -> tuple[str, float]:
    """Why a camera is no partner, "" if it is one, by points spread over the reference's frame and the depths sought;
    and its worth."""
    u, v = np.meshgrid(*((np.arange(24) + 0.5) / 24 * s for s in reference.size))
    rays = np.stack([u.ravel(), v.ravel(), np.ones(u.size)], axis=1) @ np.linalg.inv(reference.K).T
    depths = 1 / np.linspace(1 / sought.far, 1 / sought.near, 5)
    world = apply(invert(reference.cam_from_world), (rays[None] * depths[:, None, None]).reshape(-1, 3))
    there = apply(other.cam_from_world, world)
    front = there[:, 2] > 0
    at = (there[:, :2] / np.where(front, there[:, 2], 1)[:, None]) * other.K[[0, 1], [0, 1]] + other.K[:2, 2]
    seen = front & (at >= 0).all(axis=1) & (at <= other.size).all(axis=1)
    if seen.mean() < 0.1:
        return NO_OVERLAP, 0.0
    angle, usable = plan.intersections(reference.cam_from_world, other.cam_from_world, world[seen])
    nearer = np.median(apply(reference.cam_from_world, world[seen])[:, 2] / there[seen, 2])
    scale = float(other.K[0, 0] / reference.K[0, 0] * nearer)
    widest = float(np.percentile(angle, 90))  # what is near can be measured though the far end cannot
    worth = float(seen.mean() * plan.angle_weight(angle, tuning.partners).mean())
    return plan.refusal(widest, float(usable.mean()), scale, settings, tuning.partners), worth


@dataclass(frozen=True)
class ShotScale:
    """Metres in a unit of the model; its relative sigma by how the shots scatter; points and shots that tell."""

    metres_per_unit: float
    sigma: float
    points: int
    shots: int


@dataclass(frozen=True, eq=False)
class Seen:
    """Points of the model (P, 3) in the frame of a camera that sees them, model units; where that camera is in the rig,
    metres; and a depth map of another camera of the same shot, whose ``cam_from_world`` is from the rig's frame."""

    shot: int
    points: np.ndarray
    rig_from_camera: np.ndarray
    depth: DepthMap

    def read(self, scale: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Depths of the points at scales (..., 1) or (..., P), and those that the map has where they fall, NaN = none;
        both (..., P)."""
        camera = self.depth.cam_from_world @ self.rig_from_camera
        at = scale[..., None] * (self.points @ camera[:3, :3].T) + camera[:3, 3]
        height, width = self.depth.depth_m.shape
        with np.errstate(divide="ignore", invalid="ignore"):
            place = at[..., :2] / at[..., 2:] * self.depth.K[[0, 1], [0, 1]] + self.depth.K[:2, 2]
            inside = (at[..., 2] > 0) & (place >= 0).all(axis=-1) & (place < (width, height)).all(axis=-1)
        column, row = np.moveaxis(np.where(inside[..., None], place, 0).astype(int), -1, 0)
        return at[..., 2], np.where(inside, self.depth.depth_m[row, column], np.nan)

    def scales(self, start: float) -> np.ndarray:
        """Metres per unit (P,) by which each point falls onto the map, sought from ``start``; NaN = none.

        A point runs along its ray with the scale: in steps, its scale is the one that gives it the depth read where it
        falls. On a surface without jumps each step shrinks the error by the parallax times the slope.
        """
        camera = self.depth.cam_from_world @ self.rig_from_camera
        along = self.points @ camera[2, :3]
        scale, step = np.full(len(self.points), start), np.full(len(self.points), np.inf)
        for _ in range(8):  # at a parallax of 6 degrees each shrinks the error ten times on slopes of 45
            with np.errstate(divide="ignore", invalid="ignore"):
                found = (self.read(scale)[1] - camera[2, 3]) / along
                step = np.abs(found / scale - 1)
            scale = np.where(found > 0, found, np.nan)
        near = np.abs(scale / start - 1) < _GRID
        return np.where((step < 1e-3) & near, scale, np.nan)


def shot_scale(seen: Sequence[Seen]) -> ShotScale | None:
    """The unit at which most points lie on the depth maps, then the median over shots of the median of their points;
    None where too few tell."""
    start = _most_agree([s for s in seen if len(s.points)])
    if start is None:
        return None
    by_shot: dict[int, list[np.ndarray]] = {}
    for one in seen:
        by_shot.setdefault(one.shot, []).append(one.scales(start))
    every = [np.concatenate(parts) for parts in by_shot.values()]
    good = [s for scales in every if len(s := scales[np.isfinite(scales)]) >= _LEAST_POINTS]
    if not good:
        return None
    medians = np.array([np.median(s) for s in good])
    scale = float(np.median(medians))
    scatter = robust_sigma(medians / scale - 1)
    sigma = scatter / float(np.sqrt(len(medians)))
    return ShotScale(metres_per_unit=scale, sigma=sigma, points=sum(map(len, good)), shots=len(medians))


def _most_agree(seen: Sequence[Seen]) -> float | None:
    """Of units over a wide range the one at which most points have the depth of the maps where they fall.

    Depths alone do not tell: a wide camera sees much that the maps do not reach.
    """
    mapped = [s for s in seen if np.isfinite(s.depth.depth_m).any()]
    ratios = [np.nanmedian(s.depth.depth_m) / np.median(s.points[:, 2]) for s in mapped]
    if not ratios:
        return None
    count = int(np.ceil(np.log(16) / np.log1p(_GRID)))
    tried = float(np.median(ratios)) * (1 + _GRID) ** np.arange(-count, count + 1)
    agree = np.zeros(len(tried), int)
    for one in seen:
        depth, read = one.read(tried[:, None])
        with np.errstate(invalid="ignore"):
            agree += (np.abs(read / depth - 1) < _GRID / 2).sum(axis=1)
    best = int(agree.argmax())
    rival = max(agree[: max(0, best - 2)].max(initial=0), agree[best + 3 :].max(initial=0))
    return float(tried[best]) if agree[best] > max(_LEAST_POINTS, 1.5 * rival) else None


def in_camera(cam_from_world: np.ndarray, points: np.ndarray) -> np.ndarray:
    """Points (P, 3) of the model in the frame of a camera, those before it."""
    local = apply(cam_from_world, points)
    return local[local[:, 2] > 0]
