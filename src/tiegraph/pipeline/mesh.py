"""Glue of the mesh: the finished cloud as a surface, coloured from the images."""

from collections.abc import Callable, Iterator
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tiegraph.child import run_in_child
from tiegraph.errors import ReconstructionError
from tiegraph.export.survey import offset_of
from tiegraph.export.tiles3d import Place, Tile, write_tree
from tiegraph.limits import need_room
from tiegraph.mesh import files, surface, texture, views
from tiegraph.mesh.settings import MeshSettings
from tiegraph.mesh.tuning import Tuning
from tiegraph.pipeline.dense import Pictures, accuracy_said, known_depth
from tiegraph.pipeline.files import CLOUD, load_as, load_npz, reading, save_npz, world_origin, world_unit
from tiegraph.project.run import Run
from tiegraph.project.stages import Outcome, save_json, write_atomic
from tiegraph.scene.atomic import replacing, scratch_folder
from tiegraph.scene.copc import copc_sample

FOLDER, SCRATCH = "mesh", ".work"
_READ = 3 * surface.MOST_POINTS  # points that are read of the cloud, and then thinned
_BYTES = 200  # of a point in the files of COLMAP's surface


def mesh(run: Run) -> Outcome:
    """The mesh of the cloud with its textures, as GLB, OBJ and PLY. What is finished of it stays after an
    interruption: the surface, what each image sees and gives, each texture."""
    work = _Work(run.folder, Pictures.of(run), settings=run.settings.mesh, tuning=run.settings.tuning.mesh)
    images = list(range(len(work.pictures.views)))
    run.reporter.total(2 * len(images) + 3)
    _once(run, work.path("surface"), partial(_make_surface, run, work))
    _each(run, images, partial(work.path, "view"), work.make_view)
    _once(run, work.path("layout"), work.make_layout)
    _each(run, images, partial(work.path, "colours"), work.make_colours)
    _once(run, work.path("levels"), work.make_levels)
    layout = work.layout()
    pages = list(range(len(layout.pages)))
    run.reporter.total(2 * len(images) + 3 + len(pages), 2 * len(images) + 3)
    _each(run, pages, work.page_path, work.make_texture)
    return _written(run, work, layout)


def _once(run: Run, path: Path, make: Callable[[], None]) -> None:
    if not path.exists():
        make()
    run.reporter.advance()


def _each(run: Run, items: list[int], path: Callable[[int], Path], make: Callable[[int], None]) -> None:
    todo = [k for k in items if not path(k).exists()]
    run.reporter.advance(len(items) - len(todo))
    run.map(make, todo)


def _make_surface(run: Run, work: "_Work") -> None:
    with reading(run.path(CLOUD)):
        cloud = copc_sample(run.path(CLOUD), world_origin(run.folder), _READ)
    if not len(cloud):
        raise ReconstructionError(f"{run.path(CLOUD)} has no point: look at the depth maps in the report")
    spacing = run.receipts.read("cloud")["counts"]["voxel"]
    run.path(FOLDER, SCRATCH).mkdir(parents=True, exist_ok=True)
    need_room(run.path(FOLDER, SCRATCH, "surface"), _BYTES * min(len(cloud), surface.MOST_POINTS))
    call = partial(run_in_child, log=run.log, task="COLMAP's surface")
    with scratch_folder(run.path(FOLDER, SCRATCH)) as scratch:
        found = surface.mesh_of(cloud, spacing, work.settings, work.tuning.surface, scratch, call)
    save_npz(work.path("surface"), **vars(found))


@dataclass(frozen=True, eq=False)
class _Work:
    """What a mesh is made of, and where what is finished of it is."""

    folder: Path
    pictures: Pictures
    settings: MeshSettings
    tuning: Tuning

    def path(self, kind: str, k: int | None = None) -> Path:
        return self.folder / FOLDER / SCRATCH / (f"{kind}.npz" if k is None else f"{kind}_{k}.npz")

    def page_path(self, k: int) -> Path:
        return self.folder / FOLDER / f"texture{k}.jpg"

    def layout(self) -> texture.Layout:
        return load_as(self.path("layout"), texture.Layout.from_npz)

    def nodes(self) -> texture.Nodes:
        return load_as(self.path("nodes"), texture.Nodes.from_npz)

    def mesh(self, kind: str = "mesh") -> surface.Mesh:
        return surface.Mesh(**load_npz(self.path(kind)))

    def make_view(self, k: int) -> None:
        view = self.pictures.views[k]
        own = known_depth(view.name, self.folder)
        mask = self.pictures.picture(k)[1]
        found = views.seen_by(view, self.mesh("surface"), mask, own, self.tuning.views)
        save_npz(self.path("view", k), **found.to_npz())

    def make_layout(self) -> None:
        """Which image gives each face its colour, without the faces that none saw; where they are on the textures."""
        whole = self.mesh("surface")
        seen = [load_as(self.path("view", k), views.Seen.from_npz) for k in range(len(self.pictures.views))]
        label = views.chosen(seen, whole, self.tuning.views)
        if (label == views.UNSEEN).all():
            raise ReconstructionError("no image sees the surface of the cloud: look at the masks in the report")
        for keep in (views.without_bubbles, lambda m, _: surface.without_strays(m, self.tuning.surface)):
            kept = keep(whole, label)
            whole, label = whole.of_faces(kept), label[kept]
        whole, kept = surface.trimmed_border(whole, self.tuning.surface.border_rounds)
        label = label[kept]
        layout = texture.laid_out(whole, label, self.pictures.views, self.settings.texture_px, self.tuning.texture.most)
        save_npz(self.path("mesh"), **vars(whole))
        save_npz(self.path("nodes"), **texture.nodes_of(whole, layout).to_npz())
        save_npz(self.path("layout"), **layout.to_npz())

    def make_colours(self, k: int) -> None:
        """The patches of an image, and its colours at their vertices; nothing if it has none."""
        layout = self.layout()
        if not (layout.image == k).any():
            return save_npz(self.path("colours", k))
        rgb = self.pictures.picture(k)[0]
        charts = texture.cut_out(rgb, layout, k)
        flat = np.concatenate([c.ravel() for c in charts])
        nodes, whole, view = self.nodes(), self.mesh(), self.pictures.views[k]
        edges = texture.edge_colours(rgb, whole, nodes, texture.own_sides(layout, nodes, k), view)
        faces = texture.face_colours(rgb, whole, texture.own_faces(layout, k), view)
        return save_npz(self.path("colours", k), charts=flat, edges=edges, faces=faces)

    def make_levels(self) -> None:
        """What is added to the colours of each patch, and the colours of the vertices."""
        layout, nodes, whole = self.layout(), self.nodes(), self.mesh()
        edges, faces = np.zeros((len(nodes.seam), 2, 3)), np.full(whole.corners.shape, np.nan)
        for k in np.unique(layout.image):
            found = load_npz(self.path("colours", k))
            edges[tuple(texture.own_sides(layout, nodes, k).T)] = found["edges"]
            faces[texture.own_faces(layout, k)] = found["faces"]
        change = texture.levelled(nodes, edges, self.tuning.texture)
        rgb = texture.vertex_mean(whole, nodes, change, faces)
        save_npz(self.path("levels"), change=change.astype(np.float32), rgb=rgb)

    def make_texture(self, page: int) -> None:
        layout, nodes, whole, levels = self.layout(), self.nodes(), self.mesh(), load_npz(self.path("levels"))
        place, page_of = texture.places(whole, layout, self.pictures.views)
        width, height = layout.pages[page]
        out = np.full((height, width, 3), 128, np.uint8)
        order = np.argsort(layout.patch, kind="stable")
        start = np.searchsorted(layout.patch[order], np.arange(len(layout.image) + 1))
        for p, chart in self._charts(layout, page):
            face = order[start[p] : start[p + 1]]
            corner = layout.at[p] - texture.PAD
            change = levels["change"][nodes.corner[face]]
            high, wide = chart.shape[:2]
            there = slice(corner[1], corner[1] + high), slice(corner[0], corner[0] + wide)
            out[there] = texture.levelled_chart(chart, place[face] - corner, change)
        bare = np.flatnonzero((layout.patch == views.UNSEEN) & (page_of == page))
        blocks = texture.bare_blocks(levels["rgb"][whole.corners[bare]])
        for (x, y), block in zip(layout.bare_at[layout.bare_page == page] - 1, blocks):
            out[y : y + 4, x : x + 4] = block
        write_atomic(self.page_path(page), cv2.imencode(".jpg", out[..., ::-1], texture.JPEG)[1].tobytes())

    def _charts(self, layout: texture.Layout, page: int) -> Iterator[tuple[int, np.ndarray]]:
        """(number, rectangle) of the patches on a texture."""
        for k in np.unique(layout.image[layout.page == page]):
            flat, done = load_npz(self.path("colours", k))["charts"], 0
            for p in np.flatnonzero(layout.image == k):
                wide, high = layout.inner[p] + 2 * texture.PAD
                if layout.page[p] == page:
                    yield int(p), flat[done : done + 3 * wide * high].reshape(high, wide, 3)
                done += 3 * wide * high


def _written(run: Run, work: _Work, layout: texture.Layout) -> Outcome:
    whole = work.mesh()
    place, page_of = texture.places(whole, layout, work.pictures.views)
    coloured = surface.Mesh(whole.xyz, whole.corners, load_npz(work.path("levels"))["rgb"])
    textured = files.Textured(coloured, place=place, texture=page_of, pages=layout.pages)
    said, lines = _said(run)
    pictures = [work.page_path(k) for k in range(len(layout.pages))]
    folder = run.path(FOLDER)
    save_json(folder / "offset.json", said)
    write_atomic(folder / "mesh.glb", files.glb(textured, [p.read_bytes() for p in pictures], said))
    write_atomic(folder / "mesh.mtl", files.mtl([p.name for p in pictures]))
    # Six digits of the size of the whole: tenths of a millimetre of a hundred metres
    decimals = int(np.clip(6 - np.floor(np.log10(max(float(np.ptp(whole.xyz, axis=0).max()), 1e-6))), 3, 12))
    with replacing(folder / "mesh.obj") as temporary, open(temporary, "wb") as file:
        file.writelines(files.obj(textured, "mesh.mtl", decimals, lines))
    write_atomic(folder / "mesh.ply", surface.ply_of(coloured, said=tuple(lines)))
    return _outcome(run, work, coloured, layout)


def _said(run: Run) -> tuple[dict[str, Any], list[str]]:
    """What leads from the files' coordinates to those of the CRS, and the same in lines (ASCII)."""
    said = offset_of(world_origin(run.folder), world_unit(run.folder))
    lines = [
        "tiegraph",
        f"crs {said['crs'] or 'none'}, unit {said['unit']}",
        "shift {!r} {!r} {!r} (to be added)".format(*said["shift"]),
    ]
    accuracy = accuracy_said(run, run.receipts.read("cloud")["counts"])
    said["accuracy"] = accuracy
    return said, [*lines, accuracy] if accuracy else lines


def _outcome(run: Run, work: _Work, whole: surface.Mesh, layout: texture.Layout) -> Outcome:
    cut = len(work.mesh("surface").corners) - len(whole.corners)
    counts: dict[str, float] = {
        "faces": len(whole.corners),
        "vertices": len(whole.xyz),
        "textures": len(layout.pages),
        "patches": len(layout.image),
        "images": len(np.unique(layout.image)),
        "unseen": int(np.count_nonzero(layout.patch == views.UNSEEN)),
        "cut": cut,
        "area": float(f"{np.linalg.norm(whole.across, axis=1).sum() / 2:.4g}"),
    }
    notes = []
    shrunk = (layout.inner / layout.size).min(axis=1)
    if (half := np.median(shrunk)) < 0.9:
        notes.append(f"half of the patches have {half:.0%} of their images' resolution or less (mesh.texture_px)")
    if cut:
        notes.append(f"{cut} faces at the border of the surface were cut off, for no image sees them")
    if world_unit(run.folder) != "m":
        notes.append("the model has no scale: lengths are in its own units")
    return Outcome(counts, notes=tuple(notes))


def write_mesh_tiles(run: Run, place: Place, target: Path) -> None:
    """Write the mesh of a run as tiles that replace each other, with their tree, into a new folder."""
    with reading(run.path(FOLDER, "mesh.glb")):
        found = files.Finished.read(run.path(FOLDER, "mesh.glb").read_bytes(), run.path(FOLDER, "mesh.ply"))
    whole = found.moved(place.tiles_from_world)
    target.mkdir()
    call = partial(run_in_child, log=run.log, task="COLMAP's simplification")

    def tile(faces: np.ndarray, name: str) -> Tile:
        below = files.branches(whole, faces)
        with scratch_folder(target) as scratch:
            made = files.coarse(whole, faces, scratch, call) if below else files.fine(whole, faces)
        (target / f"{name}.glb").write_bytes(made.glb)
        out = Tile(uri=f"{name}.glb", low=made.low, high=made.high, error=made.error)
        out.below = [tile(part, f"{name}{k}") for k, part in enumerate(below)]
        return out

    write_tree(tile(np.arange(len(whole.mesh.corners)), "t"), place, "REPLACE", target)
