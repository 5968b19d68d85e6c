"""One shot of a calibrated rig without any sparse model (paper 004, sections 4 and 5.3): partners by geometry alone."""

from collections import Counter
from collections.abc import Collection, Sequence
from dataclasses import replace

import numpy as np
import pycolmap

from tiegraph.dense.neighbours import angle_weight, range_of, refusal
from tiegraph.dense.plan import CameraModel, DensePlan, DepthRange, ImagePlan, Partner, ViewPlan
from tiegraph.dense.settings import DenseSettings
from tiegraph.dense.tuning import Tuning
from tiegraph.dense.undistort import pinhole
from tiegraph.errors import InputError
from tiegraph.geometry.stereo import Pinhole, rectifying_rotation, usable_rays
from tiegraph.geometry.transforms import apply, centre, invert
from tiegraph.scene.colmapmodel import matrix

NO_OVERLAP = "the images share no part at this distance"


def depth_range(views: Sequence[ViewPlan], near: float | None, far: float | None) -> DepthRange:
    """The range given, or 5 (11.5 degrees, where images still look alike) to 100 times (0.6 degrees, where rays hardly
    intersect) the longest baseline. Raises InputError for a range that is none, or views in one place."""
    centres = centre(np.array([v.cam_from_world for v in views]))
    longest = float(np.linalg.norm(centres[:, None] - centres[None], axis=-1).max()) if len(views) else 0.0
    if longest == 0 or not np.isfinite(longest):
        raise InputError("a shot needs at least two calibrated cameras in different places: look at the rig file")
    found = DepthRange(
        5 * longest if near is None else near,
        100 * longest if far is None else far,
    )
    if not 0 < found.near < found.far < np.inf:
        raise InputError(f"depth range {found.near:g} to {found.far:g}: near must be above 0 and below far")
    return found


def plan_shot(views: Sequence[ViewPlan], sought: DepthRange, settings: DenseSettings, tuning: Tuning) -> DensePlan:
    """Partners of every image of one shot; cam_from_world of the views is in the rig's frame and metres.

    Raises InputError when no two images can be matched.
    """
    cameras = [pinhole(v, settings) for v in views]
    images: dict[str, ImagePlan] = {}
    dropped: list[tuple[str, str]] = []
    refused: Counter[str] = Counter()
    for k, view in enumerate(views):
        others = [j for j in range(len(views)) if j != k]
        looked = [_look(cameras[k], cameras[j], views[j], sought, settings, tuning) for j in others]
        refused.update(p.reason for p, _ in looked if not p.used)
        good = sorted((x for x in looked if x[0].used), key=lambda x: -x[1])[: settings.partners]
        if not good:
            dropped.append((view.name, "; ".join(sorted({p.reason for p, _ in looked}))))
            continue
        partners = tuple(p.view for p, _ in good)
        images[view.name] = ImagePlan(
            view=view, partners=partners, witnesses=tuple(v.name for v in partners), depth_range=sought
        )
    if not images:
        raise InputError(
            f"no two cameras of the shot can be matched between {sought.near:g} and {sought.far:g} m: "
            f"{'; '.join(dict.fromkeys(r for _, r in dropped))}. Give --near and --far, and look at the rig file"
        )
    return DensePlan(images=images, dropped=tuple(dropped), notes=(), refused=dict(refused))


def plan_hanging(
    model: pycolmap.Reconstruction, names: Collection[str], settings: DenseSettings, tuning: Tuning
) -> DensePlan:
    """Partners of the images of a metric model that hang on their rigs: those of the same frame, by geometry alone,
    between the depths at which the frame's other images see points."""
    images: dict[str, ImagePlan] = {}
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
            ViewPlan(i.name, CameraModel.of(model.camera(i.camera_id)), matrix(i.cam_from_world())) for i in hanging
        ]
        seen = np.concatenate([d[d > 0] for d in depths])
        try:
            if len(seen) < tuning.partners.min_shared:
                raise InputError(f"the wide images of its frame see {len(seen)} points: too few to tell where to look")
            found = plan_shot(views, range_of(seen), settings, tuning)
        except InputError as error:
            dropped += [(v.name, str(error)) for v in views]
            continue
        images |= found.images
        dropped += found.dropped
        refused.update(found.refused)
    return DensePlan(images=images, dropped=tuple(dropped), refused=dict(refused))


def _look(
    reference: Pinhole, other: Pinhole, view: ViewPlan, sought: DepthRange, settings: DenseSettings, tuning: Tuning
) -> tuple[Partner, float]:
    """A candidate judged at points spread over the reference's frame and the depths sought, and its worth."""
    world, size_ratio = _points(reference, sought), other.K[0, 0] / reference.K[0, 0]
    there = apply(other.cam_from_world, world)
    front = there[:, 2] > 0
    at = (there[:, :2] / np.where(front, there[:, 2], 1)[:, None]) * other.K[[0, 1], [0, 1]] + other.K[:2, 2]
    seen = front & (at >= 0).all(axis=1) & (at <= other.size).all(axis=1)
    if seen.mean() < 0.1:
        return Partner(view=view, shared=0, angle_deg=0.0, scale=1.0, reason=NO_OVERLAP), 0.0
    world, there = world[seen], there[seen]
    own = apply(reference.cam_from_world, world)
    from_a, from_b = world - centre(reference.cam_from_world), world - centre(other.cam_from_world)
    cosine = np.sum(from_a * from_b, axis=1) / (np.linalg.norm(from_a, axis=1) * np.linalg.norm(from_b, axis=1))
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    usable = np.zeros(len(world), bool)
    rotations = rectifying_rotation(reference.cam_from_world, other.cam_from_world)
    if rotations is not None:
        usable = usable_rays(own @ rotations[0].T) & usable_rays(there @ rotations[1].T)
    scale = float(size_ratio * np.median(own[:, 2] / there[:, 2]))
    widest = float(np.percentile(angle, 90))  # what is near can be measured though the far end cannot
    partner = Partner(view=view, shared=int(seen.sum()), angle_deg=widest, scale=scale)
    reason = refusal(partner, float(usable.mean()), settings, tuning.partners)
    worth = float(seen.mean() * angle_weight(angle, tuning.partners).mean())
    return replace(partner, reason=reason), worth


def _points(camera: Pinhole, sought: DepthRange) -> np.ndarray:
    """World points (n, 3) on a grid of the camera's rays."""
    u, v = np.meshgrid(*((np.arange(24) + 0.5) / 24 * s for s in camera.size))
    rays = np.stack([u.ravel(), v.ravel(), np.ones(u.size)], axis=1) @ np.linalg.inv(camera.K).T
    depths = 1 / np.linspace(1 / sought.far, 1 / sought.near, 5)
    return apply(invert(camera.cam_from_world), (rays[None] * depths[:, None, None]).reshape(-1, 3))
