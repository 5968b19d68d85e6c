"""Results of the later stages: depth maps, clouds, metrics, and their files.

Depth maps are compressed .npz: depth (f4), sigma as a share of the depth (f2), views (u1), normal (i1).
"""

from __future__ import annotations

import zipfile
from collections.abc import Iterable
from dataclasses import asdict, dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np

from tiegraph.errors import InputError
from tiegraph.geometry import transforms
from tiegraph.geometry.geodesy import Origin
from tiegraph.scene.accuracy import Accuracy
from tiegraph.scene.atomic import replacing
from tiegraph.scene.notebook import cloud_from_above, depth_colours, picture
from tiegraph.scene.sorting import Columns
from tiegraph.text import finite


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


@dataclass(frozen=True)
class Metric:
    """One figure of merit with its unit; ``better`` is "low" or "high"; NaN target = none set."""

    name: str
    value: float
    unit: str
    better: str
    target: float = float("nan")


def row_strips(shape: tuple[int, ...], pixels: int = 1 << 18) -> list[slice]:
    """Rows of an image (height, width) in order, about ``pixels`` at a time; at least one row."""
    height, width = shape
    rows = max(1, pixels // width)
    return [slice(top, min(top + rows, height)) for top in range(0, height, rows)]


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
    # Higher levels take three times as long for 5 % less.
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
