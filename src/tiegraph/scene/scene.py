"""The survey as a table: images, their frames with places and times, the rigs and passes."""

import json
from dataclasses import dataclass, replace
from functools import cached_property
from typing import Any

import numpy as np

from tiegraph.geometry.geodesy import Origin
from tiegraph.scene.names import check_name
from tiegraph.scene.results import table
from tiegraph.scene.rig import Rig, Sensor, rig_from_dict, rig_to_dict
from tiegraph.scene.sorting import freeze


@dataclass(frozen=True)
class Dropped:
    """A file that was found and left out, with the reason."""

    name: str
    reason: str


@dataclass(frozen=True)
class Scene:
    """N images in F frames of one or more rigs. Arrays are read-only columns; images are sorted by name."""

    rigs: tuple[Rig, ...]
    names: tuple[str, ...]  # N image names, POSIX paths below images/
    frame: np.ndarray  # (N,) i4: frame of an image
    sensor: np.ndarray  # (N,) i2: sensor of an image, index into its rig's sensors
    rig: np.ndarray  # (F,) i2: rig of a frame
    sequence: np.ndarray  # (F,) i2: pass of a frame, index into sequences; -1 = loose (no order)
    sequence_index: np.ndarray  # (F,) i4: order on the pass
    time_s: np.ndarray  # (F,) f8, NaN = unknown
    world_from_rig: np.ndarray  # (F, 4, 4) f8 prior pose; NaN = unknown; the rotation alone may be NaN (GNSS)
    position_sigma_m: np.ndarray  # (F, 3) f8 of the prior position (east, north, up), NaN = no prior
    section: np.ndarray  # (F,) i2, -1 = not cut into sections
    sequences: tuple[str, ...] = ()  # names of the passes
    origin: Origin | None = None  # None: the world is not on the Earth
    # Where the prior poses come from: "none"; "gnss", positions of the antenna, with a trajectory also rotations;
    # "exif", positions written by the camera; "trajectory", poses of the rig, all in one frame; "odometry", poses of
    # the rig, each pass in a frame of its own: never compare them between passes.
    prior: str = "none"
    started: bool = False  # rotations, and positions without a sigma, are those of a start model: never measured
    dropped: tuple[Dropped, ...] = ()
    notes: tuple[str, ...] = ()  # guesses and oddities, for people
    guessed: tuple[str, ...] = ()  # passes whose order only names or times suggest: the network tests the images
    sources: tuple[str, ...] = ()  # N file names below the user's folder where they differ from names, else empty
    exposure: np.ndarray | None = None  # (N,) f8: time in s x ISO / (f-number squared) by EXIF, NaN = unknown

    def __post_init__(self) -> None:
        freeze(self, _COLUMNS if self.exposure is None else {**_COLUMNS, "exposure": np.float64})

    def __len__(self) -> int:
        return len(self.names)

    def __repr__(self) -> str:
        numbers = f"{len(self)} images in {self.frames} frames, {len(self.sequences)} passes"
        return f"Scene({numbers}, {len(self.rigs)} rigs of {len(self.all_sensors)} cameras)"

    def _repr_html_(self) -> str:
        placed = np.isfinite(self.world_from_rig[:, :3, 3]).all(axis=1)
        passes = [*enumerate(self.sequences), (-1, "loose photographs")]
        frames = [(name, own) for k, name in passes if (own := self.sequence == k).any()]
        rows = [(name, own.sum(), own[self.frame].sum(), (own & placed).sum()) for name, own in frames]
        return table(repr(self), [("pass", "frames", "images", "frames with a position"), *rows])

    @property
    def frames(self) -> int:
        """Number of frames."""
        return len(self.rig)

    def in_order(self, chosen: np.ndarray) -> np.ndarray:
        """(K,) frames of a mask (F,) in the order of their sequence indices."""
        own = np.flatnonzero(chosen)
        return own[np.argsort(self.sequence_index[own], kind="stable")]

    @cached_property
    def image_index(self) -> dict[str, int]:
        """Index of an image by name."""
        return {name: k for k, name in enumerate(self.names)}

    @cached_property
    def frame_names(self) -> tuple[str, ...]:
        """The name of each frame (F) for people: that of its first image."""
        first = np.unique(self.frame, return_index=True)[1]
        return tuple(self.names[k] for k in first)

    @cached_property
    def sensor_key(self) -> np.ndarray:
        """(N,) i4: one number for each sensor over all rigs, in the order of ``all_sensors``."""
        start = np.cumsum([0] + [len(r.sensors) for r in self.rigs])[:-1]
        return (start[self.rig[self.frame]] + self.sensor).astype(np.int32)

    def first_sensor(self, rig: int) -> int:
        """Key of the first sensor of a rig."""
        return sum(len(r.sensors) for r in self.rigs[:rig])

    @property
    def keyed_rigs(self) -> list[tuple[int, Rig]]:
        """The rigs, each with the key of its first sensor."""
        return [(self.first_sensor(k), rig) for k, rig in enumerate(self.rigs)]

    @property
    def all_sensors(self) -> tuple[Sensor, ...]:
        """The sensors of all rigs, one after another."""
        return tuple(s for r in self.rigs for s in r.sensors)

    @property
    def focal_px(self) -> np.ndarray:
        """(N,) focal length of each image's camera, pixels; NaN where there is none."""
        own = [np.nan if s.camera is None else s.camera.mean_focal_length() for s in self.all_sensors]
        return np.array(own, float)[self.sensor_key]

    def sensor_of(self, image: int) -> Sensor:
        """The sensor that took an image."""
        return self.rigs[self.rig[self.frame[image]]].sensors[self.sensor[image]]

    def image_label(self) -> list[tuple[str, str]]:
        """(pass, sensor) names of each image, for tables."""
        sequences = [self.sequences[t] if t >= 0 else "" for t in self.sequence[self.frame]]
        return [(t, self.sensor_of(k).name) for k, t in enumerate(sequences)]

    def source_name(self, image: int) -> str:
        """File of an image below the folder the user gave."""
        return self.sources[image] if self.sources else self.names[image]

    def mask_name(self, image: int) -> str:
        """Name of an image in a folder of the user's masks: of its file, or its own if a file has several views."""
        source = self.sensor_of(image).source
        return self.names[image] if source is not None and source.rendered else self.source_name(image)

    def has_positions(self) -> bool:
        """Whether any frame has a prior position."""
        return bool(np.isfinite(self.world_from_rig[:, :3, 3]).all(axis=1).any())

    def has_orientations(self) -> bool:
        """Whether any frame has a full prior pose."""
        return bool(np.isfinite(self.world_from_rig[:, :3]).all(axis=(1, 2)).any())

    def pose_world(self) -> np.ndarray:
        """(F,) i4: prior poses of frames with the same number may be compared; -1 = no prior position."""
        world = np.where(self.prior == "odometry", self.sequence, 0)
        return np.where(np.isfinite(self.world_from_rig[:, :3, 3]).all(axis=1), world, -1).astype(np.int32)

    def measured_positions(self) -> np.ndarray:
        """(F,) bool: frames with a measured prior position, which may constrain or test a model.

        Not among them: positions carried over a GNSS gap by a trajectory (sigma NaN), odometry with its own world
        for each pass, and those of a start model, whose unit may be any.
        """
        there = np.all(np.isfinite(self.world_from_rig[:, :3, 3]), axis=1)
        if self.prior in ("gnss", "exif"):
            return there & np.all(np.isfinite(self.position_sigma_m), axis=1)
        return there & (self.prior == "trajectory" and not self.started)

    def metric_positions(self) -> bool:
        """Whether the prior positions are in metres: not those of a start model alone."""
        return not (self.prior == "trajectory" and self.started)

    def measured(self) -> "Scene":
        """This scene with only the measured prior positions and orientations, which may constrain and test a
        model."""
        keep = self.measured_positions()
        pose = np.array(self.world_from_rig)
        pose[~keep, :3, 3] = np.nan
        if self.started:
            pose[:, :3, :3] = np.nan
        sigma = np.where(keep[:, None], self.position_sigma_m, np.nan)
        return replace(self, world_from_rig=pose, position_sigma_m=sigma)

    def of_role(self, role: str) -> np.ndarray:
        """(N,) bool: images of cameras with this role in their rig."""
        return np.array([s.role == role for s in self.all_sensors], bool)[self.sensor_key]

    def image_priors(self) -> np.ndarray:
        """(N, 4, 4) world_from_sensor by prior pose and rig extrinsics, NaN where either is unknown."""
        poses = [s.sensor_from_rig for s in self.all_sensors]
        rig_from_sensor = np.array([np.full((4, 4), np.nan) if p is None else np.linalg.inv(p) for p in poses])
        return self.world_from_rig[self.frame] @ rig_from_sensor[self.sensor_key]

    def with_(self, **changes: Any) -> "Scene":
        """A copy with some fields replaced."""
        return replace(self, **changes)

    def only(self, images: np.ndarray) -> "Scene":
        """A scene of some images (K,), increasing, and their frames; rigs and passes keep their numbers."""
        frames, frame = np.unique(self.frame[images], return_inverse=True)
        of_frames = (name for name in _COLUMNS if name not in ("frame", "sensor"))
        columns: dict[str, Any] = {name: getattr(self, name)[frames] for name in of_frames}
        names, sources = (tuple(column[k] for k in images) if column else () for column in (self.names, self.sources))
        columns["exposure"] = None if self.exposure is None else self.exposure[images]
        return replace(self, names=names, sources=sources, frame=frame, sensor=self.sensor[images], **columns)

    def to_json(self) -> str:
        """Text of scene.json; NaN becomes null."""
        columns = {name: _listed(getattr(self, name)) for name in _COLUMNS}
        head = {
            "format": 2,
            "rigs": [rig_to_dict(r) for r in self.rigs],
            "origin": None if self.origin is None else self.origin.to_dict(),
            "dropped": [[d.name, d.reason] for d in self.dropped],
            **{name: getattr(self, name) for name in _PLAIN},
        }
        if self.exposure is not None:
            columns["exposure"] = _listed(self.exposure)
        return json.dumps({**head, **columns}, allow_nan=False)

    @staticmethod
    def from_json(text: str) -> "Scene":
        """Inverse of ``to_json``. Raises InputError for an image name that leads out of the folder."""
        data = json.loads(text)
        for name in data["names"]:
            check_name(name)
        columns: dict[str, Any] = {name: np.array(data[name], dtype=float) for name in _COLUMNS}
        columns["exposure"] = np.array(data["exposure"], float) if "exposure" in data else None
        columns["world_from_rig"] = columns["world_from_rig"].reshape(-1, 4, 4)
        columns["position_sigma_m"] = columns["position_sigma_m"].reshape(-1, 3)
        plain: dict[str, Any] = {n: tuple(v) if isinstance(v := data[n], list) else v for n in _PLAIN}
        return Scene(
            rigs=tuple(rig_from_dict(r) for r in data["rigs"]),
            origin=None if data["origin"] is None else Origin.from_dict(data["origin"]),
            dropped=tuple(Dropped(*d) for d in data["dropped"]),
            **plain,
            **columns,
        )


_PLAIN = ("prior", "started", "notes", "names", "sources", "sequences", "guessed")
_COLUMNS = {
    "frame": np.int32,
    "sensor": np.int16,
    "rig": np.int16,
    "sequence": np.int16,
    "sequence_index": np.int32,
    "time_s": np.float64,
    "world_from_rig": np.float64,
    "position_sigma_m": np.float64,
    "section": np.int16,
}


def _listed(array: np.ndarray) -> list:
    if array.dtype.kind != "f":
        return array.tolist()
    out = array.astype(object)
    out[~np.isfinite(array)] = None
    return out.tolist()


def simple_scene(
    rig: Rig,
    names: list[str],
    frame: np.ndarray,
    sensor: np.ndarray,
    sequence: np.ndarray | None = None,
    sequence_index: np.ndarray | None = None,
    **more: Any,
) -> Scene:
    """A scene of one rig with unknown poses; for loose photographs omit sequence and sequence_index."""
    frames = int(np.max(frame)) + 1 if len(names) else 0
    columns: dict[str, Any] = {
        "rig": np.zeros(frames),
        "sequence": np.full(frames, -1) if sequence is None else sequence,
        "sequence_index": np.arange(frames) if sequence_index is None else sequence_index,
        "time_s": np.full(frames, np.nan),
        "world_from_rig": np.full((frames, 4, 4), np.nan),
        "position_sigma_m": np.full((frames, 3), np.nan),
        "section": np.full(frames, -1),
    }
    columns.update(more)
    return Scene(rigs=(rig,), names=tuple(names), frame=frame, sensor=sensor, **columns)


def between_neighbours(positions: np.ndarray, scene: Scene) -> np.ndarray:
    """Positions (F, C) of the frames; those without one (NaN) are interpolated between their neighbours on the pass,
    evenly by number. Beyond the known ends of a pass they stay unknown."""
    out = positions.copy()
    for number in np.unique(scene.sequence[scene.sequence >= 0]):
        own = scene.in_order(scene.sequence == number)
        known = np.flatnonzero(np.isfinite(positions[own]).all(axis=1))
        if len(known) > 1:
            inside = np.arange(known[0], known[-1] + 1)
            for c in range(positions.shape[1]):
                out[own[inside], c] = np.interp(inside, known, positions[own[known], c])
    return out


def of_frames(centre: np.ndarray, scene: Scene) -> np.ndarray:
    """(F, 3) position of each frame: of its first image with a centre (N, 3); NaN = none has."""
    out = np.full((scene.frames, 3), np.nan)
    known = np.flatnonzero(np.isfinite(centre).all(axis=1))
    frames, first = np.unique(scene.frame[known], return_index=True)
    out[frames] = centre[known[first]]
    return out
