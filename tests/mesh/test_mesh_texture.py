"""Textures and files: colours of the truth, seams levelled, patches that do not overlap, files that others open."""

import io

import numpy as np
import pytest
import trimesh
from PIL import Image

import mesh_world as world
from tiegraph.errors import ReconstructionError
from tiegraph.mesh.files import Textured, glb, mtl, obj
from tiegraph.mesh.texture import (
    PAD,
    bare_blocks,
    cut_out,
    edge_colours,
    face_colours,
    laid_out,
    levelled,
    levelled_chart,
    nodes_of,
    own_faces,
    own_sides,
    places,
    vertex_mean,
)
from tiegraph.mesh.tuning import TextureTuning, ViewTuning
from tiegraph.mesh.views import UNSEEN, chosen, seen_by

ALL = np.ones((360, 480), bool)
VIEWS = world.views()
GAINS = np.where(np.arange(len(VIEWS)) % 2, 0.8, 1.15)


@pytest.fixture(scope="module")
def mesh():
    return world.true_mesh(16)


@pytest.fixture(scope="module")
def label(mesh):
    return chosen([seen_by(v, mesh, ALL, world.depth_map(v), ViewTuning()) for v in VIEWS], mesh, ViewTuning())


def painted(mesh, label, edge=4096, most=4, gains=GAINS**0, level=True, stripes=25.0):
    """(pages, where corners are on them, the texture of each face, layout) of a mesh."""
    layout = laid_out(mesh, label, VIEWS, edge, most)
    nodes = nodes_of(mesh, layout)
    pictures = [world.picture(v, g, stripes) for v, g in zip(VIEWS, gains)]
    edges, faces = np.full((len(nodes.seam), 2, 3), np.nan), np.full(mesh.corners.shape, np.nan)
    for k in np.unique(layout.image):
        sides = own_sides(layout, nodes, k)
        edges[tuple(sides.T)] = edge_colours(pictures[k], mesh, nodes, sides, VIEWS[k])
        faces[own_faces(layout, k)] = face_colours(pictures[k], mesh, own_faces(layout, k), VIEWS[k])
    assert np.isfinite(edges).all() and (np.isfinite(faces).all(axis=1) == (layout.patch != UNSEEN)).all()
    change = levelled(nodes, edges, TextureTuning()) if level else np.zeros((len(nodes.vertex), 3))
    place, texture = places(mesh, layout, VIEWS)
    pages = [np.zeros((h, w, 3), np.uint8) for w, h in layout.pages]
    for k in np.unique(layout.image):
        for p, chart in zip(np.flatnonzero(layout.image == k), cut_out(pictures[k], layout, k)):
            x, y = layout.at[p] - PAD
            face = np.flatnonzero(layout.patch == p)
            done = levelled_chart(chart, place[face] - layout.at[p] + PAD, change[nodes.corner[face]])
            pages[layout.page[p]][y : y + done.shape[0], x : x + done.shape[1]] = done
    blocks = bare_blocks(vertex_mean(mesh, nodes, change, faces)[mesh.corners[layout.patch == UNSEEN]])
    for page, (x, y), block in zip(layout.bare_page, layout.bare_at - 1, blocks):
        pages[page][y : y + 4, x : x + 4] = block
    return pages, place, texture, layout


def shown(pages, place, texture, weight):
    """Colours (F, 3) of the textures at places within faces, by the weights (3,) of their corners."""
    at = np.einsum("k,nkc->nc", weight, place).astype(int)
    return np.array([pages[t][y, x] for t, (x, y) in zip(texture, at)]).astype(float)


@pytest.mark.parametrize("edge", [4096, 256])
def test_textures_have_the_colours_of_the_truth(mesh, label, edge):
    pages, place, texture, layout = painted(mesh, label, edge=edge, most=4 if edge > 256 else 3)
    assert len(pages) <= 3 and all(max(p.shape[:2]) <= edge for p in pages)
    for weight in np.array([[1, 1, 1], [0.6, 0.3, 0.1]]) / [[3], [1]]:
        truth = world.colour(np.einsum("k,nkc->nc", weight, mesh.xyz[mesh.corners]))
        off = np.abs(shown(pages, place, texture, weight) - np.clip(truth, 0, 255)).max(axis=1)
        assert np.median(off) < (4 if edge > 256 else 8)
        assert np.mean(off < 20) > (0.93 if edge > 256 else 0.8)  # the others lie at the edge of a stripe


def test_rectangles_do_not_overlap(mesh, label):
    bare = label.copy()
    bare[::7] = UNSEEN
    layout = laid_out(mesh, bare, VIEWS, 512, 4)
    taken = [np.zeros((h, w), int) for w, h in layout.pages]
    for p, (x, y), (w, h) in zip(layout.page, layout.at - PAD, layout.inner + 2 * PAD):
        taken[p][y : y + h, x : x + w] += 1
        assert taken[p][y : y + h, x : x + w].shape == (h, w)
    for p, (x, y) in zip(layout.bare_page, layout.bare_at - 1):
        taken[p][y : y + 4, x : x + 4] += 1
    assert max(t.max() for t in taken) == 1 and len(layout.bare_at) == (bare == UNSEEN).sum()


def test_too_many_patches_for_a_texture_are_refused(mesh):
    alone = np.random.default_rng(0).integers(0, len(VIEWS), len(mesh.corners))
    with pytest.raises(ReconstructionError, match="raise --mesh.texture-px"):
        laid_out(mesh, alone, VIEWS, 64, 1)


def seams(mesh, label, pages, place, texture):
    """Differences of the colours that two patches have at the ends of an edge that they share."""
    pairs = mesh.neighbours()
    pairs = pairs[label[pairs[:, 0]] != label[pairs[:, 1]]]
    out = []
    for a, b in pairs:
        for vertex in set(mesh.corners[a]) & set(mesh.corners[b]):
            at = [place[f][mesh.corners[f] == vertex][0] for f in (a, b)]
            both = [pages[texture[f]][int(y), int(x)].astype(float) for f, (x, y) in zip((a, b), at)]
            out.append(np.abs(both[0] - both[1]).max())
    return np.median(out)


def test_exposures_are_levelled_across_seams(mesh, label):
    raw = painted(mesh, label, gains=GAINS, level=False, stripes=0)
    level = painted(mesh, label, gains=GAINS, stripes=0)
    before, after = seams(mesh, label, *raw[:3]), seams(mesh, label, *level[:3])
    assert before > 20 and after < before / 3


def test_colours_that_agree_stay(mesh, label):
    layout = laid_out(mesh, label, VIEWS, 4096, 4)
    nodes = nodes_of(mesh, layout)
    vertex, patch = nodes.vertex[nodes.seam], nodes.patch[nodes.seam]
    assert len(vertex) > 50 and (vertex[:, :2] == vertex[:, 2:]).all() and (vertex[:, 0] != vertex[:, 1]).all()
    assert (
        (patch[:, 0] == patch[:, 1]).all() and (patch[:, 2] == patch[:, 3]).all() and (patch[:, 0] != patch[:, 2]).all()
    )
    same = np.repeat(world.colour(mesh.xyz[vertex[:, 0]])[:, None], 2, axis=1)
    change = levelled(nodes, same, TextureTuning())
    assert np.abs(change).max() < 1e-6
    faces = world.colour(mesh.xyz[mesh.corners].mean(axis=1), 0)
    off = vertex_mean(mesh, nodes, change, faces) - world.colour(mesh.xyz, 0)
    assert np.abs(off).max() < 12
    assert (vertex_mean(mesh, nodes, change, np.full_like(faces, np.nan)) == mesh.rgb).all()


def colour_of(mesh):
    return world.colour(mesh.xyz)


def test_unseen_faces_have_the_colours_of_their_vertices(mesh, label):
    bare = label.copy()
    bare[::5] = UNSEEN
    pages, place, texture, layout = painted(mesh, bare)
    own = np.flatnonzero(layout.patch == UNSEEN)
    assert len(own) >= len(label) / 5
    off = np.abs(shown(pages, place[own], texture[own], np.array([1, 0, 0])) - colour_of(mesh)[mesh.corners[own, 0]])
    assert np.median(off) < 15


@pytest.fixture(scope="module")
def files(mesh, label, tmp_path_factory):
    """A folder with all files of a mesh on several textures."""
    folder = tmp_path_factory.mktemp("files")
    far = type(mesh)(mesh.xyz + [1234.567, -987.654, 12.345], mesh.corners, mesh.rgb)
    pages, place, texture, layout = painted(mesh, label, edge=256, most=3)
    textured = Textured(far, place=place, texture=texture, pages=layout.pages)
    for k, page in enumerate(pages):
        buffer = io.BytesIO()
        Image.fromarray(page).save(buffer, "JPEG", quality=95)
        (folder / f"texture{k}.jpg").write_bytes(buffer.getvalue())
    names = [f"texture{k}.jpg" for k in range(len(pages))]
    (folder / "mesh.glb").write_bytes(glb(textured, [(folder / n).read_bytes() for n in names], {"crs": "EPSG:32654"}))
    (folder / "mesh.obj").write_bytes(b"".join(obj(textured, "mesh.mtl", 5, ["crs EPSG:32654"])))
    (folder / "mesh.mtl").write_text(mtl(names))
    return folder, far, len(pages)


def parts_of(loaded):
    """The corners (F, 3, 3) of faces in their scene's frame, and the colours of their middles by the textures."""
    corners, colours = [], []
    for part in loaded.dump() if isinstance(loaded, trimesh.Scene) else [loaded]:
        corners.append(part.triangles)
        look = part.visual.material
        picture = np.asarray(getattr(look, "baseColorTexture", None) or look.image)
        uv = part.visual.uv[part.faces].mean(axis=1)
        column, row = (uv[:, 0] * picture.shape[1]).astype(int), ((1 - uv[:, 1]) * picture.shape[0]).astype(int)
        colours.append(picture[row, column, :3])
    return np.concatenate(corners), np.concatenate(colours).astype(float)


@pytest.mark.parametrize("name", ["mesh.glb", "mesh.obj"])
def test_other_programs_open_the_files(files, name):
    folder, mesh, pages = files
    loaded = trimesh.load(folder / name, process=False)
    corners, colours = parts_of(loaded)
    if name == "mesh.glb":  # y up
        corners = np.stack([corners[..., 0], -corners[..., 2], corners[..., 1]], axis=-1)
    truth = mesh.xyz[mesh.corners]
    assert pages > 1 and corners.shape == truth.shape
    order = [np.lexsort(np.round(c.mean(axis=1), 2).T) for c in (corners, truth)]
    assert np.abs(np.sort(corners[order[0]], axis=1) - np.sort(truth[order[1]], axis=1)).max() < 0.001
    middle = corners.mean(axis=1) - [1234.567, -987.654, 12.345]
    off = np.abs(colours - np.clip(world.colour(middle), 0, 255)).max(axis=1)
    assert np.median(off) < 10
