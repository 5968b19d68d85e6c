"""COLMAP on a GPU: used where a build with CUDA (``pip install pycolmap-cuda12``) finds one."""

from __future__ import annotations

import subprocess
import sys
from functools import lru_cache

import pycolmap

_SECONDS = 60  # a driver that does not answer within is not used
_COUNT = """
import ctypes
driver, count = ctypes.CDLL("libcuda.so.1"), ctypes.c_int()
assert driver.cuInit(0) == 0 and driver.cuDeviceGetCount(ctypes.byref(count)) == 0
print(count.value)
"""


@lru_cache(maxsize=1)
def on_gpu() -> bool:
    """Whether COLMAP can work on a GPU here. Asked in a process of its own: one that has touched the driver must not be
    forked."""
    if not pycolmap.has_cuda:
        return False
    try:
        said = subprocess.run([sys.executable, "-c", _COUNT], capture_output=True, text=True, timeout=_SECONDS)
    except (OSError, subprocess.SubprocessError):
        return False
    return said.returncode == 0 and int(said.stdout) > 0


def device() -> pycolmap.Device:
    """Where COLMAP extracts and matches; never left to COLMAP, which takes a GPU for granted in a build with CUDA."""
    return pycolmap.Device.cuda if on_gpu() else pycolmap.Device.cpu
