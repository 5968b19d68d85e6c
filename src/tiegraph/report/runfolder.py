"""The contents of a run folder, as far as they exist: a report of a run that stopped early must work too.

Also observations sampled from a sparse model: distances of its points, size of a pixel, and residuals of
the lens."""

from __future__ import annotations

import json
import logging
from collections.abc import Callable
from dataclasses import dataclass
from functools import cached_property
from pathlib import Path
from typing import Any, TypeVar

import laspy
import numpy as np
from pydantic import ValidationError

from tiegraph.errors import InputError
from tiegraph.geometry import transforms
from tiegraph.geometry.geodesy import Origin
from tiegraph.scene.cloudfile import las_cloud
from tiegraph.scene.colmapmodel import Registration, image_poses, is_model, matrix, registered_images, registration
from tiegraph.scene.colmapmodel import read_model as read_reconstruction
from tiegraph.scene.composed import carries
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.results import Accuracy, Cloud
from tiegraph.scene.scene import Scene
from tiegraph.scene.tuning import RegisteredTuning
from tiegraph.scene.tuning import Tuning as SceneTuning

log = logging.getLogger(__name__)
T = TypeVar("T")

_POINTS = 200_000  # of a sparse model that are drawn

STAGES = (
    "scan", "masks", "preview", "candidates", "coarse", "network", "design", "features", "match", "sparse",
    "georef", "refine", "dense", "cloud", "products", "evaluate", "report",
)  # fmt: skip
_ASKED = 60  # observations of an image
_CELLS = 12  # across the longer side of an image


@dataclass(frozen=True, eq=False)
class LensResiduals:
    """Mean residuals of a camera in the cells of its image, px: middles (K, 2), observed minus computed (K, 2)."""

    size: tuple[int, int]
    at: np.ndarray
    moved: np.ndarray
    observations: int


_Seen = tuple[tuple[int, int], list[tuple[np.ndarray, np.ndarray]]]  # of a camera: size, places and residuals of images


@dataclass(frozen=True, eq=False)
class Model:
    """A sparse model (``reconstruction``: pycolmap's) in ``folder`` of the run, with the scene whose images follow the
    rows of arrays; NaN = not in the model. ``others``: registered images of the further models."""

    folder: str
    reconstruction: Any
    scene: Scene
    world_from_camera: np.ndarray  # (N, 4, 4)
    images: Registration  # which are registered, and which only have a pose by their rig
    others: tuple[int, ...] = ()

    @property
    def centres(self) -> np.ndarray:
        """(N, 3) projection centres."""
        return self.world_from_camera[:, :3, 3]

    @property
    def points(self) -> int:
        """Sparse points."""
        return int(self.reconstruction.num_points3D())

    @cached_property
    def reprojection_px(self) -> float:
        """Mean reprojection error."""
        return float(self.reconstruction.compute_mean_reprojection_error())

    @cached_property
    def gsd(self) -> np.ndarray:
        """(N,) ground sampling distance of the images, in units of the model, at the median distance along the line of
        sight of the points that each sees; NaN where it sees none."""
        return self._observed[0]

    @cached_property
    def lenses(self) -> dict[int, LensResiduals]:
        """By sensor key the residuals of the lens."""
        return {key: _cells(size, found) for key, (size, found) in sorted(self._observed[1].items())}

    @cached_property
    def _observed(self) -> tuple[np.ndarray, dict[int, _Seen]]:
        gsd, out = np.full(len(self.scene), np.nan), dict[int, _Seen]()
        for k, image in registered_images(self.reconstruction, self.scene):
            rows = image.get_observation_point2D_idxs()
            asked = [image.point2D(rows[r]) for r in np.linspace(0, len(rows) - 1, min(len(rows), _ASKED)).astype(int)]
            if not asked:
                continue
            pose, camera = image.cam_from_world().matrix(), self.reconstruction.cameras[image.camera_id]
            points = np.array([self.reconstruction.points3D[p.point3D_id].xyz for p in asked])
            local = points @ pose[:, :3].T + pose[:, 3]
            ahead = local[:, 2] > 0
            if ahead.any():
                gsd[k] = np.median(local[ahead, 2]) / camera.mean_focal_length()
                xy = np.array([p.xy for p in asked])[ahead]
                off = xy - np.asarray(camera.img_from_cam(local[ahead]), float)
                size = camera.width, camera.height
                out.setdefault(int(self.scene.sensor_key[k]), (size, []))[1].append((xy, off))
        return gsd, out

    @cached_property
    def sensors(self) -> dict[int, tuple[Any, np.ndarray | None]]:
        """By sensor key of the scene: the camera, and sensor_from_rig (4, 4) (None: there is no rig of several)."""
        out = {}
        for k, image in registered_images(self.reconstruction, self.scene):
            if int(self.scene.sensor_key[k]) not in out:
                frame, sensor, pose = self.reconstruction.frame(image.frame_id), image.data_id.sensor_id, None
                rig = self.reconstruction.rig(frame.rig_id)
                if rig.num_sensors() > 1 and (rig.is_ref_sensor(sensor) or rig.has_sensor_from_rig(sensor)):
                    pose = np.eye(4) if rig.is_ref_sensor(sensor) else matrix(rig.sensor_from_rig(sensor))
                out[int(self.scene.sensor_key[k])] = self.reconstruction.cameras[image.camera_id], pose
        return out

    @cached_property
    def sample(self) -> tuple[np.ndarray, np.ndarray]:
        """Some of the sparse points: (K, 3) of the model, and their colours (K, 3) u1."""
        ids = list(self.reconstruction.point3D_ids())
        points = [self.reconstruction.points3D[k] for k in ids[:: max(1, -(-len(ids) // _POINTS))]]
        xyz, rgb = np.array([p.xyz for p in points], float), np.array([p.color for p in points], np.uint8)
        return xyz.reshape(-1, 3), rgb.reshape(-1, 3)


@dataclass(frozen=True, eq=False)
class CloudSample:
    """A sample of a point cloud file and values of the whole."""

    count: int
    bytes: int
    xyz: np.ndarray  # (K, 3), world
    rgb: np.ndarray  # (K, 3) u1
    sigma_m: np.ndarray  # (K,), NaN = unknown
    views: np.ndarray  # (K,), 0 = unknown


@dataclass(frozen=True)
class RunFolder:
    """The artefacts of a run; None or empty if a stage has not made them."""

    path: Path
    receipts: dict[str, dict]
    scene: Scene | None = None  # rig checked and sections cut, if `network` has run
    scanned: Scene | None = None  # after the scan: the rig as given
    network: Pairs | None = None
    pairs: Pairs | None = None
    world: dict | None = None
    metrics: dict | None = None
    model: Model | None = None
    cloud: CloudSample | None = None

    def counts(self, stage: str) -> dict[str, Any]:
        """The counts of a stage's receipt."""
        return self.receipts.get(stage, {}).get("counts") or {}

    def notes(self, *stages: str) -> list[str]:
        """The remarks of stages, each once, as the stages wrote them."""
        every = (str(n) for stage in stages for n in self.receipts.get(stage, {}).get("notes") or [])
        return list(dict.fromkeys(every))

    def tables(self, stage: str) -> dict[str, Any]:
        """The tables of a stage's receipt."""
        found = self.receipts.get(stage, {}).get("tables")
        return found if isinstance(found, dict) else {}

    def dropped(self, stage: str) -> list[tuple[str, str]]:
        """(name, reason) of the items that a stage left out."""
        found = self.receipts.get(stage, {}).get("dropped")
        rows = found if isinstance(found, list) else []
        return [(str(r[0]), str(r[1])) for r in rows if isinstance(r, (list, tuple)) and len(r) >= 2]

    @property
    def hanging(self) -> tuple[int, int]:
        """Images without part in structure from motion (``scene.composed``), and those of them that have a pose."""
        return int(self.counts("scan").get("hanging", 0)), int(self.counts("georef").get("hanging", 0))

    @cached_property
    def hung(self) -> tuple[tuple[str, bool], ...]:
        """Names of the images with poses by their rig, and whether each has a pose."""
        whole = _try(self.path / "whole.json", _scene)
        if whole is None or self.scene is None:
            return ()
        nothing = np.zeros(len(self.scene), bool)
        placed = self.model.images.placed if self.model is not None and self.hanging[1] else nothing
        frames = {int(whole.frame[whole.image_index[n]]) for n, has in zip(self.scene.names, placed) if has}
        return tuple((whole.names[k], int(whole.frame[k]) in frames) for k in np.flatnonzero(~carries(whole)))

    def done(self, stage: str) -> bool:
        """Whether a stage has finished."""
        return "key" in self.receipts.get(stage, {})

    @property
    def shift(self) -> np.ndarray:
        """(3,) offset from coordinates of the world to those of the CRS."""
        return np.array((self.world or {}).get("shift_m") or (0.0, 0.0, 0.0), float)

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
    """All data of a report, of the cloud ``cloud_points`` at most (0: no cloud). Raises InputError if the folder has no
    run in it."""
    if not folder.is_dir():
        raise InputError(f"{folder}: no such run folder; give a folder made by `tiegraph run`")
    receipts = {s: r for s in STAGES if (r := _json(folder / "receipts" / f"{s}.json"))}
    scanned = _try(folder / "scene.json", _scene)
    scene = _try(folder / "network" / "scene.json", _scene) or scanned
    if not receipts and scene is None:
        raise InputError(f"{folder}: no run in it (no receipts/, no scene.json); give a folder made by `tiegraph run`")
    world = _json(folder / "world.json")
    if world:
        world = {"scale_from": world.get("scale_source"), **world}
        world["shift_m"] = world.get("shift_m") or (world.get("origin") or {}).get("shift_m")
    origin = None if not world or not world.get("origin") else Origin.from_dict(world["origin"])
    return RunFolder(
        path=folder,
        receipts=receipts,
        scene=scene,
        scanned=scanned or scene,
        network=_try(folder / "network.npz", read_pairs),
        pairs=next(filter(None, (_try(folder / f"{n}.npz", read_pairs) for n in ("match", "pairs"))), None),
        world=world or None,
        metrics=_json(folder / "metrics.json") or None,
        model=None if scene is None else read_model(folder, scene, _registered_by(receipts)),
        cloud=_try(folder / "cloud.laz", lambda p: read_cloud_sample(p, cloud_points, origin)),
    )


def _scene(path: Path) -> Scene:
    return Scene.from_json(path.read_text())


def _json(path: Path) -> dict:
    found = _try(path, lambda p: json.loads(p.read_text()))
    return found if isinstance(found, dict) else {}


def _try(path: Path, read: Callable[[Path], T]) -> T | None:
    """The result of ``read`` for a file; None if it is missing or damaged (with a line in the log)."""
    if not path.exists():
        return None
    try:
        return read(path)
    except Exception as error:
        log.warning("report: %s cannot be read and is left out: %s", path, error)
        return None


def read_pairs(path: Path) -> Pairs | None:
    """The pair table of an npz file; None for other contents."""
    with np.load(path) as data:
        return Pairs.from_npz(dict(data)) if set(Pairs.columns()) <= set(data.files) else None


def _registered_by(receipts: dict[str, dict]) -> RegisteredTuning:
    """The run's own definition of registered: its receipt names the constants that differ."""
    said = (receipts.get("sparse", {}).get("tuning") or {}).get("scene") or {}
    try:
        return SceneTuning.model_validate(said).registered
    except ValidationError as error:
        log.warning("report: the constants in the receipt of sparse cannot be read: %s", error)
        return RegisteredTuning()


def read_model(folder: Path, scene: Scene, tuning: RegisteredTuning) -> Model | None:
    """The world model, or the largest of the models if there is none."""

    def read(path: Path) -> Any:
        return _try(path, read_reconstruction) if is_model(path) else None

    numbered = sorted((p for p in (folder / "sparse").glob("[0-9]*") if p.is_dir()), key=lambda p: int(p.name))
    parts = [(p, r) for p in numbered if (r := read(p)) is not None]
    parts.sort(key=lambda part: -part[1].num_reg_images())
    world = read(folder / "sparse" / "world")
    if world is None and not parts:
        return None
    path, chosen = (folder / "sparse" / "world", world) if world is not None else parts[0]
    return Model(
        folder=path.relative_to(folder).as_posix(),
        reconstruction=chosen,
        scene=scene,
        world_from_camera=transforms.invert(image_poses(chosen, scene)),
        images=registration(chosen, scene, tuning),
        others=tuple(int(registration(r, scene, tuning).registered.sum()) for _, r in parts[1:]),
    )


def read_cloud_sample(path: Path, most: int, origin: Origin | None) -> CloudSample | None:
    """Every n-th point of a LAS or LAZ file, at most ``most``, in the world of an origin; None if none is asked for."""
    if most < 1:
        return None
    with laspy.open(path) as reader:
        count = reader.header.point_count
        every = max(1, -(-count // most))
        chunks = (las_cloud(chunk[::every], reader.header, origin) for chunk in reader.chunk_iterator(1_000_000))
        parts = [Cloud.empty(), *chunks]
    xyz, rgb, sigma, views = (
        np.concatenate([getattr(part, column) for part in parts]) for column in ("xyz_m", "rgb", "sigma_m", "views")
    )
    return CloudSample(count, path.stat().st_size, xyz=xyz, rgb=rgb, sigma_m=sigma.astype(float), views=views)


def _cells(size: tuple[int, int], found: list[tuple[np.ndarray, np.ndarray]]) -> LensResiduals:
    """Mean residuals cell by cell; each is clipped to the middle nine tenths: one wrong match outweighs many."""
    xy, off = (np.concatenate(parts) for parts in zip(*found))
    good = np.isfinite(off).all(axis=1)
    xy, off = xy[good], off[good]
    off = np.clip(off, *np.quantile(off, [0.05, 0.95], axis=0)) if len(off) else off
    side = max(size) / _CELLS
    cell, of, count = np.unique((xy // side).astype(int), axis=0, return_inverse=True, return_counts=True)
    mean = np.column_stack([np.bincount(of.ravel(), off[:, c], len(cell)) for c in range(2)]) / count[:, None]
    enough = count >= 5  # a cell with fewer residuals is ignored
    return LensResiduals(size=size, at=((cell + 0.5) * side)[enough], moved=mean[enough], observations=len(xy))
