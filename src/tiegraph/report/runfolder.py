"""What a run folder holds, read as far as it is there: a report of a run that stopped early must work too."""

import json
import logging
from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import laspy
import numpy as np
from pydantic import ValidationError

from tiegraph.errors import InputError
from tiegraph.geometry import transforms
from tiegraph.report.observed import Observed, observed
from tiegraph.scene.accuracy import Accuracy
from tiegraph.scene.colmapmodel import is_model, matrix
from tiegraph.scene.colmapmodel import read_model as read_reconstruction
from tiegraph.scene.hanging import carries
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.registered import Registration, registration
from tiegraph.scene.scene import Scene
from tiegraph.scene.tuning import RegisteredTuning
from tiegraph.scene.tuning import Tuning as SceneTuning

log = logging.getLogger(__name__)
T = TypeVar("T")

_POINTS = 200_000  # of a sparse model that are read

STAGES = (
    "scan", "masks", "preview", "candidates", "coarse", "network", "design", "features", "match", "filter", "sparse",
    "georef", "refine", "dense", "cloud", "evaluate", "report",
)  # fmt: skip


@dataclass(frozen=True)
class ModelFigures:
    """A sparse model in numbers; the averages are over all of it."""

    points: int
    reprojection_px: float
    track_length: float
    observations: float  # per image


@dataclass(frozen=True)
class PointSample:
    """Some of the sparse points."""

    xyz: np.ndarray  # (K, 3), of the model
    rgb: np.ndarray  # (K, 3) u1


@dataclass(frozen=True)
class Model:
    """Facts of a sparse model; rows of the arrays follow the scene's images, NaN = not in the model."""

    folder: str
    world_from_camera: np.ndarray  # (N, 4, 4)
    images: Registration  # which are registered, which only their rig places
    figures: ModelFigures
    cameras: dict[int, dict]  # scene sensor_key -> {"model", "size", "focal_px"}
    sensor_from_rig: dict[int, np.ndarray]  # scene sensor_key -> (4, 4)
    sample: PointSample
    observed: Observed
    others: tuple[int, ...] = ()  # registered images of the further models

    @property
    def placed(self) -> np.ndarray:
        """(N,) bool: has a pose."""
        return self.images.placed

    @property
    def registered(self) -> np.ndarray:
        """(N,) bool: sees points that agree."""
        return self.images.registered

    @property
    def by_rig(self) -> np.ndarray:
        """(N,) bool: has its pose from the rig, or from very few points."""
        return self.images.by_rig

    @property
    def centres(self) -> np.ndarray:
        """(N, 3) projection centres."""
        return self.world_from_camera[:, :3, 3]


@dataclass(frozen=True)
class CloudSample:
    """A sample of a point cloud file and what holds for the whole."""

    name: str
    count: int
    bytes: int
    xyz: np.ndarray  # (K, 3), world
    rgb: np.ndarray  # (K, 3) u1
    sigma_m: np.ndarray  # (K,), NaN = unknown
    views: np.ndarray  # (K,), 0 = unknown


@dataclass(frozen=True)
class RunFolder:
    """The artefacts of a run; None or empty where a stage has not made them."""

    path: Path
    receipts: dict[str, dict]
    scene: Scene | None = None  # rig checked and sections cut, if `network` has run
    scanned: Scene | None = None  # as the scan found it: the rig as given
    network: Pairs | None = None
    pairs: Pairs | None = None
    world: dict | None = None
    metrics: dict | None = None
    model: Model | None = None
    cloud: CloudSample | None = None

    def counts(self, stage: str) -> dict[str, Any]:
        """The counts of a stage's receipt."""
        return self.receipts.get(stage, {}).get("counts") or {}

    @property
    def hanging(self) -> tuple[int, int]:
        """Images that take no part in structure from motion (``scene.hanging``), and those of them that have a pose."""
        return int(self.counts("scan").get("hanging", 0)), int(self.counts("georef").get("hanging", 0))

    @cached_property
    def hung(self) -> tuple[tuple[str, bool], ...]:
        """Names of the images that hang on their rig, and whether each has a pose."""
        whole = _try(self.path / "whole.json", lambda p: Scene.from_json(p.read_text()))
        if whole is None or self.scene is None:
            return ()
        placed = self.model.placed if self.model is not None and self.hanging[1] else np.zeros(len(self.scene), bool)
        frames = {int(whole.frame[whole.image_index[n]]) for n, has in zip(self.scene.names, placed) if has}
        return tuple((whole.names[k], int(whole.frame[k]) in frames) for k in np.flatnonzero(~carries(whole)))

    def done(self, stage: str) -> bool:
        """Whether a stage has finished."""
        return "key" in self.receipts.get(stage, {})

    @property
    def georeferenced(self) -> bool:
        """Whether world coordinates are on the Earth."""
        return bool(self.world and self.world.get("crs"))

    @cached_property
    def accuracy(self) -> Accuracy | None:
        """The accuracy of the run; None if it has not been evaluated."""
        said = (self.metrics or {}).get("accuracy")
        return None if said is None else Accuracy.from_dict(said)

    @property
    def metric(self) -> bool:
        """Whether lengths are in metres."""
        return self.georeferenced or (self.world or {}).get("scale_from") not in (None, "", "none")


def read_run(folder: Path, cloud_points: int = 1_000_000) -> RunFolder:
    """Everything a report needs. Raises InputError if the folder holds no run."""
    if not folder.is_dir():
        raise InputError(f"{folder}: no such run folder; give a folder made by `tiegraph run`")
    receipts = {s: r for s in STAGES if (r := _json(folder / "receipts" / f"{s}.json"))}
    scanned = _try(folder / "scene.json", lambda p: Scene.from_json(p.read_text()))
    scene = _try(folder / "network" / "scene.json", lambda p: Scene.from_json(p.read_text())) or scanned
    if not receipts and scene is None:
        raise InputError(f"{folder}: no run in it (no receipts/, no scene.json); give a folder made by `tiegraph run`")
    world = _world(_json(folder / "world.json"))
    model = read_model(folder, scene, _registered_by(receipts)) if scene is not None else None
    cloud = _try(folder / "cloud.laz", lambda p: read_cloud_sample(p, cloud_points))
    return RunFolder(
        path=folder,
        receipts=receipts,
        scene=scene,
        scanned=scanned or scene,
        network=_try(folder / "network.npz", read_pairs),
        pairs=next(filter(None, (_try(folder / f"{n}.npz", read_pairs) for n in ("filter", "match", "pairs"))), None),
        world=world or None,
        metrics=_json(folder / "metrics.json") or None,
        model=model,
        cloud=_in_world(cloud, model, world),
    )


def _json(path: Path) -> dict:
    found = _try(path, lambda p: json.loads(p.read_text()))
    return found if isinstance(found, dict) else {}


def _world(data: dict) -> dict:
    """world.json under the names the report uses; what it does not know stays as it is."""
    out = dict(data)
    out.setdefault("scale_from", data.get("scale_source"))
    if out.get("shift_m") is None:
        out["shift_m"] = (data.get("origin") or {}).get("shift_m")
    return out if data else {}


def _try(path: Path, read: Callable[[Path], T]) -> T | None:
    """What ``read`` makes of a file; None if it is missing or damaged (then the log says so)."""
    if not path.exists():
        return None
    try:
        return read(path)
    except Exception as error:
        log.warning("report: %s cannot be read and is left out: %s", path, error)
        return None


def read_pairs(path: Path) -> Pairs | None:
    """The pair table of an npz file; None if it holds something else."""
    with np.load(path) as data:
        if not set(Pairs.columns()) <= set(data.files):
            return None
        return Pairs.from_npz(dict(data))


def _registered_by(receipts: dict[str, dict]) -> RegisteredTuning:
    """What the run itself calls registered: its receipt names the constants that differ."""
    said = (receipts.get("sparse", {}).get("tuning") or {}).get("scene") or {}
    try:
        return SceneTuning.model_validate(said).registered
    except ValidationError as error:
        log.warning("report: the constants in the receipt of sparse cannot be read: %s", error)
        return RegisteredTuning()


def read_model(folder: Path, scene: Scene, tuning: RegisteredTuning) -> Model | None:
    """The world model, or the largest of the models if there is none."""
    numbered = sorted((p for p in (folder / "sparse").glob("[0-9]*") if p.is_dir()), key=lambda p: int(p.name))
    parts = [(p, r) for p in numbered if (r := _reconstruction(p)) is not None]
    parts.sort(key=lambda part: -part[1].num_reg_images())
    world = _reconstruction(folder / "sparse" / "world")
    if world is None and not parts:
        return None
    path, chosen = (folder / "sparse" / "world", world) if world is not None else parts[0]
    others = tuple(int(registration(r, scene, tuning).registered.sum()) for _, r in parts[1:])
    images = registration(chosen, scene, tuning)
    return _model_facts(chosen, scene, images, path.relative_to(folder).as_posix(), others)


def _reconstruction(path: Path) -> Any:
    return _try(path, read_reconstruction) if is_model(path) else None


def _model_facts(model: Any, scene: Scene, images: Registration, folder: str, others: tuple[int, ...]) -> Model:
    poses = np.full((len(scene), 4, 4), np.nan)
    sensor_from_rig: dict[int, np.ndarray] = {}
    cameras: dict[int, dict] = {}
    for image in model.images.values():
        k = scene.image_index.get(image.name)
        if k is None or not image.has_pose:
            continue
        poses[k] = transforms.invert(matrix(image.cam_from_world()))
        key = int(scene.sensor_key[k])
        if key not in cameras:
            cameras[key] = _camera_facts(model.cameras[image.camera_id])
        if key not in sensor_from_rig:
            found = _extrinsics(model, image)
            if found is not None:
                sensor_from_rig[key] = found
    return Model(
        folder=folder,
        world_from_camera=poses,
        images=images,
        figures=ModelFigures(
            points=model.num_points3D(),
            reprojection_px=model.compute_mean_reprojection_error(),
            track_length=model.compute_mean_track_length(),
            observations=model.compute_mean_observations_per_reg_image(),
        ),
        cameras=cameras,
        sensor_from_rig=sensor_from_rig,
        sample=_sparse_points(model),
        observed=observed(model, scene),
        others=others,
    )


def _camera_facts(camera: Any) -> dict:
    return {
        "model": camera.model.name,
        "size": f"{camera.width}\u00a0×\u00a0{camera.height}",
        "focal_px": camera.mean_focal_length(),
    }


def _extrinsics(model: Any, image: Any) -> np.ndarray | None:
    rig = model.rigs[image.frame.rig_id]
    if rig.num_sensors() < 2:
        return None
    sensor = image.data_id.sensor_id
    if rig.is_ref_sensor(sensor):
        return np.eye(4)
    return matrix(rig.sensor_from_rig(sensor)) if rig.has_sensor_from_rig(sensor) else None


def _sparse_points(model: Any) -> PointSample:
    ids = list(model.point3D_ids())
    ids = ids[:: max(1, -(-len(ids) // _POINTS))]
    points = [model.points3D[k] for k in ids]
    return PointSample(
        xyz=np.array([p.xyz for p in points], float).reshape(-1, 3),
        rgb=np.array([p.color for p in points], np.uint8).reshape(-1, 3),
    )


def some_of(reader: Any, most: int) -> Iterator[Any]:
    """Every n-th point of an open LAS or LAZ file, chunk by chunk, at most about ``most``."""
    step = max(1, -(-reader.header.point_count // most))
    for chunk in reader.chunk_iterator(1_000_000):
        yield chunk[::step]


def read_cloud_sample(path: Path, most: int) -> CloudSample:
    """Every n-th point of a LAS or LAZ file, at most ``most``, in the file's coordinates."""
    parts: dict[str, list[np.ndarray]] = {n: [] for n in ("xyz", "rgb", "sigma", "views")}
    with laspy.open(path) as reader:
        count = reader.header.point_count
        names = list(reader.header.point_format.dimension_names)
        sigma = next((n for n in names if "sigma" in n.lower()), None)
        views = next((n for n in names if "view" in n.lower() and "angle" not in n.lower()), None)
        for part in some_of(reader, most):
            parts["xyz"].append(np.column_stack([part.x, part.y, part.z]))
            parts["rgb"].append(_colours(part) if "red" in names else np.full((len(part), 3), 160, np.uint8))
            parts["sigma"].append(np.asarray(part[sigma], float) if sigma else np.full(len(part), np.nan))
            parts["views"].append(np.asarray(part[views], float) if views else np.zeros(len(part)))
    empty = {"xyz": np.zeros((0, 3)), "rgb": np.zeros((0, 3), np.uint8), "sigma": np.zeros(0), "views": np.zeros(0)}
    all_ = {n: np.concatenate([empty[n], *p]) for n, p in parts.items()}
    size = path.stat().st_size
    return CloudSample(
        name=path.name,
        count=count,
        bytes=size,
        xyz=all_["xyz"],
        rgb=all_["rgb"].astype(np.uint8),
        sigma_m=all_["sigma"],
        views=all_["views"],
    )


def _in_world(cloud: CloudSample | None, model: Model | None, world: dict) -> CloudSample | None:
    """The cloud with the recorded shift taken off if it was written in full CRS coordinates."""
    shift = np.array(world.get("shift_m") or (0.0, 0.0, 0.0), float)
    if cloud is None or not len(cloud.xyz) or not shift.any():
        return cloud
    middle = np.median(cloud.xyz, axis=0)
    near = np.nanmedian(model.centres, axis=0) if model is not None and model.placed.any() else np.zeros(3)
    if np.linalg.norm(middle - shift - near) < np.linalg.norm(middle - near):
        return replace(cloud, xyz=cloud.xyz - shift)
    return cloud


def _colours(points: Any) -> np.ndarray:
    rgb = np.column_stack([points.red, points.green, points.blue])
    return (rgb >> 8 if rgb.size and rgb.max() > 255 else rgb).astype(np.uint8)
