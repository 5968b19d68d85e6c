"""What one depth map needs to be made, as small picklable objects, so that a worker never loads the whole model; and
which images to match with which: by shared sparse points, angle of intersection, scale and epipole.
"""

from collections import Counter
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace

import numpy as np
import pycolmap
from scipy import sparse

from tiegraph.dense.settings import DenseSettings
from tiegraph.dense.tuning import PartnerTuning
from tiegraph.errors import ReconstructionError
from tiegraph.geometry.stereo import rectifying_rotation, usable_rays
from tiegraph.geometry.transforms import centre
from tiegraph.scene.colmapmodel import matrix

ONE_CENTRE = "nearly one centre: the rays hardly intersect"
WIDE = "angle of intersection too wide to look alike"
EPIPOLE = "motion along the line of sight: the epipole lies in the image"
SCALE = "scale too different"
SURPLUS = "better placed partners were chosen"


@dataclass(frozen=True)
class CameraModel:
    """A COLMAP camera by value: model name, size in pixels, parameters in COLMAP's order."""

    model: str
    width: int
    height: int
    params: tuple[float, ...]

    @staticmethod
    def of(camera: pycolmap.Camera) -> "CameraModel":
        """Of a pycolmap camera."""
        params = tuple(float(p) for p in camera.params)
        return CameraModel(model=camera.model_name, width=camera.width, height=camera.height, params=params)

    def to_pycolmap(self) -> pycolmap.Camera:
        """As a pycolmap camera."""
        return pycolmap.Camera(model=self.model, width=self.width, height=self.height, params=list(self.params))


@dataclass(frozen=True, eq=False)
class ViewPlan:
    """An image of the model: name, camera, cam_from_world (4, 4)."""

    name: str
    camera: CameraModel
    cam_from_world: np.ndarray


@dataclass(frozen=True)
class DepthRange:
    """Depths along the optical axis between which a surface is sought, in world units, 0 < near < far."""

    near: float
    far: float


@dataclass(frozen=True, eq=False)
class Partner:
    """An image that may be matched with a reference image: ``shared`` sparse points in both, their median angle of
    intersection ``angle_deg``, and the ``reason`` why it is refused, empty unless it is."""

    view: ViewPlan
    shared: int
    angle_deg: float
    reason: str


@dataclass(frozen=True, eq=False)
class ImagePlan:
    """One reference image: its partners to match with, and the further images whose depth maps can confirm it."""

    view: ViewPlan
    partners: tuple[ViewPlan, ...]
    witnesses: tuple[str, ...]  # names of images whose depth maps are compared with this one's
    depth_range: DepthRange
    elsewhen: tuple[str, ...] = ()  # names of images of other passes, which tell what was there in one pass only


@dataclass(frozen=True, eq=False)
class DensePlan:
    """All reference images by name; those left out with the reason; remarks for people."""

    images: dict[str, ImagePlan]
    dropped: tuple[tuple[str, str], ...] = ()
    notes: tuple[str, ...] = ()
    refused: dict[str, int] = field(default_factory=dict)  # reason -> number of refused pairs


@dataclass(frozen=True, eq=False)
class _Table:
    """The model as arrays: N images in name order, sparse points (P, 3), and each image's sorted point numbers."""

    views: list[ViewPlan]
    xyz: np.ndarray
    points: list[np.ndarray]
    centres: np.ndarray  # (N, 3)
    focal: np.ndarray  # (N,) px

    def depths(self, image: int, points: np.ndarray) -> np.ndarray:
        """Depth of points along the optical axis of an image."""
        pose = self.views[image].cam_from_world
        return self.xyz[points] @ pose[2, :3] + pose[2, 3]


def plan_images(
    reconstruction: pycolmap.Reconstruction,
    settings: DenseSettings,
    tuning: PartnerTuning,
    passes: Mapping[str, int] | None = None,
) -> DensePlan:
    """Partners, witnesses and depth range of every registered image; ``passes``: in which one each was taken, by name.

    Raises ReconstructionError when no image has a partner. Time grows with the observations, not with pairs of images.
    """
    table = _table(reconstruction)
    shared = _shared_counts(table)
    images: dict[str, ImagePlan] = {}
    dropped: list[tuple[str, str]] = []
    refused: Counter[str] = Counter()
    lonely = 0
    row = {view.name: k for k, view in enumerate(table.views)}
    for k, view in enumerate(table.views):
        candidates = _candidates(table, shared, k, settings, tuning)
        used = [p for p in candidates if not p.reason]
        refused.update(p.reason for p in candidates if p.reason not in ("", SURPLUS))
        if not used:
            why = f"no other image shares {tuning.min_shared} sparse points with it"
            if candidates:
                reason, count = Counter(p.reason for p in candidates).most_common(1)[0]
                why = f"no partner to match with: {reason} ({count} of {len(candidates)} candidates)"
            dropped.append((view.name, why))
            continue
        lonely += len(used) == 1
        # Points that a partner sees too. Others may come from images closer to each other than the partners are: while
        # a vehicle stands, what moves past it is triangulated to a few centimetres before the camera.
        common = np.intersect1d(table.points[k], np.concatenate([table.points[row[p.view.name]] for p in used]))
        # The partners, then those that share most points
        rest = sorted((p for p in candidates if p.reason not in ("", SCALE)), key=lambda p: -p.shared)
        names = list(dict.fromkeys(p.view.name for p in (*used, *rest)))
        most = max(tuning.witnesses, len(used))
        other = [n for n in names if passes and passes[n] != passes[view.name]]
        images[view.name] = ImagePlan(
            view=view,
            partners=tuple(p.view for p in used),
            witnesses=tuple(names[:most]),
            depth_range=range_of(table.depths(k, common)),
            elsewhen=tuple(other[: tuning.witnesses]),
        )
    if not images:
        reason, count = Counter(reason for _, reason in dropped).most_common(1)[0] if dropped else ("no image", 0)
        raise ReconstructionError(
            f"no image has a partner to match with; most often ({count} of {len(dropped)} images): {reason}. Take "
            "images from different places with overlap, lower --dense.min-angle-deg, or stop before the dense stage "
            "with --until georef"
        )
    note = f"{lonely} images have one partner only: their depths count if other depth maps confirm them"
    return DensePlan(images=images, dropped=tuple(dropped), notes=(note,) if lonely else (), refused=dict(refused))


def _table(reconstruction: pycolmap.Reconstruction) -> _Table:
    images = sorted((reconstruction.image(i) for i in reconstruction.reg_image_ids()), key=lambda image: image.name)
    row = {image.image_id: k for k, image in enumerate(images)}
    cameras = {c: CameraModel.of(camera) for c, camera in reconstruction.cameras.items()}
    views = [ViewPlan(i.name, cameras[i.camera_id], matrix(i.cam_from_world())) for i in images]
    observed: list[list[int]] = [[] for _ in images]
    for number, point in enumerate(reconstruction.points3D.values()):
        for image_id in {element.image_id for element in point.track.elements}:
            if image_id in row:
                observed[row[image_id]].append(number)
    poses = np.array([v.cam_from_world for v in views]).reshape(-1, 4, 4)
    return _Table(
        views=views,
        xyz=np.array([p.xyz for p in reconstruction.points3D.values()], float).reshape(-1, 3),
        points=[np.array(o, np.int64) for o in observed],
        centres=centre(poses),
        focal=np.array([reconstruction.camera(i.camera_id).mean_focal_length() for i in images]),
    )


def _shared_counts(table: _Table) -> sparse.csr_matrix:
    """(N, N) number of sparse points two images share."""
    length = [len(p) for p in table.points]
    rows, columns = np.repeat(np.arange(len(length)), length), np.concatenate([*table.points, np.zeros(0, np.int64)])
    seen = sparse.csr_matrix((np.ones(len(rows), np.int32), (rows, columns)), (len(length), len(table.xyz)))
    return sparse.csr_matrix(seen @ seen.T)


def _candidates(
    table: _Table, shared: sparse.csr_matrix, image: int, settings: DenseSettings, tuning: PartnerTuning
) -> list[Partner]:
    """Partners of one image that are considered: first those used, in the order of their choice."""
    row = slice(shared.indptr[image], shared.indptr[image + 1])
    others, counts = shared.indices[row], shared.data[row]
    keep = (others != image) & (counts >= tuning.min_shared)
    others, counts = others[keep], counts[keep]
    if len(others) == 0:
        return []
    depth = max(float(np.median(table.depths(image, table.points[image]))), 1e-12)
    aside = (table.centres[others] - table.centres[image]) @ table.views[image].cam_from_world[:2, :3].T
    rough_deg = np.degrees(np.linalg.norm(aside, axis=1) / depth)
    order = np.argsort(-counts * angle_weight(rough_deg, tuning), kind="stable")[:32]  # are looked at point by point
    looked = [_look(table, image, int(others[k]), int(counts[k]), settings, tuning) for k in order]
    good = [(partner, seen, weight) for partner, seen, weight in looked if not partner.reason]
    chosen = _choose(good, len(table.points[image]), settings.partners, tuning)
    surplus = [replace(good[k][0], reason=SURPLUS) for k in range(len(good)) if k not in chosen]
    return [good[k][0] for k in chosen] + surplus + [p for p, _, _ in looked if p.reason]


def _look(
    table: _Table, image: int, other: int, count: int, settings: DenseSettings, tuning: PartnerTuning
) -> tuple[Partner, np.ndarray, np.ndarray]:
    """A candidate judged by the shared points: with their positions in the image's list and their weights."""
    common, seen, _ = np.intersect1d(table.points[image], table.points[other], True, return_indices=True)
    step = -(-len(common) // 300)
    common, seen = common[::step], seen[::step]
    view, poses = table.views[other], (table.views[image].cam_from_world, table.views[other].cam_from_world)
    angle, usable = intersections(poses[0], poses[1], table.xyz[common])
    size_a = table.focal[image] / np.maximum(table.depths(image, common), 1e-12)
    size_b = table.focal[other] / np.maximum(table.depths(other, common), 1e-12)
    scale, middle = float(np.median(size_b / size_a)), float(np.median(angle))
    reason = refusal(middle, float(usable.mean()), scale, settings, tuning)
    weight = angle_weight(angle, tuning) * usable * min(scale, 1 / scale) * step
    return Partner(view=view, shared=count, angle_deg=middle, reason=reason), seen, weight


def intersections(a: np.ndarray, b: np.ndarray, world: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
    """Angles in degrees (P,) at which the rays of two images with poses ``a`` and ``b`` (4, 4) meet in points (P, 3),
    and which points are far enough from the epipoles (P,) bool."""
    from_a, from_b = world - centre(a), world - centre(b)
    cosine = np.sum(from_a * from_b, axis=1) / (np.linalg.norm(from_a, axis=1) * np.linalg.norm(from_b, axis=1))
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    rotations = rectifying_rotation(a, b)
    if rotations is None:
        return angle, np.zeros(len(world), bool)
    rays = from_a @ (rotations[0] @ a[:3, :3]).T, from_b @ (rotations[1] @ b[:3, :3]).T
    return angle, usable_rays(rays[0]) & usable_rays(rays[1])


def refusal(angle_deg: float, usable: float, scale: float, settings: DenseSettings, tuning: PartnerTuning) -> str:
    """Why a pair is not matched, empty if it is: by its angle of intersection, the share of the points far enough from
    the epipole, and the size of an object in the partner per its size in the reference."""
    if angle_deg < settings.min_angle_deg:
        return ONE_CENTRE
    if usable < tuning.min_usable:
        return EPIPOLE
    if angle_deg > tuning.max_angle_deg:
        return WIDE
    if not 1 / tuning.max_scale <= scale <= tuning.max_scale:
        return SCALE
    return ""


def angle_weight(angle_deg: np.ndarray, tuning: PartnerTuning) -> np.ndarray:
    """1 at the best angles, falling on both sides."""
    low, high = tuning.best_angles_deg
    narrow = np.clip(angle_deg / low, 0.01, 1.0)
    wide = np.exp(-np.square(np.maximum(angle_deg - high, 0) / 10.0))
    return narrow * wide


def _choose(
    good: Sequence[tuple[Partner, np.ndarray, np.ndarray]], points: int, most: int, tuning: PartnerTuning
) -> list[int]:
    """Greedy choice: each point of the image wants to be seen well by ``enough`` partners, more add little."""
    covered = np.zeros(points)
    chosen: list[int] = []
    while len(chosen) < min(most, len(good)):
        gains = [
            -1.0 if k in chosen else float(np.sum(weight * np.where(covered[seen] < tuning.enough, 1.0, 0.3)))
            for k, (_, seen, weight) in enumerate(good)
        ]
        best = int(np.argmax(gains))
        chosen.append(best)
        covered[good[best][1]] += 1
    return chosen


def range_of(depths: np.ndarray) -> DepthRange:
    """Where a surface is sought by the depths (P,) of sparse points on it: they do not cover everything, and 1 % at
    either end may be errors. Twice as near costs no time: only the coarsest level is matched over the full range."""
    inverse = 1.0 / depths[depths > 0]
    low, high = np.percentile(inverse, [1.0, 99.0])
    return DepthRange(near=float(1 / (high * 2.0)), far=float(1.35 / low))
