"""Common code of the makers of rasters over a reference surface: files, steps of the work, tiles."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tiegraph.pipeline.files import load_npz, reading
from tiegraph.products.raster import Place, read_window, write_raster
from tiegraph.products.surface import Surface, Window
from tiegraph.products.tuning import Tuning

FOLDER = "products"


@dataclass(frozen=True, eq=False)
class Step:
    """One of the steps in which the rasters of a surface are made: its items, the file of each item's result, the
    function that makes one, and the one that combines all of them, whose last file is ``result``."""

    items: list[Any]
    artefact: Callable[[Any], Path]
    make: Callable[[Any], None]
    finish: Callable[[], None]
    result: Path

    def todo(self) -> list[Any]:
        """The items that are missing."""
        return [] if self.result.exists() else [i for i in self.items if not self.artefact(i).exists()]


@dataclass(frozen=True, eq=False)
class OnSurface:
    """The files of one surface below a run folder, made by tiles of so many pixels along their edge."""

    folder: Path
    surface: Surface
    place: Place
    tuning: Tuning
    tile: int

    @property
    def windows(self) -> list[Window]:
        """The tiles."""
        return self.surface.windows(self.tile)

    def path(self, name: str) -> Path:
        """A file of the surface."""
        return self.folder / FOLDER / self.surface.name / name

    def scratch(self, kind: str, item: Window | int) -> Path:
        """The file of a finished item until all are."""
        name = f"{item.row}_{item.column}" if isinstance(item, Window) else f"{item}"
        return self.folder / FOLDER / ".tiles" / self.surface.name / f"{kind}_{name}.npz"

    def step(self, items: list[Any], kind: str, make: Any, finish: Any, result: str) -> Step:
        """A step whose items leave files of a kind, and whose last file has a name."""
        where = partial(self.scratch, kind)
        return Step(items=items, artefact=where, make=make, finish=finish, result=self.path(result))

    def heights(self, window: Window, step: int = 1) -> np.ndarray:
        """w of a window or its blocks, as written."""
        return self.read("dsm", window, step) - np.float32(self.surface.offset[2])

    def read(self, name: str, window: Window, step: int = 1) -> np.ndarray:
        """Lengths of a raster in a window or its blocks."""
        path = self.path(f"{name}.tif")
        with reading(path):
            return read_window(path, window, step)

    def tiles(self, kind: str, name: str) -> Iterator[tuple[Window, np.ndarray]]:
        """All tiles of a kind."""
        for window in self.windows:
            yield window, load_npz(self.scratch(kind, window))[name]

    def write(self, name: str, parts: Iterable[tuple[Window, np.ndarray]]) -> None:
        """A raster, unless it is there."""
        path = self.path(f"{name}.tif")
        if not path.exists():
            write_raster(path, parts, self.surface, self.place, self.folder / FOLDER / ".tiles")
