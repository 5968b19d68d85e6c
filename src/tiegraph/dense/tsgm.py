"""Matching of a rectified pair by the native semi-global matcher (census costs, 8 paths; paper 004, section 5.2)."""

from __future__ import annotations

import numpy as np

from tiegraph.dense.settings import DenseSettings
from tiegraph.dense.speckles import without_speckles
from tiegraph.errors import EngineMissing

try:
    from tiegraph.dense import _sgm
except ImportError:  # installed without a C++ compiler
    _sgm = None  # type: ignore[assignment]


def available() -> bool:
    """Whether the native module is installed."""
    return _sgm is not None


def match_tsgm(left: np.ndarray, right: np.ndarray, disparities: int, settings: DenseSettings) -> np.ndarray:
    """Disparity (h, w) f4 px of each left pixel, NaN = none: the ``PairMatcher`` contract of ``dense.engine``.

    left (h, w) u1; right (h, w + disparities) u1, whose column ``disparities`` lies under the left's column 0: left
    (x, y) shows what right (x + disparities - d, y) shows, 0 <= d < disparities. Raises EngineMissing where the native
    module was not built.
    """
    if _sgm is None:
        raise EngineMissing(
            "the native matcher is not installed: install a C++ compiler and tiegraph again, or use --dense.engine sgbm"
        )
    left, right = np.ascontiguousarray(left), np.ascontiguousarray(right)
    found, _ = _sgm.match_dense(left, right, -disparities, disparities, _sgm.Options(), _sgm.Workspace())
    return without_speckles(found + np.float32(disparities))
