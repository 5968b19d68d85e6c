"""Depth maps as compressed .npz files: depth (f4), sigma as a share of the depth (f2), views (u1), normal (i1)."""

import zipfile
from pathlib import Path

import numpy as np

from tiegraph.errors import InputError
from tiegraph.scene.atomic import replacing
from tiegraph.scene.results import DepthMap

_KEPT_BITS = 15  # of the mantissa: 3e-5 of the depth, far below any sigma; the rest is noise that does not compress
_FAST = 1  # zlib level: higher ones take three times as long for 5 % less


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
    with (
        replacing(path) as temporary,
        zipfile.ZipFile(temporary, "w", zipfile.ZIP_DEFLATED, compresslevel=_FAST) as archive,
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
    drop = 23 - _KEPT_BITS
    bits = np.ascontiguousarray(depth, np.float32).view(np.uint32)
    rounded = (bits + np.uint32(1 << (drop - 1))) & np.uint32(0xFFFFFFFF << drop & 0xFFFFFFFF)
    return np.where(np.isfinite(depth), rounded.view(np.float32), np.float32(np.nan))


def _normal(stored: np.ndarray) -> np.ndarray:
    normal = stored.astype(np.float32)
    length = np.sqrt(np.square(normal) @ np.ones(3, np.float32))
    return normal / np.where(length > 0, length, np.float32(np.nan))[..., None]
