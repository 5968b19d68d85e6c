"""COLMAP on a GPU: used where a build with CUDA (``pip install pycolmap-cuda12``) finds one."""

import subprocess
import sys
from functools import lru_cache

import pycolmap

_PROBE = """
import ctypes, sys
driver, count = ctypes.CDLL("libcuda.so.1"), ctypes.c_int()
sys.exit(driver.cuInit(0) != 0 or driver.cuDeviceGetCount(ctypes.byref(count)) != 0 or count.value < 1)
"""  # ends with 0 where the driver has a GPU


@lru_cache(maxsize=1)
def on_gpu() -> bool:
    """Whether COLMAP can work on a GPU here. Asked in a process of its own: one that has touched the driver must not be
    forked."""
    if not pycolmap.has_cuda:
        return False
    try:
        # A driver that does not answer within is not used
        return subprocess.run([sys.executable, "-c", _PROBE], capture_output=True, timeout=60).returncode == 0
    except (OSError, subprocess.SubprocessError):
        return False


def device() -> pycolmap.Device:
    """Where COLMAP matches; never left to COLMAP, which takes a GPU for granted in a build with CUDA."""
    return pycolmap.Device.cuda if on_gpu() else pycolmap.Device.cpu
