"""Versions that a result depends on: for receipts, and to see whether a worker elsewhere would make the same."""

import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version

from tiegraph.__version__ import __version__

_PACKAGES = ("pycolmap", "pycolmap-cuda12", "numpy", "opencv-python-headless", "scipy", "laspy", "pyproj")


def software() -> dict[str, str]:
    """Versions of tiegraph, Python and the packages that are installed of those a result depends on."""
    found = {package: known for package in _PACKAGES if (known := _version(package))}
    return {"tiegraph": __version__, "python": platform.python_version(), **found}


@cache  # every receipt tells it, and to read a package's description takes milliseconds
def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return ""
