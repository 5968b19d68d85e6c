"""`tiegraph doctor`: what this machine and this installation have, and what to do about what is missing."""

import os
import shutil
import tempfile
from collections.abc import Callable, Iterator
from dataclasses import dataclass
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

import psutil
import pycolmap
import pyproj
import pyproj.network

from tiegraph.cli.output import say
from tiegraph.dense import cuda
from tiegraph.dense.tsgm import kernels
from tiegraph.features import matchers
from tiegraph.project.stages import software

_GRIDS = ("*.tif", "*.gtx", "*.gsb")  # GeoTIFF, and the older formats of vertical and horizontal grids


@dataclass(frozen=True)
class Doctor:
    """Versions, cores, memory, disk, and what is missing."""

    def run(self) -> int:
        for name, text in findings():
            say(f"{name:<24} {text}")
        return 0


def findings() -> Iterator[tuple[str, str]]:
    """(what, how it is), with a remedy where something is missing."""
    yield from software().items()
    yield "cores", str(os.cpu_count())
    yield "memory", f"{psutil.virtual_memory().total / 2**30:.1f} GiB"
    yield "disk", _disk(Path.cwd)
    yield "disk, temporary files", _disk(lambda: Path(tempfile.gettempdir()))
    none = "not built: depth maps are made by OpenCV's matcher (install a C++ compiler, then tiegraph again)"
    yield "native kernels", f"{', '.join(kernels())} (the fastest first)" if kernels() else none
    yield "descriptor kernels", ", ".join(matchers.kernels()) or "not built: NumPy finds the nearest descriptors"
    device = cuda.device_name()
    yield "GPU", f"not used: {cuda.reason()}" if device is None else f"{device}: depth maps are matched on it"
    yield "pycolmap with CUDA", "yes" if pycolmap.has_cuda else "no (not needed)"
    yield "ONNX Runtime", _optional("onnxruntime", "onnx", "--masks.source model, --features.engine onnx")
    yield "PROJ grids", _grids()
    yield "dask", _optional("distributed", "dask", "--pool dask:<address>")
    yield "dask-jobqueue", _optional("dask-jobqueue", "slurm", "--pool slurm:<jobs>")
    yield "s3fs", _optional("s3fs", "stores", "URLs of object stores: s3, gs, https")
    yield "rosbags", _optional("rosbags", "ros", "bags of ROS")
    yield "pi-heif", _optional("pi-heif", "heif", "HEIC images")
    yield "rawpy", _optional("rawpy", "raw", "DNG and other raw files of cameras")
    yield "pyogrio", _optional("pyogrio", "gis", "GeoPackages of `tiegraph export --to gpkg`")


def _disk(place: Callable[[], Path]) -> str:
    try:
        folder = place()
        room = shutil.disk_usage(folder)
    except OSError as error:
        return f"cannot be read ({error.strerror}): work in another folder"
    return f"{room.free / 2**30:.1f} GiB free of {room.total / 2**30:.1f} GiB ({folder})"


def _optional(package: str, extra: str, use: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return f"not installed (pip install 'tiegraph[{extra}]' for {use})"


def _grids() -> str:
    """Grids tell the heights of a geoid and the shifts between datums; PROJ comes without them."""
    folders = [*pyproj.datadir.get_data_dir().split(os.pathsep), pyproj.datadir.get_user_data_dir()]
    count = len({path.name for folder in folders for kind in _GRIDS for path in Path(folder).glob(kind)})
    online = pyproj.network.is_network_enabled()
    if count:
        return f"{count} installed" + ("; others are downloaded when needed" if online else "")
    if online:
        return "none installed; downloaded when needed (PROJ_NETWORK=ON)"
    return "none (for heights above a geoid: PROJ_NETWORK=ON, or pyproj sync --file NAME)"
