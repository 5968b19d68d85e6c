"""The synthetic network of a planned path: points of the surface, the images that see them, noisy observations."""

from dataclasses import dataclass, replace

import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from tiegraph.errors import InputError
from tiegraph.geometry import transforms
from tiegraph.plan.path import Facet, Path
from tiegraph.plan.request import WorldRequest
from tiegraph.scene.colmapmodel import add_rig

# Observations of tie points of an image, for each megapixel that shows surface (PandaSet 1400, canal_demo 4000, KITTI
# 4700, canal 6000), and of an image at most
_TIES_A_MEGAPIXEL, _MOST_TIES = 4000.0, 4000
# Of the images that could see a point those that do; mean of how far, seen from the point, they may stand off each
# other, and of how many times as near one may be as the other: so the tracks of canal come out as measured (7 images
# in the mean, 2 to 20; rays 18 deg apart in the median, distances 1.3 times).
_REPEAT, _TURN_DEG, _NEARER = 0.45, 18.0, 1.5
_INCIDENCE_DEG = 80.0  # of a ray on the surface
_LEAST_ANGLE_DEG = 1.0  # between the rays of a point, as `sparse` keeps them
# How much the rig is turned from frame to frame, sigma about each axis: boats, vehicles and hands are never still, and
# exactly parallel views would leave focal length and distance one unknown (canal: 0.5 to 1 deg).
_WOBBLE_DEG = 1.5
_MOST_POINTS = 3000  # simulated: fewer than there will be, of so much smaller errors that they tell as much
_LEAST_POINTS = 25  # that start from an image, however many images there are: fewer hold no camera
_MOST_FRAMES = 1500  # more are too many to propagate here


@dataclass(frozen=True)
class MountedCamera:
    """A camera of the rig with its place: sensor_from_body (4, 4)."""

    name: str
    camera: pycolmap.Camera
    sensor_from_body: np.ndarray


@dataclass(frozen=True)
class Network:
    """A COLMAP model whose frame ids are 1 + the path's frames, one rig of all cameras.

    ``share``: points that were made over those that there will be. The errors are scaled by its root, so that the model
    knows its poses as well as the whole would; of what a point's own rays say, that root is taken off again.
    """

    model: pycolmap.Reconstruction
    share: float
    seen: np.ndarray  # (F,) observations a frame will have

    def figures(self) -> dict[str, float]:
        """``model_figures`` of all the points that there will be."""
        made = model_figures(self.model)
        return {**made, "ties_an_image": made["ties_an_image"] / self.share}


@dataclass(frozen=True)
class _Sights:
    """Observations: image, point and pixel of each; the points; how much of each image shows surface."""

    image: np.ndarray  # (O,)
    point: np.ndarray  # (O,)
    xy: np.ndarray  # (O, 2)
    xyz: np.ndarray  # (P, 3)
    shown: np.ndarray  # (I,) 0 to 1


def make_network(path: Path, cameras: list[MountedCamera], world: WorldRequest, relief_m: float) -> Network:
    """The network of a path over a surface of this unevenness (sigma).

    Points start from pixels drawn evenly over each image, so features are as frequent everywhere in an image that
    shows surface. Another image sees such a point as often as the tolerances above let it: they are drawn for
    each point, as some features are found again from everywhere and most from nearby only. Raises InputError for
    paths that are too long, and for images that see too little surface or do not overlap.
    """
    if len(path) > _MOST_FRAMES:
        raise InputError(
            f"the path has {len(path)} frames: the accuracy of more than {_MOST_FRAMES} is not propagated here; "
            "plan a part of it (a shorter --length: accuracy repeats), or take a larger --base"
        )
    rng = np.random.default_rng(0)
    wobble = Rotation.from_rotvec(np.radians(_WOBBLE_DEG) * rng.standard_normal((len(path), 3))).as_matrix()
    path = replace(path, world_from_body=path.world_from_body @ transforms.rigid(wobble, np.zeros(3)))
    mounted = np.stack([c.sensor_from_body for c in cameras])
    poses = (mounted[None] @ transforms.invert(path.world_from_body)[:, None]).reshape(-1, 4, 4)
    images = len(poses)  # frame by frame
    sights = _sights(path, cameras, poses, relief_m, rng)
    if len(sights.xyz) < 3 * len(path):
        raise InputError(
            f"only {len(sights.xyz)} points of the surface are seen by two of the {images} images: they see past it or "
            "do not overlap; look at the drawing (-o), change --overlap, --base, --yaw or --pitch"
        )
    megapixels = np.array([c.camera.width * c.camera.height / 1e6 for c in cameras] * len(path))
    wanted = np.minimum(_TIES_A_MEGAPIXEL * megapixels, _MOST_TIES) * sights.shown
    if world.ties is not None:
        wanted = np.full(images, float(world.ties))
    made = np.bincount(sights.image, minlength=images)
    share = float(made.sum() / wanted.sum())
    noise = world.tie_px * np.sqrt(share) * rng.standard_normal(sights.xy.shape)
    model = _model(path, cameras, sights, sights.xy + noise)
    seen = np.round(made.reshape(len(path), -1).sum(axis=1) / share).astype(int)
    return Network(model, share, seen)


def model_figures(model: pycolmap.Reconstruction) -> dict[str, float]:
    """Of a model in metres, planned or made: pixel at the tie points, tie points of an image, images of one."""
    sizes = []
    for image_id in model.reg_image_ids():
        image = model.image(image_id)
        seen = image.get_observation_points2D()
        if not seen:
            continue
        xyz = np.array([model.point3D(p.point3D_id).xyz for p in seen])
        far = np.linalg.norm(xyz - image.projection_center(), axis=1)
        sizes.append(far / model.camera(image.camera_id).mean_focal_length())
    return {
        "tie_gsd_m": float(np.median(np.concatenate(sizes))),
        "ties_an_image": float(model.compute_mean_observations_per_reg_image()),
        "track_length": float(model.compute_mean_track_length()),
    }


def _sights(
    path: Path, cameras: list[MountedCamera], poses: np.ndarray, relief_m: float, rng: np.random.Generator
) -> _Sights:
    """Points that start from images, and which images see them; ``relief_m``: sigma of the surface's unevenness."""
    start, centres = int(max(_LEAST_POINTS, _MOST_POINTS // len(poses))), transforms.centre(poses)
    begun = []
    for k, pose in enumerate(poses):
        camera = cameras[k % len(cameras)].camera
        xy = rng.uniform(0, 1, (start, 2)) * [camera.width, camera.height]
        rays = np.column_stack([np.asarray(camera.cam_from_img(xy)), np.ones(start)]) @ pose[:3, :3]
        far, facing = _hit(centres[k], rays, path.surface)
        far = far + relief_m * rng.standard_normal(start) / np.linalg.norm(rays, axis=1)
        good = np.isfinite(far) & (far > 0)
        begun.append((centres[k] + far[good, None] * rays[good], facing[good], np.full(int(good.sum()), k)))
    points, normals, first = (np.concatenate(column) for column in zip(*begun))
    ray = points - centres[first]
    reach = np.linalg.norm(ray, axis=1)
    ray /= reach[:, None]
    # Features of a wall seen at a grazing angle are of what stands out of it: they face half-way to the camera.
    normals = normals - ray
    normals /= np.linalg.norm(normals, axis=1)[:, None]
    turned = np.cos(np.minimum(rng.exponential(np.radians(_TURN_DEG), len(points)), np.pi))
    nearer = np.exp(rng.exponential(np.log(_NEARER), len(points)))
    found = []
    for k, pose in enumerate(poses):
        camera = cameras[k % len(cameras)].camera
        to = points - centres[k]
        depth = to @ pose[2, :3]
        far = np.maximum(np.linalg.norm(to, axis=1), 1e-9)
        to = to / far[:, None]
        seen = (depth > 0) & (-np.sum(to * normals, axis=1) > np.cos(np.radians(_INCIDENCE_DEG)))
        seen &= (np.sum(to * ray, axis=1) > turned) & (far < nearer * reach) & (reach < nearer * far)
        rows = np.flatnonzero(seen & ((first == k) | (rng.random(len(points)) < _REPEAT)))
        xy = np.asarray(camera.img_from_cam(transforms.apply(pose, points[rows])))
        inside = np.all((xy >= 0) & (xy <= [camera.width, camera.height]), axis=1)
        found.append((np.full(int(inside.sum()), k), rows[inside], xy[inside]))
    image, point, pixel = (np.concatenate(column) for column in zip(*found))
    shown = np.bincount(first, minlength=len(poses)) / start
    made = _Sights(image=image, point=point, xy=pixel, xyz=points, shown=shown)
    return _useful(made, centres)


def _hit(centre: np.ndarray, rays: np.ndarray, surface: tuple[Facet, ...]) -> tuple[np.ndarray, np.ndarray]:
    """Lengths (N,) along rays (N, 3) to the first facet, NaN = none, and its normal (N, 3)."""
    best, normal = np.full(len(rays), np.inf), np.full(rays.shape, np.nan)
    for facet in surface:
        with np.errstate(divide="ignore", invalid="ignore"):
            far = ((facet.corner - centre) @ facet.normal) / (rays @ facet.normal)
            at = (centre + far[:, None] * rays - facet.corner) @ np.linalg.pinv(facet.edges)
        hit = (rays @ facet.normal < 0) & (far > 0) & (far < best) & np.all((at >= 0) & (at <= 1), axis=1)
        best[hit], normal[hit] = far[hit], facet.normal
    return np.where(np.isfinite(best), best, np.nan), normal


def _useful(sights: _Sights, centres: np.ndarray) -> _Sights:
    """Without points whose rays meet at too small an angle, or that one image sees."""
    order = np.argsort(sights.point, kind="stable")
    point = sights.point[order]
    ray = sights.xyz[point] - centres[sights.image[order]]
    ray /= np.linalg.norm(ray, axis=1)[:, None]
    first = np.searchsorted(point, point)  # the first ray of each point; the farthest from it tells the angle
    apart = np.arccos(np.clip(np.sum(ray * ray[first], axis=1), -1, 1))
    widest = np.zeros(len(sights.xyz))
    np.maximum.at(widest, point, apart)
    kept = widest >= np.radians(_LEAST_ANGLE_DEG)
    good, number = kept[sights.point], np.cumsum(kept) - 1
    columns = {"image": sights.image[good], "point": number[sights.point[good]], "xy": sights.xy[good]}
    return replace(sights, **columns, xyz=sights.xyz[kept])


def _model(path: Path, cameras: list[MountedCamera], sights: _Sights, xy: np.ndarray) -> pycolmap.Reconstruction:
    """COLMAP's model. The first camera is the reference of the rig."""
    model = pycolmap.Reconstruction()
    body_from_first = transforms.invert(cameras[0].sensor_from_body)
    places = [pycolmap.Rigid3d((c.sensor_from_body @ body_from_first)[:3]) for c in cameras]
    add_rig(model, [c.camera for c in cameras], places)
    first_from_world = transforms.invert(path.world_from_body @ body_from_first)
    number = np.empty(len(xy), int)  # of each observation in its image
    for f in range(len(path)):
        frame = pycolmap.Frame(frame_id=f + 1, rig_id=1)
        ids = [f * len(cameras) + c for c in range(len(cameras))]
        for c, k in enumerate(ids):
            frame.add_data_id(pycolmap.data_t(model.camera(c + 1).sensor_id, k + 1))
        frame.rig_from_world = pycolmap.Rigid3d(first_from_world[f, :3])
        model.add_frame(frame)
        for c, k in enumerate(ids):
            rows = np.flatnonzero(sights.image == k)
            number[rows] = np.arange(len(rows))
            name = f"{cameras[c].name}/{f:06d}"
            image = pycolmap.Image(name=name, camera_id=c + 1, image_id=k + 1, keypoints=xy[rows])
            image.frame_id = f + 1
            model.add_image(image)
    order = np.argsort(sights.point, kind="stable")
    grey = np.full(3, 128, np.uint8)
    for rows in np.split(order, np.flatnonzero(np.diff(sights.point[order])) + 1):
        track = [pycolmap.TrackElement(int(sights.image[r]) + 1, int(number[r])) for r in rows]
        model.add_point3D(sights.xyz[sights.point[rows[0]]], pycolmap.Track(track), grey)
    for f in range(len(path)):
        model.register_frame(f + 1)
    return model
