"""Results of the later stages: depth maps, clouds, metrics, the accuracy of a run, and their files.

Depth maps are compressed .npz: depth (f4), sigma as a share of the depth (f2), views (u1), normal (i1).

The accuracy has three layers, and is the one source of all accuracies in terminal, report, cloud and tables. *In the
world*: absolute, with the controlling observations. *In shape*: of the whole and of its parts relative to each other,
wherever it lies. *Of a point*: of a point of the cloud against its neighbours. Each is predicted (one standard
deviation) and, if a reference exists, measured (root mean square unless stated otherwise); the length of the
difference, not one axis. Only ``evaluate`` computes it; ``metrics.json`` contains it, under ``accuracy``.
"""

from __future__ import annotations

import base64
import io
import json
import math
import warnings
import zipfile
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass, field, replace
from html import escape
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pycolmap

from tiegraph.errors import InputError
from tiegraph.geometry import transforms
from tiegraph.geometry.geodesy import Origin
from tiegraph.scene.atomic import replacing
from tiegraph.scene.sorting import Columns
from tiegraph.text import finite

APART_SIGMAS = 3.0  # depths and heights that differ by more of their standard deviations are of two surfaces


@dataclass(frozen=True, repr=False)
class DepthMap:
    """Depth along the optical axis of one undistorted image.

    depth_m (H, W) f4, NaN = none; sigma_m (H, W) f4 one standard deviation of the depth; views (H, W) u1 number of
    images that agree (the reference counts); normal (H, W, 3) f4 in the camera frame, NaN = none; K (3, 3) and
    cam_from_world (4, 4) of the undistorted image. Lengths in world units (metres once georeferenced). support (H, W)
    u1: bit k = the k-th partner image agreed (until depth maps are compared), None = not recorded. sigma_px: standard
    deviation of one disparity, from which sigma_m follows.
    """

    image: str
    depth_m: np.ndarray
    sigma_m: np.ndarray
    views: np.ndarray
    K: np.ndarray
    cam_from_world: np.ndarray
    normal: np.ndarray | None = None
    support: np.ndarray | None = None
    sigma_px: float = 0.3

    def __repr__(self) -> str:
        known = np.isfinite(self.depth_m)
        height, width = known.shape
        said = f"DepthMap({self.image}: {width} x {height} pixels, {known.mean():.0%} with a depth"
        if not known.any():
            return said + ")"
        depth, sigma = (float(np.median(v[known])) for v in (self.depth_m, self.sigma_m))
        return f"{said}, median {depth:.3g}, its sigma {sigma:.2g})"

    def _repr_html_(self) -> str:
        return picture(repr(self), depth_colours(self.depth_m))


@dataclass(frozen=True, repr=False)
class Cloud(Columns):
    """M points: xyz_m (M, 3) f8 world, rgb (M, 3) u1, normal (M, 3) f4, sigma_m (M,) f4, views (M,) u1."""

    xyz_m: np.ndarray
    rgb: np.ndarray
    normal: np.ndarray
    sigma_m: np.ndarray
    views: np.ndarray
    origin: Origin | None = None

    def __repr__(self) -> str:
        if not len(self):
            return "Cloud(no point)"
        size = " x ".join(f"{v:.3g}" for v in np.ptp(self.xyz_m, axis=0))
        return f"Cloud({len(self)} points, {size}, median sigma {np.median(self.sigma_m):.2g})"

    def _repr_html_(self) -> str:
        return picture(repr(self), cloud_from_above(self.xyz_m, self.rgb)) if len(self) else repr(self)

    def moved(self, pose: np.ndarray) -> Cloud:
        """The points and their normals by a rigid motion (4, 4)."""
        normal = (self.normal @ pose[:3, :3].T).astype(np.float32)
        return replace(self, xyz_m=transforms.apply(pose, self.xyz_m), normal=normal)

    @staticmethod
    def empty(origin: Origin | None = None) -> Cloud:
        """No points."""
        return Cloud(
            xyz_m=np.zeros((0, 3)),
            rgb=np.zeros((0, 3), np.uint8),
            normal=np.zeros((0, 3), np.float32),
            sigma_m=np.zeros(0, np.float32),
            views=np.zeros(0, np.uint8),
            origin=origin,
        )


class Model(pycolmap.Reconstruction):
    """COLMAP's model; a notebook shows its points from above, and the cameras in red."""

    def _repr_html_(self) -> str:
        cameras = [image.projection_center() for image in self.images.values() if image.has_pose]
        points = list(self.points3D.values())
        xyz = np.array([*(p.xyz for p in points), *cameras])
        colours = np.array([*(p.color for p in points), *[(255, 0, 0)] * len(cameras)], np.uint8)
        return picture(repr(self), cloud_from_above(xyz, colours)) if len(xyz) else repr(self)


@dataclass(frozen=True)
class Metric:
    """One figure of merit with its unit; ``better`` is "low" or "high"; NaN target = none set."""

    name: str
    value: float
    unit: str
    better: str = "low"
    target: float = float("nan")


def row_strips(shape: tuple[int, ...], pixels: int = 1 << 18) -> list[slice]:
    """Rows of an image (height, width) in order, about ``pixels`` at a time; at least one row."""
    height, width = shape
    rows = max(1, pixels // width)
    return [slice(top, min(top + rows, height)) for top in range(0, height, rows)]


def border_share(mask: np.ndarray, size: tuple[int, int]) -> np.ndarray:
    """How far the pixels of an image are from its border and its mask (H, W) bool, True = use, as a share of its
    shorter side: (height, width) f4 of the image at ``size`` (width, height), 0 = masked."""
    usable = cv2.resize(mask.astype(np.float32), size, interpolation=cv2.INTER_AREA) > 0.999
    away = cv2.distanceTransform(np.pad(usable.astype(np.uint8), 1), cv2.DIST_L2, cv2.DIST_MASK_PRECISE)
    return away[1:-1, 1:-1] / min(size)


def metrics_to_dict(
    metrics: Iterable[Metric],
    tables: dict[str, dict] | None = None,
    notes: Iterable[str] = (),
    contradictions: Iterable[str] = (),
    accuracy: Accuracy | None = None,
) -> dict[str, Any]:
    """{"accuracy": the layers, "metrics": [{name, value, unit, better, target}], "tables", "notes", "contradictions"}.

    NaN and infinity as null.
    """
    rows = finite([asdict(m) for m in metrics])
    clean = {n: {**t, "rows": finite(t["rows"])} for n, t in (tables or {}).items()}
    said = {} if accuracy is None else {"accuracy": accuracy.to_dict()}
    return {**said, "metrics": rows, "tables": clean, "notes": list(notes), "contradictions": list(contradictions)}


def read_metrics(path: Path) -> tuple[Accuracy, dict[str, Metric]]:
    """``metrics.json``: the layers, and the metrics by name, NaN where it has null."""
    data, unknown = json.loads(path.read_text(encoding="utf-8")), {"value": NAN, "target": NAN}
    rows: list[dict[str, Any]] = [unknown | {k: v for k, v in m.items() if v is not None} for m in data["metrics"]]
    return Accuracy.from_dict(data["accuracy"]), {row["name"]: Metric(**row) for row in rows}


def save_depth(depth: DepthMap, path: Path) -> None:
    """Write one depth map; the file appears whole or not at all. Raises TiegraphError when the disk is full."""
    known = np.isfinite(depth.depth_m)
    columns: dict[str, np.ndarray] = {
        "image": np.array(depth.image),
        "depth_m": _rounded(depth.depth_m),
        "relative_sigma": np.where(known, depth.sigma_m / np.where(known, depth.depth_m, 1), np.nan).astype(np.float16),
        "views": depth.views,
        "sigma_px": np.asarray(depth.sigma_px, np.float32),
        "K": depth.K,
        "cam_from_world": depth.cam_from_world,
    }
    if depth.normal is not None:
        finite = np.all(np.isfinite(depth.normal), axis=-1)
        scaled = np.rint(np.where(finite[..., None], depth.normal, 0) * 127)
        columns["normal"] = scaled.astype(np.int8)
    if depth.support is not None:
        columns["support"] = depth.support
    save_columns(path, columns)


def save_columns(path: Path, columns: Mapping[str, np.ndarray]) -> None:
    """Write a compressed NPZ, whole or not at all. Higher levels take three times as long for 5 % less."""
    with (
        replacing(path) as temporary,
        zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED, compresslevel=1) as archive,
    ):
        for name, values in columns.items():
            with archive.open(f"{name}.npy", "w", force_zip64=True) as stream:
                np.lib.format.write_array(stream, np.asarray(values, order="C"), allow_pickle=False)


def load_depth(path: Path) -> DepthMap:
    """Read one depth map. Raises InputError for a file that is not one."""
    try:
        with np.load(path) as file:
            data = {name: file[name] for name in file.files}
        depth = data["depth_m"]
        normal = _normal(data["normal"]) if "normal" in data else None
        return DepthMap(
            image=str(data["image"]),
            depth_m=depth,
            sigma_m=(data["relative_sigma"].astype(np.float32) * depth).astype(np.float32),
            views=data["views"],
            K=data["K"],
            cam_from_world=data["cam_from_world"],
            normal=normal,
            support=data.get("support"),
            sigma_px=float(data.get("sigma_px", DepthMap.sigma_px)),
        )
    except (OSError, ValueError, KeyError, zipfile.BadZipFile) as error:
        raise InputError(f"{path} is not a depth map: remove it and run the dense stage again ({error})") from None


def _rounded(depth: np.ndarray) -> np.ndarray:
    drop = 23 - 15  # bits of the mantissa stay: 3e-5 of the depth, far below any sigma; the rest does not compress
    bits = np.ascontiguousarray(depth, np.float32).view(np.uint32)
    rounded = (bits + np.uint32(1 << (drop - 1))) & np.uint32(0xFFFFFFFF << drop & 0xFFFFFFFF)
    return np.where(np.isfinite(depth), rounded.view(np.float32), np.float32(np.nan))


def _normal(stored: np.ndarray) -> np.ndarray:
    normal = stored.astype(np.float32)
    length = np.sqrt(np.square(normal) @ np.ones(3, np.float32))
    return normal / np.where(length > 0, length, np.float32(np.nan))[..., None]


NAN = float("nan")
LAYERS = {"world": "in the world", "shape": "in shape", "point": "of a point"}
"""Key of a layer -> its name, in the order of presentation."""
PREDICTED, MEASURED, RATIO = "predicted", "measured", "ratio"


@dataclass(frozen=True)
class Figure:
    """One accuracy, in the unit of its ``Accuracy``; NaN = not known.

    ``predicted``: a standard deviation of what ``measured`` is, so that their ratio is about 1. ``independent``: the
    reference was not used in the run.
    """

    key: str  # begins with its layer
    of: str
    predicted: float = NAN
    measured: float = NAN
    by: str = ""  # the reference it is measured by
    independent: bool = False
    proves_not: str = ""

    @property
    def layer(self) -> str:
        """Key of its layer."""
        return self.key.partition(".")[0]

    @property
    def ratio(self) -> float:
        """Measured / predicted; NaN without both."""
        return self.measured / self.predicted if self.predicted > 0 else NAN


@dataclass(frozen=True)
class Answer:
    """Whether a tolerance is held: ``said`` is "yes", "no" or "cannot be told"; why, and what would make it yes."""

    tolerance_m: float
    said: str
    why: str
    remedy: str = ""


@dataclass(frozen=True)
class Accuracy:
    """All of it. ``unit`` is m, or "units" if the scale is unknown; ``held_by``: its control in the world;
    ``placement``: sigmas of the model as a whole (position_m, height_m, yaw_deg, tilt_deg, scale), {} = none."""

    unit: str
    held_by: str
    figures: tuple[Figure, ...]
    placement: Mapping[str, float] = field(default_factory=dict)
    answer: Answer | None = None

    def of(self, layer: str) -> list[Figure]:
        """The figures of a layer."""
        return [f for f in self.figures if f.layer == layer]

    def head(self, layer: str) -> Figure:
        """The representative figure of a layer: of a point in the world, of the shape as a whole, of a point."""
        return self.figure("shape.whole" if layer == "shape" else layer)

    def figure(self, key: str) -> Figure:
        """A figure by its key; one without values if there is none."""
        return next((f for f in self.figures if f.key == key), Figure(key=key, of=""))

    def values(self) -> dict[str, float]:
        """All values for presentation, by full key: "world.check_points.measured", "placement.tilt_deg"."""
        out = {f"{f.key}.{what}": getattr(f, what) for f in self.figures for what in (PREDICTED, MEASURED, RATIO)}
        out |= {f"placement.{name}": value for name, value in self.placement.items()}
        if self.answer is not None:
            out["tolerance"] = self.answer.tolerance_m
        return {key: value for key, value in out.items() if math.isfinite(value)}

    def to_dict(self) -> dict[str, Any]:
        """JSON-ready; NaN as null. The ratio is beside the values."""
        figures = [finite({**asdict(f), RATIO: f.ratio}) for f in self.figures]
        out = {"unit": self.unit, "held_by": self.held_by, "figures": figures, "placement": dict(self.placement)}
        return {**out, "tolerance": None if self.answer is None else asdict(self.answer)}

    @staticmethod
    def from_dict(data: Mapping[str, Any]) -> Accuracy:
        """Inverse of ``to_dict``."""
        rows: list[dict[str, Any]]
        rows = [{k: NAN if v is None else v for k, v in row.items() if k != RATIO} for row in data["figures"]]
        answer = data.get("tolerance")
        return Accuracy(
            unit=data["unit"],
            held_by=data["held_by"],
            figures=tuple(Figure(**row) for row in rows),
            placement=data.get("placement") or {},
            answer=None if answer is None else Answer(**answer),
        )


def png(figure: Any) -> bytes:
    """A figure of matplotlib as PNG. Names of folders and cameras are not parsed as formulas (``$\\frac{`` would be an
    error), and letters that the font lacks are boxes without a warning for each."""
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.text import Text

    for text in figure.findobj(Text):
        text.set_parse_math(False)
    out = io.BytesIO()
    with matplotlib.rc_context({"text.parse_math": False}), warnings.catch_warnings():  # ticks are made when drawn
        warnings.filterwarnings("ignore", message="Glyph .* missing")
        FigureCanvasAgg(figure).print_png(out)
    return out.getvalue()


_SIDE_PX = 400


def table(said: str, rows: Iterable[Sequence[Any]]) -> str:
    """A heading and rows of cells."""
    lines = "".join(f"<tr>{''.join(f'<td>{escape(str(cell))}</td>' for cell in row)}</tr>" for row in rows)
    return f"<p>{escape(said)}</p><table>{lines}</table>"


def picture(said: str, bgr: np.ndarray) -> str:
    """A heading and an image (H, W, 3) u1."""
    data = base64.b64encode(cv2.imencode(".png", bgr)[1].tobytes()).decode()
    return f'<p>{escape(said)}</p><img src="data:image/png;base64,{data}">'


def depth_colours(depth: np.ndarray) -> np.ndarray:
    """(h, w, 3) u1 BGR of a depth map (H, W): near is bright, by inverse depth; grey = none."""
    scale = min(1.0, _SIDE_PX / max(depth.shape))
    size = (max(1, round(depth.shape[1] * scale)), max(1, round(depth.shape[0] * scale)))
    inverse = cv2.resize((1 / depth).astype(np.float32), size, interpolation=cv2.INTER_NEAREST)
    known = np.isfinite(inverse)
    low, high = np.percentile(inverse[known], (2, 98)) if known.any() else (0.0, 1.0)
    share = np.clip((np.where(known, inverse, low) - low) / max(high - low, 1e-12), 0, 1)
    colours = cv2.applyColorMap((255 * share).astype(np.uint8), cv2.COLORMAP_VIRIDIS)
    return np.where(known[..., None], colours, np.uint8(160))


def cloud_from_above(xyz: np.ndarray, rgb: np.ndarray) -> np.ndarray:
    """(h, w, 3) u1 BGR of points (M, 3) and their colours (M, 3) RGB seen against the third axis; white = no point."""
    low, high = np.percentile(xyz[:, :2], (0.5, 99.5), axis=0)
    pixel = max(float(np.max(high - low)) / _SIDE_PX, 1e-12)
    width, height = (np.ceil((high - low) / pixel).astype(int) + 1).tolist()
    column, row = np.floor((xyz[:, :2] - low) / pixel).astype(int).T
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    order = np.flatnonzero(inside)[np.argsort(xyz[inside, 2], kind="stable")]  # the highest last
    out = np.full((height, width, 3), 255, np.uint8)
    out[height - 1 - row[order], column[order]] = rgb[order, ::-1]
    return out
