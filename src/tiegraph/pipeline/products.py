"""Glue of products: rasters of the finished cloud and the images over reference surfaces, made in steps by tiles; and
the terrain of a map, with the points of the cloud that are ground."""

from collections.abc import Callable, Iterable, Iterator
from dataclasses import dataclass, fields
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import numpy as np
from laspy import LasHeader, ScaleAwarePointRecord

from tiegraph import plugins
from tiegraph.errors import ReconstructionError
from tiegraph.geometry import transforms
from tiegraph.geometry.stereo import Pinhole
from tiegraph.pipeline.dense import Pictures, accuracy_said, known_depth
from tiegraph.pipeline.files import CLOUD, checked, load_npz, reading, save_npz, world_origin, world_unit
from tiegraph.products import ortho, terrain
from tiegraph.products.heights import height_tile, margin
from tiegraph.products.raster import (
    PICTURE_PX,
    Place,
    hangs,
    hillshade,
    overview,
    read_window,
    relief,
    write_lines,
    write_raster,
)
from tiegraph.products.surface import MAP, Surface, Survey, Window, choose
from tiegraph.products.tuning import Tuning
from tiegraph.project.run import Run
from tiegraph.project.stages import Outcome, save_json, write_atomic
from tiegraph.scene.atomic import replacing
from tiegraph.scene.cloudfile import las_header, las_points, shift_of, write_records
from tiegraph.scene.copc import copc_box, copc_sample
from tiegraph.scene.results import Cloud
from tiegraph.scene.scene import Scene
from tiegraph.text import csv_text

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
    """The files of one surface below a run folder, made by tiles of so many pixels along their edge; below objects of
    up to so many metres the terrain of a map is interpolated, to half of that."""

    folder: Path
    surface: Surface
    place: Place
    tuning: Tuning
    tile: int
    objects_m: float

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

    @cached_property
    def cell(self) -> int:
        """Pixels along a cell."""
        return terrain.step_of(self.surface.shape, self.surface.pixel_m, self.widest_m)

    @cached_property
    def reach(self) -> int:
        """Cells to which a surface is interpolated."""
        return int(np.ceil(self.widest_m / 2 / (self.cell * self.surface.pixel_m)))

    @property
    def widest_m(self) -> float:
        """Width of an object at most: no more than half that of a square as large as the map."""
        return min(self.objects_m, float(np.sqrt(np.prod(self.surface.shape))) * self.surface.pixel_m / 2)

    def keep_cells(self, kind: str, w: np.ndarray, sigma: np.ndarray, known: np.ndarray) -> None:
        """Interpolate a surface through cells (rows, columns), NaN = not of it, within those that ``known`` ones
        surround."""
        found = terrain.through(w, sigma, self.cell, self.reach, terrain.footprint(known))
        save_npz(self.scratch(f"{kind}_cells", 0), **vars(found))

    def kept_cells(self, kind: str) -> terrain.Terrain:
        """The same as it was kept."""
        found = load_npz(self.scratch(f"{kind}_cells", 0))
        return terrain.Terrain(step=int(found["step"]), w=found["w"], sigma=found["sigma"], known=found["known"])

    def heights(self, window: Window, step: int = 1) -> np.ndarray:
        """w of a window or its blocks, as written."""
        return self.surface.w(self.read("dsm", window, step))

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


_DONE = "dtm.jpg"  # the last file


@dataclass(frozen=True, eq=False)
class TerrainWork(OnSurface):
    """The terrain model of a map and its contour lines."""

    def steps(self) -> list[Step]:
        return [
            self.step(self.windows, "low", self.make_low, self.finish_low, _DONE),
            self.step(self.windows, "ground", self.make_ground, self.finish_ground, _DONE),
            self.step(self.windows, "terrain", self.make_terrain, self.finish_terrain, _DONE),
        ]

    def make_low(self, window: Window) -> None:
        """Heights of the cells of a tile, low ones, and their sigma."""
        low = terrain.low_cells(self.heights(window), self.cell, self.tuning.terrain)
        sigma = terrain.low_cells(self.read("sigma", window), self.cell, self.tuning.terrain)
        save_npz(self.scratch("low", window), low=low, sigma=sigma)

    def finish_low(self) -> None:
        """The terrain through the cells that are ground by their heights."""
        low, sigma = (self._whole("low", name, self.cell) for name in ("low", "sigma"))
        noise = float(np.nanmedian(sigma)) if np.isfinite(sigma).any() else 0.0
        cell_m = self.cell * self.surface.pixel_m
        found = terrain.bare(low, noise, cell_m, self.widest_m, self.tuning.terrain)
        self.keep_cells("low", found, np.where(np.isfinite(found), noise, np.nan), np.isfinite(low))

    def make_ground(self, window: Window) -> None:
        """Heights of the cells of a tile by their pixels on the ground."""
        wide = self.tuning.terrain.rim_px + 1
        around = window.grown(wide)
        w, sigma = self.heights(around), self.read("sigma", around)
        on_ground = terrain.ground(w, sigma, self.kept_cells("low"), around, self.tuning.terrain)
        inner = slice(wide, -wide), slice(wide, -wide)
        found = terrain.ground_cells(w[inner], sigma[inner], on_ground[inner], self.cell)
        save_npz(self.scratch("ground", window), w=found[0], sigma=found[1])

    def finish_ground(self) -> None:
        """The terrain through the cells on the ground."""
        w, sigma = (self._whole("ground", name, self.cell) for name in ("w", "sigma"))
        self.keep_cells("ground", w, sigma, np.isfinite(self._whole("low", "low", self.cell)))

    def make_terrain(self, window: Window) -> None:
        """Heights of the terrain of a tile, their sigma, and both by the cells in which contour lines are drawn."""
        around = window.grown(terrain.margin(self.cell, self.tuning.terrain))
        w, sigma = self.heights(around), self.read("sigma", around)
        w, sigma = terrain.terrain_tile(
            w, sigma, self.kept_cells("low"), self.kept_cells("ground"), window, self.tuning.terrain
        )
        drawn = terrain.ground_cells(w, sigma, np.isfinite(w), self._drawn)
        dtm = self.surface.heights(w)
        save_npz(self.scratch("terrain", window), dtm=dtm, sigma=sigma, drawn=drawn[0], drawn_sigma=drawn[1])

    @property
    def _drawn(self) -> int:
        return max(1, self.cell // 2)

    def finish_terrain(self) -> None:
        """Contour lines, the rasters of the terrain and its sigma, the classified cloud, and a picture of both."""
        lines = self._contours()
        self.write("dtm_sigma", self.tiles("terrain", "sigma"))
        self.write("dtm", self.tiles("terrain", "dtm"))
        origin = self.place.origin
        header, _ = las_header(Cloud.empty(origin), self.surface.pixel_m, self.place.said)
        write_records(map(partial(self._classified, header), self.windows), header, self.path("classified.laz"))
        write_atomic(self.path(_DONE), relief(self.path("dtm.tif"), PICTURE_PX, self.place.unit, lines))

    def _classified(self, header: LasHeader, window: Window) -> ScaleAwarePointRecord:
        """The points of the cloud over a tile, of class 2 (ground) where they lie on the terrain, else 1."""
        with reading(self.folder / CLOUD):
            points = copc_box(self.folder / CLOUD, self.place.origin, *self.surface.above(window))
        w = self.surface.w(self.read("dtm", window.grown(1)))
        here, on_ground = terrain.on_terrain(points, self.surface, window, w, self.read("dtm_sigma", window))
        record = las_points(points.where(here), header)
        record.classification = np.where(on_ground, 2, 1).astype(np.uint8)
        return record

    def _contours(self) -> list[terrain.Line]:
        step, surface, tuning = self._drawn, self.surface, self.tuning.contours
        w, sigma = (self._whole("terrain", name, step) for name in ("drawn", "drawn_sigma"))
        w = w + surface.offset[2]
        whole = Window(0, 0, rows=surface.shape[0], columns=surface.shape[1])
        every = terrain.equidistance(w, sigma, tuning)
        u, v = (at + off for at, off in zip(surface.places(whole, step), surface.offset))
        lines = terrain.contour_lines(w, sigma, (u, v), every, tuning)
        said = "none, because the known heights of the terrain are too few and scattered, or all equal"
        if lines:
            written = write_lines(self.path("contours.gpkg"), lines, surface, self.place)
            levels = len({line.w for line in lines})
            said = f"{len(lines)} lines at {levels} heights, {every:g} m apart ({written})"
        save_npz(self.scratch("contours", 0), said=said)
        return lines

    def said(self) -> str:
        """The result in words."""
        path = self.scratch("contours", 0)
        return f"contour lines: {load_npz(path)['said'] if path.exists() else 'unchanged'}"

    def _whole(self, kind: str, name: str, step: int) -> np.ndarray:
        """Cells (rows, columns) of ``step`` pixels of all tiles."""
        out = np.full([-(-n // step) for n in self.surface.shape], np.nan, np.float32)
        for window, values in self.tiles(kind, name):
            row, column = window.row // step, window.column // step
            out[row : row + values.shape[0], column : column + values.shape[1]] = values
        return out


TILE = 1024
"""Pixels along the edge of a tile."""
_MOST_SOURCES = np.iinfo(np.uint16).max


def products(run: Run) -> Outcome:
    """The rasters of each reference surface, tile by tile; finished tiles and rasters stay after an interruption."""
    tuning, pictures = run.settings.tuning.products, Pictures.of(run)
    views = pictures.views
    if len(views) > _MOST_SOURCES:
        raise ReconstructionError(f"{len(views)} images are more than source.tif can number: set products.make = none")
    counted = run.receipts.read("cloud")["counts"]
    place = Place(world_origin(run.folder), world_unit(run.folder), accuracy_said(run, counted))
    with reading(run.path(CLOUD)):
        sample = copc_sample(run.path(CLOUD), place.origin, 100_000)  # points of the cloud that determine the surfaces
    shift, unroll = shift_of(place.origin), run.settings.products.unroll
    path = _path(checked(run), views) if unroll else np.zeros((0, 3))
    water = run.receipts.read("refine")["counts"].get("water_height")
    survey = Survey(sample, views, counted["voxel"], shift=shift, unit=place.unit, path=path, water=water)
    surfaces, notes = choose(survey, run.settings.products, tuning.choose)
    objects_m = run.settings.products.objects_m if place.unit == "m" else np.inf
    about = {"place": place, "tuning": tuning, "tile": TILE, "objects_m": objects_m}
    work = [_Work(run.folder, s, **about, pictures=pictures) for s in surfaces]
    bare = [TerrainWork(run.folder, s, **about) for s in surfaces if place.has_terrain(s)]
    steps = [step for each in (*work, *bare) for step in each.steps()]
    run.reporter.total(sum(len(s.items) for s in steps), sum(len(s.items) - len(s.todo()) for s in steps))
    for step in steps:
        run.map(step.make, step.todo())
        if not step.result.exists():
            step.finish()
    for each in work:
        save_json(each.path("frame.json"), place.described(each.surface))
        for name in run.settings.products.extra:
            if not (target := each.path(name)).exists():  # a folder of its own, from the files of the surface
                make: Callable[[Path, Path], None] = plugins.chosen("products", name, {})
                with replacing(target) as temporary:
                    temporary.mkdir()
                    make(target.parent, temporary)
    notes += [each.said() for each in bare]
    notes += [hangs(each.path("dsm.tif"), each.surface, place.unit) for each in work if each.surface.from_below]
    if surfaces and place.unit != "m":
        notes.append("the model has no scale: lengths are in its own units")
    counts = {"surfaces": len(surfaces), "pixels": sum(s.shape[0] * s.shape[1] for s in surfaces)}
    return Outcome(counts, notes=tuple(notes))


def _path(scene: Scene, views: list[Pinhole]) -> np.ndarray:
    """(F, 3) the mean centre of the images of each frame, in the order of the pass that has the most images; of loose
    photographs in that of their names."""
    views = [v for v in views if v.name in scene.image_index]
    frame = scene.frame[[scene.image_index[v.name] for v in views]]
    most = np.bincount(scene.sequence[frame] + 1).argmax() - 1
    centres = transforms.centre(np.array([v.cam_from_world for v in views]))
    order = scene.in_order(scene.sequence == most)
    return np.array([centres[frame == f].mean(axis=0) for f in order if (frame == f).any()])


@dataclass(frozen=True, eq=False)
class _Work(OnSurface):
    """The common rasters of one surface, and the images that give it colour."""

    pictures: Pictures

    def steps(self) -> list[Step]:
        windows, images = self.windows, list(range(len(self.pictures.views)))
        covers = [0] if self.surface.name == MAP else []
        return [
            self.step(windows, "heights", self.make_heights, self.finish_heights, "dsm.jpg"),
            self.step(covers, "cover_cells", self.make_cover, lambda: None, "source.tif"),
            self.step(images, "view", self.make_view, self.finish_views, "source.tif"),
            self.step(windows, "colours", self.make_colours, self.finish_colours, "source.tif"),
        ]

    def make_heights(self, window: Window) -> None:
        around = self.surface.box(window.grown(margin(self.tuning.heights)))
        with reading(self.folder / CLOUD):
            points = copc_box(self.folder / CLOUD, self.place.origin, *around)
        w, sigma = height_tile(points, self.surface, window, self.tuning.heights)
        save_npz(self.scratch("heights", window), dsm=self.surface.heights(w), sigma=sigma)

    def finish_heights(self) -> None:
        """The rasters of heights, of their sigmas and of shades, and a picture of the heights."""
        self.write("dsm", self.tiles("heights", "dsm"))
        self.write("sigma", self.tiles("heights", "sigma"))
        shades = ((w, self.heights(w.grown(1))) for w in self.windows)
        self.write("hillshade", ((w, hillshade(h, self.surface.pixel_m)) for w, h in shades))
        write_atomic(self.path("dsm.jpg"), relief(self.path("dsm.tif"), PICTURE_PX, self.place.unit))

    def make_cover(self, _: int) -> None:
        """The surface of a map in cells without holes."""
        whole = Window(0, 0, rows=self.surface.shape[0], columns=self.surface.shape[1])
        w, sigma = self.heights(whole, self.cell), self.read("sigma", whole, self.cell)
        self.keep_cells("cover", w, sigma, np.isfinite(w))

    @cached_property
    def _cover(self) -> terrain.Terrain | None:
        return self.kept_cells("cover") if self.surface.name == MAP else None

    def covered(self, window: Window) -> np.ndarray:
        """w of a window for the orthophoto: in holes of a map, such as trees, w of its cover."""
        w = self.heights(window)
        if self._cover is None:
            return w
        level, _, known = self._cover.at(window)
        return np.where(np.isnan(w) & known, level, w)

    def make_view(self, k: int) -> None:
        """The part of the surface that an image sees, and its colours there for the exposures; nothing if none."""
        view, tuning, kept = self.pictures.views[k], self.tuning.ortho, self.scratch("view", k)
        if not ortho.windows_met(view, self.surface):
            return save_npz(kept)
        rgb, mask = self.pictures.picture(k)
        own = known_depth(view.name, self.folder)
        buffer = ortho.draw(view, self.surface, self.heights, mask, own, tuning)
        if buffer is None:
            return save_npz(kept)
        block = ortho.block_px(len(self.pictures.views))
        found = ortho.patch(view, buffer, rgb, self.surface, self.heights, block=block, tuning=tuning)
        if found is None:
            return save_npz(kept)
        save_npz(kept, **{f"buffer_{n}": v for n, v in vars(buffer).items()}, **vars(found))

    def finish_views(self) -> None:
        patches = [self._kept(k, ortho.Patch, "") for k in range(len(self.pictures.views))]
        save_npz(self.scratch("gains", 0), gains=ortho.gains(patches))

    def _kept(self, k: int, kind: type, prefix: str) -> Any:
        """The stored data of an image; None if it sees nothing."""
        found = load_npz(self.scratch("view", k))
        names = [f.name for f in fields(kind)]
        return kind(**{n: found[f"{prefix}{n}"][()] for n in names}) if found else None

    def make_colours(self, window: Window) -> None:
        around = window.grown(ortho.ortho_margin(self.tuning.ortho))
        heights, sigma = self.covered(around), self.read("sigma", around)
        images = ortho.Images(
            views=self.pictures.views,
            buffer=lambda k: self._kept(k, ortho.Buffer, "buffer_"),
            picture=lambda k: self.pictures.picture(k)[0],
            gains=load_npz(self.scratch("gains", 0))["gains"],
            whole=self.surface.name == MAP,
        )
        rgba, source = ortho.ortho_tile(self.surface, window, heights, sigma, images, self.tuning.ortho)
        save_npz(self.scratch("colours", window), ortho=rgba, source=source)

    def finish_colours(self) -> None:
        self.write("ortho", self.tiles("colours", "ortho"))
        write_atomic(self.path("overview.jpg"), overview(self.path("ortho.tif"), PICTURE_PX, self.place.unit))
        rows = [(k, view.name) for k, view in enumerate(self.pictures.views, 1)]
        write_atomic(self.path("source.csv"), csv_text(("source", "image"), rows))
        self.write("source", self.tiles("colours", "source"))
