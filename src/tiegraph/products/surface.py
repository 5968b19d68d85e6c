"""A reference surface: a rigid frame (u, v, w) and the raster over (u, v); and the windows of that raster."""

from dataclasses import dataclass, field

import numpy as np

from tiegraph.geometry import transforms
from tiegraph.geometry.stereo import Pinhole

NODATA = -9999.0
MAP = "map"


@dataclass(frozen=True)
class Window:
    """A part of a raster: first row and column, rows and columns, in pixels; it may lie beyond the raster."""

    row: int
    column: int
    rows: int
    columns: int

    def grown(self, margin: int) -> "Window":
        """The same with a margin all round."""
        return Window(
            self.row - margin, self.column - margin, rows=self.rows + 2 * margin, columns=self.columns + 2 * margin
        )


@dataclass(frozen=True)
class View:
    """An image that may give colour: its name and undistorted camera in the world."""

    name: str
    camera: Pinhole


@dataclass(frozen=True, eq=False)
class Surface:
    """A frame (4, 4) surface_from_world, the corners (3,) of its box in (u, v, w), the edge of a pixel in world units
    (0 = not chosen yet), and the share of the points that a wall has (NaN = not found by its points).

    Files have (u, v, w) plus ``offset`` (3,): for a map the shift to its CRS, for a wall its height. There the
    corners in u and v are whole pixels; row 0 lies at the largest v.
    """

    name: str
    surface_from_world: np.ndarray
    low: np.ndarray
    high: np.ndarray
    pixel_m: float = 0.0
    share: float = float("nan")
    offset: np.ndarray = field(default_factory=lambda: np.zeros(3))

    @property
    def shape(self) -> tuple[int, int]:
        """Rows and columns of its rasters."""
        columns, rows = np.round((self.high - self.low)[:2] / self.pixel_m).astype(int)
        return int(rows), int(columns)

    def windows(self, size: int) -> list[Window]:
        """Tiles of ``size`` pixels, those at the border smaller."""
        rows, columns = self.shape
        starts = [(r, c) for r in range(0, rows, size) for c in range(0, columns, size)]
        return [Window(r, c, rows=min(size, rows - r), columns=min(size, columns - c)) for r, c in starts]

    def places(self, window: Window, step: int = 1) -> tuple[np.ndarray, np.ndarray]:
        """u (columns,) and v (rows,) of the centres of a window's pixels, or of blocks of ``step`` pixels."""
        columns, rows = np.arange(0, window.columns, step), np.arange(0, window.rows, step)
        u = self.low[0] + (window.column + columns + step / 2) * self.pixel_m
        return u, self.high[1] - (window.row + rows + step / 2) * self.pixel_m

    def in_world(self, u: np.ndarray, v: np.ndarray, w: np.ndarray) -> np.ndarray:
        """World points (..., 3) of the surface at u, v and w of one shape (...)."""
        world_from_surface = transforms.invert(self.surface_from_world)
        return np.stack([u, v, w], axis=-1) @ world_from_surface[:3, :3].T + world_from_surface[:3, 3]

    def box(self, window: Window) -> tuple[np.ndarray, np.ndarray]:
        """Corners (3,) in the world of the box along its axes around a window, for all w of the surface."""
        u = self.low[0] + np.array([window.column, window.column + window.columns]) * self.pixel_m
        v = self.high[1] - np.array([window.row, window.row + window.rows]) * self.pixel_m
        corners = np.array(np.meshgrid(u, v, [self.low[2], self.high[2]])).reshape(3, 8)
        xyz = self.in_world(*corners)
        return xyz.min(axis=0), xyz.max(axis=0)


def project(camera: Pinhole, xyz: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Pixel coordinates x, y (...) of world points (..., 3), and their depths (...); NaN where not in the image."""
    seen = xyz @ camera.cam_from_world[:3, :3].T + camera.cam_from_world[:3, 3]
    z = seen[..., 2]
    with np.errstate(divide="ignore", invalid="ignore"):
        x = camera.K[0, 0] * seen[..., 0] / z + camera.K[0, 2]
        y = camera.K[1, 1] * seen[..., 1] / z + camera.K[1, 2]
        inside = (z > 0) & (x >= 0) & (y >= 0) & (x <= camera.size[0]) & (y <= camera.size[1])
    return np.where(inside, x, np.nan), np.where(inside, y, np.nan), np.where(inside, z, np.nan)


def focal(camera: Pinhole) -> float:
    """Pixels per unit of tangent."""
    return float(np.sqrt(camera.K[0, 0] * camera.K[1, 1]))
