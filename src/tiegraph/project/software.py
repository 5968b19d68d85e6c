"""Versions that a result depends on: for receipts, and to see whether a worker elsewhere would make the same."""

from __future__ import annotations

import platform
from importlib.metadata import PackageNotFoundError, version

from tiegraph.__version__ import __version__

_PACKAGES = ("pycolmap", "numpy", "opencv-python-headless", "scipy", "laspy", "pyproj")


def software() -> dict[str, str]:
    """Versions of tiegraph, Python and the packages that are installed of those a result depends on."""
    out = {"tiegraph": __version__, "python": platform.python_version()}
    for package in _PACKAGES:
        try:
            out[package] = version(package)
        except PackageNotFoundError:
            pass
    return out
