"""Which features of two images match: by ``nearest``, or by a plug-in of the group ``tiegraph.matchers``, whose rows
are checked before COLMAP verifies them."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np
import pycolmap

from tiegraph.errors import InputError, TiegraphError
from tiegraph.features import nearest
from tiegraph.features.settings import MatchSettings
from tiegraph.plugins import chosen


@dataclass(frozen=True, eq=False)
class Features:
    """Features of an image: keypoints (K, 4) f4 x, y, scale (pixels), orientation (radians); descriptors (K, 128) u1,
    of SIFT root-SIFT; size (width, height)."""

    keypoints: np.ndarray
    descriptors: np.ndarray
    size: tuple[int, int]

    def __len__(self) -> int:
        return len(self.keypoints)

    def __repr__(self) -> str:
        return f"Features({len(self)} of an image of {self.size[0]} x {self.size[1]} pixels)"


# Features of images a and b -> (K, 2) whole numbers: rows of a and of b that match, each row once at most.
Matcher = Callable[[Features, Features, MatchSettings], np.ndarray]


def by_nearest(a: Features, b: Features, settings: MatchSettings) -> np.ndarray:
    """(K, 2) u4 rows of mutual nearest descriptors."""
    options = pycolmap.SiftMatchingOptions(max_ratio=settings.max_ratio)
    return nearest.matches(a.descriptors, b.descriptors, options)


MATCHERS: dict[str, Matcher] = {"nearest": by_nearest}


def matcher(settings: MatchSettings) -> Callable[[Features, Features, str, str], np.ndarray]:
    """The chosen matcher: features and names of two images -> (K, 2) u4. Raises EngineMissing if it is not there.

    What it returns raises InputError where a plug-in fails or gives rows that are none.
    """
    engine: Matcher = chosen("matchers", settings.engine, MATCHERS)

    def rows(a: Features, b: Features, name_a: str, name_b: str) -> np.ndarray:
        try:
            found = np.asarray(engine(a, b, settings))
            fault = _fault(found, len(a), len(b))
        except (TiegraphError, MemoryError):
            raise
        except Exception as error:  # whatever the package of somebody else does
            found, fault = np.zeros((0, 2)), f"raised {error!r}"
        if fault:
            raise InputError(
                f"match.engine = {settings.engine}: the plug-in {fault} for {name_a} and {name_b}. Correct or update "
                "its package, or set match.engine to nearest"
            )
        return found.astype(np.uint32)

    return rows


def _fault(rows: np.ndarray, of_a: int, of_b: int) -> str:
    """What is wrong with the rows of two images of so many features; "" if nothing is."""
    if rows.ndim != 2 or rows.shape[1] != 2 or rows.dtype.kind not in "iu":
        return f"gave an array of {rows.shape} {rows.dtype} where (K, 2) whole numbers are needed"
    if (rows < 0).any() or (rows >= (of_a, of_b)).any():
        return f"gave rows from {rows.min(axis=0)} to {rows.max(axis=0)} of {of_a} and {of_b} features"
    return "" if all(len(np.unique(column)) == len(rows) for column in rows.T) else "matched a feature twice"
