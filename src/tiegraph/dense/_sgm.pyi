"""Semi-global matching of rectified pairs, dense or with a range for each pixel (native, sources in native/sgm)."""

import numpy as np

class Options:
    """Penalties, census window and checks of one match; ``kernel`` empty = the fastest this machine runs."""

    radius_x: int
    radius_y: int
    small: int
    large: int
    large_by_step: list[int]
    uniqueness: int
    left_right: int
    parabola: bool
    mode: int
    threads: int
    kernel: str

class RangeRules:
    """How the disparities of one level become the ranges of the next."""

    low: int
    count: int
    reach: int
    margin: int
    hole_limit: int

class Workspace:
    """Memory of the cost volumes, kept from one match to the next."""

    def release(self) -> None: ...
    @property
    def bytes(self) -> int: ...

def kernels() -> list[str]: ...
def halve(image: np.ndarray) -> np.ndarray: ...
def joint_greys(left: np.ndarray, right: np.ndarray, disparity: np.ndarray) -> np.ndarray: ...
def ranges(coarse: np.ndarray, width: int, height: int, rules: RangeRules) -> tuple[np.ndarray, np.ndarray, int]: ...
def match_dense(
    left: np.ndarray,
    right: np.ndarray,
    low: int,
    count: int,
    options: Options,
    workspace: Workspace,
    mutual: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]: ...
def match_ragged(
    left: np.ndarray,
    right: np.ndarray,
    first: np.ndarray,
    blocks: np.ndarray,
    options: Options,
    workspace: Workspace,
    mutual: np.ndarray | None = None,
) -> tuple[np.ndarray, np.ndarray]: ...
