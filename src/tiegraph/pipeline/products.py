"""Glue of products: rasters of the finished cloud and the images over reference surfaces."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tiegraph.dense.plan import CameraModel, ViewPlan
from tiegraph.dense.settings import DenseSettings
from tiegraph.dense.undistort import pinhole
from tiegraph.pipeline.cloud import accuracy_said
from tiegraph.pipeline.files import load_model, load_npz, reading, save_npz, world_origin, world_unit
from tiegraph.products.choose import Survey, choose
from tiegraph.products.heights import height_tile, margin
from tiegraph.products.raster import Place, hillshade, read_window, write_raster
from tiegraph.products.surface import Surface, View, Window
from tiegraph.products.tuning import Tuning
from tiegraph.project.run import Run
from tiegraph.project.settings import Settings
from tiegraph.project.stages import Outcome, save_json
from tiegraph.scene.cloudfile import shift_of
from tiegraph.scene.colmapmodel import matrix
from tiegraph.scene.copc import copc_box, copc_sample

FOLDER, CLOUD = "products", "cloud.copc.laz"
TILE = 1024
"""Pixels along the edge of what is made at once."""
_SAMPLE = 100_000  # points of the cloud that tell which surfaces there are


def products(run: Run) -> Outcome:
    """The rasters of each reference surface, tile by tile; finished tiles and rasters stay after an interruption."""
    plans, tuning = _plans(run), run.settings.tuning.products
    views = [View(p.name, pinhole(p, _sharp(run.settings))) for p in plans]
    counted = run.receipts.read("cloud")["counts"]
    place = Place(world_origin(run.folder), world_unit(run.folder), accuracy_said(run, counted))
    with reading(run.path(CLOUD)):
        sample = copc_sample(run.path(CLOUD), place.origin, _SAMPLE)
    survey = Survey(sample, views, counted["voxel"], shift=shift_of(place.origin), unit=place.unit)
    surfaces, notes = choose(survey, run.settings.products, tuning.choose)
    work = [_Work(run.folder, s, place, tuning) for s in surfaces]
    steps = [step for each in work for step in each.steps()]
    run.reporter.total(sum(len(s.items) for s in steps), sum(len(s.items) - len(s.todo()) for s in steps))
    for step in steps:
        run.map(step.make, step.todo())
        step.finish()
    for each in work:
        save_json(each.path("frame.json"), place.described(each.surface))
    if surfaces and place.unit != "m":
        notes.append("the model has no scale: lengths are in its own units")
    pixels = sum(s.shape[0] * s.shape[1] for s in surfaces)
    return Outcome({"surfaces": len(surfaces), "pixels": pixels}, notes=tuple(notes))


def _sharp(settings: Settings) -> DenseSettings:
    """How images are undistorted for their colours: at their own resolution."""
    return settings.dense.model_copy(update={"max_image_size": 20_000})


def _plans(run: Run) -> list[ViewPlan]:
    """The images of the model in the world, by name."""
    images = load_model(run.path("sparse", "world")).images.values()
    there = sorted((i for i in images if i.has_pose), key=lambda i: i.name)
    return [ViewPlan(i.name, CameraModel.of(i.camera), matrix(i.cam_from_world())) for i in there]


@dataclass(frozen=True, eq=False)
class _Step:
    """One of the steps in which the rasters of a surface are made: its items, where each leaves what it made, what
    makes one, and what is made of all of them, of which the last file is ``result``."""

    items: list[Any]
    artefact: Callable[[Any], Path]
    make: Callable[[Any], None]
    finish: Callable[[], None]
    result: Path

    def todo(self) -> list[Any]:
        """The items that are missing."""
        return [] if self.result.exists() else [i for i in self.items if not self.artefact(i).exists()]


@dataclass(frozen=True, eq=False)
class _Work:
    """The rasters of one surface below a run folder."""

    folder: Path
    surface: Surface
    place: Place
    tuning: Tuning

    def path(self, *parts: str) -> Path:
        """Where its rasters are."""
        return self.folder.joinpath(FOLDER, self.surface.name, *parts)

    def scratch(self, kind: str, window: Window) -> Path:
        """Where a finished tile is."""
        return self.folder / FOLDER / ".tiles" / self.surface.name / f"{kind}_{window.row}_{window.column}.npz"

    def steps(self) -> list[_Step]:
        """All steps, in their order."""
        tile = partial(self.scratch, "heights")
        heights = _Step(
            self.surface.windows(TILE), tile, self.make_heights, self.finish_heights, self.path("hillshade.tif")
        )
        return [heights]

    def make_heights(self, window: Window) -> None:
        """Heights and sigmas of a tile."""
        around = self.surface.box(window.grown(margin(self.tuning.heights)))
        with reading(self.folder / CLOUD):
            points = copc_box(self.folder / CLOUD, self.place.origin, *around)
        w, sigma = height_tile(points, self.surface, window, self.tuning.heights)
        save_npz(self.scratch("heights", window), dsm=w + np.float32(self.surface.offset[2]), sigma=sigma)

    def finish_heights(self) -> None:
        """The rasters of heights, of their sigmas and of shades."""
        for name in ("dsm", "sigma"):
            self._write(name, "heights")
        if not self.path("hillshade.tif").exists():
            write_raster(self.path("hillshade.tif"), self._shades(), self.surface, self.place, self._scratch())

    def _scratch(self) -> Path:
        return self.folder / FOLDER / ".tiles"

    def _shades(self) -> Iterator[tuple[Window, np.ndarray]]:
        for window in self.surface.windows(TILE):
            w = read_window(self.path("dsm.tif"), window.grown(1))
            yield window, hillshade(w, self.surface.pixel_m)[None]

    def _write(self, name: str, kind: str) -> None:
        """One raster of its tiles, unless it is there."""
        windows = self.surface.windows(TILE)
        parts = ((w, np.atleast_3d(load_npz(self.scratch(kind, w))[name].T).T) for w in windows)
        if not self.path(f"{name}.tif").exists():
            write_raster(self.path(f"{name}.tif"), parts, self.surface, self.place, self._scratch())
