"""Glue of products: rasters of the finished cloud and the images over reference surfaces."""

from collections.abc import Callable
from dataclasses import dataclass, fields
from pathlib import Path
from typing import TypeVar

import numpy as np

from tiegraph import plugins
from tiegraph.errors import ReconstructionError
from tiegraph.geometry import transforms
from tiegraph.geometry.stereo import Pinhole
from tiegraph.pipeline.dense import Pictures, accuracy_said, depth_path, plans_of, read_depth
from tiegraph.pipeline.files import CLOUD, checked, load_npz, reading, save_npz, world_origin, world_unit
from tiegraph.pipeline.terrain import OnSurface, Step, TerrainWork, wanted
from tiegraph.products import ortho
from tiegraph.products.heights import height_tile, margin
from tiegraph.products.raster import PICTURE_PX, Place, hillshade, overview, relief
from tiegraph.products.surface import Survey, Window, choose
from tiegraph.project.run import Run
from tiegraph.project.stages import Outcome, save_json, write_atomic
from tiegraph.scene.atomic import replacing
from tiegraph.scene.cloudfile import shift_of
from tiegraph.scene.copc import copc_box, copc_sample
from tiegraph.scene.scene import Scene
from tiegraph.text import csv_text

T = TypeVar("T")

TILE = 1024
"""Pixels along the edge of a tile."""
_MOST_SOURCES = np.iinfo(np.uint16).max


def products(run: Run) -> Outcome:
    """The rasters of each reference surface, tile by tile; finished tiles and rasters stay after an interruption."""
    plans, tuning = plans_of(run), run.settings.tuning.products
    if len(plans) > _MOST_SOURCES:
        raise ReconstructionError(f"{len(plans)} images are more than source.tif can number: set products.make = none")
    pictures = Pictures.of(run, plans)
    views = pictures.cameras()
    counted = run.receipts.read("cloud")["counts"]
    place = Place(world_origin(run.folder), world_unit(run.folder), accuracy_said(run, counted))
    with reading(run.path(CLOUD)):
        sample = copc_sample(run.path(CLOUD), place.origin, 100_000)  # points of the cloud that determine the surfaces
    shift, unroll = shift_of(place.origin), run.settings.products.unroll
    path = _path(checked(run), views) if unroll else np.zeros((0, 3))
    survey = Survey(sample, views, counted["voxel"], shift=shift, unit=place.unit, path=path)
    surfaces, notes = choose(survey, run.settings.products, tuning.choose)
    about = {"place": place, "tuning": tuning, "tile": TILE}
    work = [_Work(run.folder, s, **about, pictures=pictures, views=views) for s in surfaces]
    bare = [
        TerrainWork(run.folder, s, **about, objects_m=run.settings.products.objects_m)
        for s in surfaces
        if wanted(s, place)
    ]
    steps = [step for each in (*work, *bare) for step in each.steps()]
    run.reporter.total(sum(len(s.items) for s in steps), sum(len(s.items) - len(s.todo()) for s in steps))
    for step in steps:
        run.map(step.make, step.todo())
        if not step.result.exists():
            step.finish()
    for each in work:
        save_json(each.path("frame.json"), place.described(each.surface))
        for name in run.settings.products.extra:
            _by_plugin(name, each)
    notes += [each.said() for each in bare]
    if surfaces and place.unit != "m":
        notes.append("the model has no scale: lengths are in its own units")
    pixels = sum(s.shape[0] * s.shape[1] for s in surfaces)
    return Outcome({"surfaces": len(surfaces), "pixels": pixels}, notes=tuple(notes))


def _path(scene: Scene, views: list[Pinhole]) -> np.ndarray:
    """(F, 3) the mean centre of the images of each frame, in the order of the pass that has the most images; of loose
    photographs in that of their names."""
    views = [v for v in views if v.name in scene.image_index]
    frame = scene.frame[[scene.image_index[v.name] for v in views]]
    most = np.bincount(scene.sequence[frame] + 1).argmax() - 1
    centres = transforms.centre(np.array([v.cam_from_world for v in views]))
    order = scene.in_order(scene.sequence == most)
    return np.array([centres[frame == f].mean(axis=0) for f in order if (frame == f).any()])


def _by_plugin(name: str, work: OnSurface) -> None:
    """Let a plug-in write a folder of its own, from the files of a surface."""
    make: Callable[[Path, Path], None] = plugins.chosen("products", name, {})
    if not (target := work.path(name)).exists():
        with replacing(target) as temporary:
            temporary.mkdir()
            make(target.parent, temporary)


@dataclass(frozen=True, eq=False)
class _Work(OnSurface):
    """The common rasters of one surface, and the images that give it colour."""

    pictures: Pictures
    views: list[Pinhole]

    def steps(self) -> list[Step]:
        windows, images = self.windows, list(range(len(self.views)))
        return [
            self.step(windows, "heights", self.make_heights, self.finish_heights, "dsm.jpg"),
            self.step(images, "view", self.make_view, self.finish_views, "source.tif"),
            self.step(windows, "colours", self.make_colours, self.finish_colours, "source.tif"),
        ]

    def make_heights(self, window: Window) -> None:
        around = self.surface.box(window.grown(margin(self.tuning.heights)))
        with reading(self.folder / CLOUD):
            points = copc_box(self.folder / CLOUD, self.place.origin, *around)
        w, sigma = height_tile(points, self.surface, window, self.tuning.heights)
        save_npz(self.scratch("heights", window), dsm=w + np.float32(self.surface.offset[2]), sigma=sigma)

    def finish_heights(self) -> None:
        """The rasters of heights, of their sigmas and of shades, and a picture of the heights."""
        self.write("dsm", self.tiles("heights", "dsm"))
        self.write("sigma", self.tiles("heights", "sigma"))
        shades = ((w, self.heights(w.grown(1))) for w in self.windows)
        self.write("hillshade", ((w, hillshade(h, self.surface.pixel_m)) for w, h in shades))
        write_atomic(self.path("dsm.jpg"), relief(self.path("dsm.tif"), PICTURE_PX, self.place.unit))

    def make_view(self, k: int) -> None:
        """The part of the surface that an image sees, and its colours there for the exposures; nothing if none."""
        view, tuning, kept = self.views[k], self.tuning.ortho, self.scratch("view", k)
        if not ortho.windows_met(view, self.surface):
            return save_npz(kept)
        depth = depth_path(self.folder, view.name)
        rgb, mask = self.pictures.picture(k)
        own = read_depth(view.name, self.folder) if depth.exists() else None
        buffer = ortho.draw(view, self.surface, self.heights, mask, own, tuning)
        if buffer is None:
            return save_npz(kept)
        block = ortho.block_px(len(self.views))
        found = ortho.patch(view, buffer, rgb, self.surface, self.heights, block=block, tuning=tuning)
        if found is None:
            return save_npz(kept)
        save_npz(kept, **{f"buffer_{n}": v for n, v in vars(buffer).items()}, **vars(found))

    def finish_views(self) -> None:
        patches = [self._kept(k, ortho.Patch, "") for k in range(len(self.views))]
        save_npz(self.scratch("gains", 0), gains=ortho.gains(patches))

    def _kept(self, k: int, kind: type[T], prefix: str) -> T | None:
        """The stored data of an image; None if it sees nothing."""
        found = load_npz(self.scratch("view", k))
        names = [f.name for f in fields(kind)]  # type: ignore[arg-type]
        return kind(**{n: found[f"{prefix}{n}"][()] for n in names}) if found else None

    def make_colours(self, window: Window) -> None:
        around = window.grown(ortho.ortho_margin(self.tuning.ortho))
        sigma = self.read("sigma", around)
        images = ortho.Images(
            views=self.views,
            buffer=lambda k: self._kept(k, ortho.Buffer, "buffer_"),
            picture=lambda k: self.pictures.picture(k)[0],
            gains=load_npz(self.scratch("gains", 0))["gains"],
        )
        heights = self.heights(around)
        rgba, source = ortho.ortho_tile(self.surface, window, heights, sigma, images, self.tuning.ortho)
        save_npz(self.scratch("colours", window), ortho=rgba, source=source)

    def finish_colours(self) -> None:
        self.write("ortho", self.tiles("colours", "ortho"))
        write_atomic(self.path("overview.jpg"), overview(self.path("ortho.tif"), PICTURE_PX, self.place.unit))
        rows = [(k, view.name) for k, view in enumerate(self.views, 1)]
        write_atomic(self.path("source.csv"), csv_text(("source", "image"), rows))
        self.write("source", self.tiles("colours", "source"))
