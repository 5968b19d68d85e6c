"""What is estimated: cameras, where they are in the rig, and where the board was at every instant."""

from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
import pycolmap

from tiegraph.calibrate.observations import Observations, View
from tiegraph.geometry import transforms


@dataclass(frozen=True)
class State:
    """Cameras (COLMAP's, C of them), sensor_from_rig (C, 4, 4), the first camera's being one; rig_from_board (4, 4) by
    instant, metres."""

    cameras: tuple[pycolmap.Camera, ...]
    sensor_from_rig: np.ndarray
    rig_from_board: Mapping[int, np.ndarray]

    def camera_from_board(self, view: View) -> np.ndarray:
        """(4, 4) of a view."""
        return np.asarray(self.sensor_from_rig[view.camera] @ self.rig_from_board[view.instant])

    def at(self, instants: Collection[int]) -> "State":
        """The state with the board of these instants alone."""
        kept = {k: pose for k, pose in self.rig_from_board.items() if k in instants}
        return State(self.cameras, self.sensor_from_rig, kept)


def residuals(camera: pycolmap.Camera, camera_from_board: np.ndarray, points: np.ndarray, xy: np.ndarray) -> np.ndarray:
    """(K, 2) seen minus projected, pixels; NaN where a point is not before the camera."""
    inside = transforms.apply(camera_from_board, points)
    projected = np.asarray(camera.img_from_cam(inside), float)
    return np.where(inside[:, 2:] > 0, xy - projected, np.nan)


def view_residuals(seen: Observations, state: State) -> list[np.ndarray]:
    """Of every view, as of ``residuals``."""
    return [
        residuals(state.cameras[v.camera], state.camera_from_board(v), seen.board.points[v.corners], v.xy)
        for v in seen.views
    ]


def robust_sigma(values: list[np.ndarray]) -> float:
    """Sigma of one coordinate by the median of the absolute residuals, pixels."""
    return 1.4826 * float(np.nanmedian(np.abs(np.concatenate([v.ravel() for v in values]))))
