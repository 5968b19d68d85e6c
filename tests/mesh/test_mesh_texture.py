"""From points to triangles; which image a face has its colour from; textures and files that others open."""

import io
from dataclasses import replace

import numpy as np
import pytest
import trimesh
from PIL import Image
from scipy.spatial import cKDTree

import mesh_world as world
from tiegraph.errors import ReconstructionError
from tiegraph.geometry import transforms
from tiegraph.mesh.files import Textured, glb, mtl, obj
from tiegraph.mesh.settings import MeshSettings
from tiegraph.mesh.surface import Mesh, mesh_of, pieces, ply_of, read_ply, thinned, trimmed_border
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
from tiegraph.mesh.tuning import SurfaceTuning, TextureTuning, ViewTuning
from tiegraph.mesh.views import UNSEEN, Seen, chosen, patches, seen_by, without_bubbles

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


@pytest.mark.slow
@pytest.mark.parametrize("edge", [4096, 256])
def test_textures_have_the_colours_of_the_truth(mesh, label, edge):
    pages, place, texture, layout = painted(mesh, label, edge=edge, most=4 if edge > 256 else 3)
    assert len(pages) <= 3 and all(max(p.shape[:2]) <= edge for p in pages)
    for weight in np.array([[1, 1, 1], [0.6, 0.3, 0.1]]) / [[3], [1]]:
        truth = world.colour(np.einsum("k,nkc->nc", weight, mesh.xyz[mesh.corners]))
        off = np.abs(shown(pages, place, texture, weight) - np.clip(truth, 0, 255)).max(axis=1)
        assert np.median(off) < (4 if edge > 256 else 8)
        assert np.mean(off < 20) > (0.93 if edge > 256 else 0.8)  # the others lie at the edge of a stripe


@pytest.mark.slow
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


@pytest.mark.slow
def test_exposures_are_levelled_across_seams(mesh, label):
    raw = painted(mesh, label, gains=GAINS, level=False, stripes=0)
    level = painted(mesh, label, gains=GAINS, stripes=0)
    before, after = seams(mesh, label, *raw[:3]), seams(mesh, label, *level[:3])
    assert before > 20 and after < before / 3


@pytest.mark.slow
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


@pytest.mark.slow
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


@pytest.mark.slow
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


TUNING = ViewTuning()


@pytest.fixture(scope="module")
def seen(mesh):
    return [seen_by(v, mesh, ALL, world.depth_map(v), TUNING) for v in world.views()]


def middles(mesh):
    return mesh.xyz[mesh.corners].mean(axis=1)


@pytest.mark.slow
def test_an_image_sees_what_faces_it_and_nothing_hides(mesh, seen):
    """The truth: a ray from the camera, or through a pixel beside, meets the box there first."""
    for view, found in zip(world.views(), seen):
        depth = world.seen(view)[0]
        xy, z = view.project(middles(mesh))
        column, row = np.clip(xy.astype(int), 1, [478, 358]).T
        around = [depth[row + y, column + x] for y in (-1, 0, 1) for x in (-1, 0, 1)]
        truly = (np.abs(np.array(around) - z) < 0.1).any(axis=0)
        got = np.zeros(len(truly), bool)
        got[found.face] = True
        hidden = (got & ~truly)[found.face]  # behind an edge by less than a face: such an image hardly counts
        assert hidden.sum() < 10 and found.quality[hidden].max(initial=0.0) < 0.01 * np.median(found.quality)
        towards = transforms.centre(view.cam_from_world) - middles(mesh)
        plain = truly & (np.einsum("nk,nk->n", towards, mesh.normals) > 0.1 * np.linalg.norm(towards, axis=1))
        assert (got & plain).sum() > 0.95 * plain.sum()


@pytest.mark.slow
def test_what_stands_before_the_mesh_in_the_image_is_not_its_colour(mesh, seen):
    view = world.views()[0]
    own = world.depth_map(view)
    person = own.depth_m.copy()
    person[150:220, 200:260] -= 1.5
    found = seen_by(view, mesh, ALL, replace(own, depth_m=person), TUNING)
    lost = np.setdiff1d(seen[0].face, found.face)
    x, y = view.project(middles(mesh))[0][lost].T
    assert len(lost) > 20 and (x > 195).all() and (x < 265).all() and (y > 145).all() and (y < 225).all()


@pytest.mark.slow
def test_masks_are_respected_and_faces_beside_them_count_less(mesh, seen):
    view = world.views()[0]
    mask = ALL.copy()
    mask[:, 240:] = False
    found = seen_by(view, mesh, mask, world.depth_map(view), TUNING)
    assert len(found.face) and (view.project(middles(mesh))[0][found.face, 0] < 240).all()
    before = dict(zip(seen[0].face.tolist(), seen[0].quality.tolist()))
    share = np.array([q / before[f] for f, q in zip(found.face.tolist(), found.quality.tolist())])
    beside = view.project(middles(mesh))[0][found.face, 0] > 232
    assert (share <= 1.0001).all() and (share[beside] < 0.6).all() and np.median(share) > 0.95


@pytest.mark.slow
def test_without_a_depth_map_an_image_counts_little(mesh, seen):
    bare = seen_by(world.views()[0], mesh, ALL, None, TUNING)
    assert set(seen[0].face) <= set(bare.face)
    assert bare.quality.max() < 0.1 * seen[0].quality.max()


@pytest.mark.slow
def test_a_nearer_and_a_more_frontal_image_is_better(mesh):
    front, top = world.view("f", [2.0, -6.0, 1.0]), int(np.argmin(np.linalg.norm(middles(mesh) - [2, 0, 1], axis=1)))

    def quality(view):
        found = seen_by(view, mesh, ALL, None, TUNING)
        return dict(zip(found.face.tolist(), found.quality.tolist()))[top]

    assert quality(front) > quality(world.view("far", [2.0, -9.0, 1.0]))
    assert quality(front) > quality(world.view("oblique", [6.0, -4.5, 1.0]))


@pytest.mark.slow
def test_neighbours_agree_on_few_images(mesh, seen):
    label = chosen(seen, mesh, TUNING)
    shown = [set(s.face.tolist()) for s in seen]
    assert (label != UNSEEN).mean() > 0.97
    assert all(face in shown[k] for face, k in enumerate(label) if k != UNSEEN)
    alone = chosen(seen, mesh, TUNING.model_copy(update={"rounds": 0, "least_faces": 1}))
    count = [len(np.unique(patches(each, mesh.neighbours()))) for each in (label, alone)]
    assert count[0] <= 14 and count[0] <= count[1]
    best = {k: 0.0 for k in range(len(label))}
    got = dict.fromkeys(best, 0.0)
    for v, s in enumerate(seen):
        for f, q in zip(s.face.tolist(), s.quality.tolist()):
            best[f] = max(best[f], q)
            got[f] = q if label[f] == v else got[f]
    assert np.mean([got[f] / best[f] for f in best if best[f]]) > 0.85


def test_small_patches_go_to_their_neighbours(mesh):
    """Two images that are equally good by turns, face by face."""
    rng = np.random.default_rng(0)
    every = np.arange(len(mesh.corners))
    noisy = [Seen(every, rng.uniform(0.9, 1.1, len(every)).astype(np.float32)) for _ in range(2)]
    label = chosen(noisy, mesh, TUNING)
    size = np.bincount(patches(label, mesh.neighbours()))
    assert size[size > 0].min() >= TUNING.least_faces and len(size) < len(every) / 50


def test_nothing_seen_is_no_image(mesh):
    nothing = Seen(np.zeros(0, int), np.zeros(0, np.float32))
    assert (chosen([nothing], mesh, TUNING) == UNSEEN).all() and (chosen([], mesh, TUNING) == UNSEEN).all()


def test_what_no_image_sees_goes_at_the_border_and_stays_within(mesh):
    label = np.zeros(len(mesh.corners), int)
    x, y, z = middles(mesh).T
    crack = (z > 1.99) & (np.hypot(x - 2, y - 1.5) < 0.4)
    rim = (z < 0.3) & (y < 0.01)
    label[crack | rim] = UNSEEN
    kept = without_bubbles(mesh, label)
    assert crack.any() and rim.any() and kept[crack].all() and not kept[rim].any() and kept[~rim].all()


TUNING_SURFACE = SurfaceTuning()


def here(function, *args):
    return function(*args)


def made(cloud, folder, **settings):
    folder.mkdir(exist_ok=True)
    return mesh_of(cloud, world.SPACING, MeshSettings(**settings), TUNING_SURFACE, folder, here)


def sampled(mesh, count=40_000, seed=0):
    """Places all over a mesh."""
    rng = np.random.default_rng(seed)
    area = np.linalg.norm(mesh.across, axis=1)
    face = rng.choice(len(area), count, p=area / area.sum())
    a, b = np.sort(rng.uniform(size=(2, count)), axis=0)
    weight = np.stack([a, b - a, 1 - b], axis=1)
    return np.einsum("nk,nkc->nc", weight, mesh.xyz[mesh.corners[face]])


@pytest.fixture(scope="module")
def box(tmp_path_factory):
    return made(world.cloud(), tmp_path_factory.mktemp("box") / "scratch")


@pytest.mark.slow
def test_the_surface_is_the_box_on_both_sides(box):
    off = world.distance(sampled(box))
    assert np.quantile(off, 0.9) < 2 * world.NOISE_M and off.max() < 3 * world.SPACING
    missed = cKDTree(sampled(box)).query(world.surface()[0])[0]
    assert np.quantile(missed, 0.99) < world.SPACING


@pytest.mark.slow
def test_it_is_open_where_no_points_are_and_faces_outwards(box):
    middle = box.xyz[box.corners].mean(axis=1)
    under = (np.abs(middle[:, 2]) < 0.3) & (np.abs(middle[:, :2] - world.SIZE[:2] / 2) < 0.5).all(axis=1)
    assert not under.any() and middle[:, 2].min() > -0.4
    outward = np.einsum("nk,nk->n", box.normals, middle - world.SIZE / 2)
    assert (outward > 0).mean() > 0.99 and len(np.unique(pieces(len(box.corners), box.neighbours()))) == 1


@pytest.mark.slow
def test_vertices_have_the_colours_of_the_points(box):
    off = np.abs(box.rgb - np.clip(world.colour(box.xyz), 0, 255))
    assert np.median(off) < 6


@pytest.mark.slow
def test_a_coarser_mesh_keeps_the_shape(box, tmp_path):
    coarse = made(world.cloud(), tmp_path / "scratch", faces=1500)
    assert len(coarse.corners) <= 1500 < len(box.corners) / 4
    assert np.quantile(world.distance(sampled(coarse)), 0.9) < 0.02


@pytest.mark.slow
def test_the_same_points_make_the_same_mesh(box, tmp_path):
    again = made(world.cloud(), tmp_path / "scratch")
    assert (again.xyz == box.xyz).all() and (again.corners == box.corners).all()


@pytest.mark.slow
def test_uncertain_points_end_the_surface(tmp_path):
    cloud = world.cloud()
    doubtful = cloud.xyz_m[:, 0] > 2.5
    unsure = replace(cloud, sigma_m=np.where(doubtful, np.float32(0.2), cloud.sigma_m))
    cut = made(unsure, tmp_path / "scratch", max_sigma_m=0.1)
    assert 2.4 < cut.xyz[:, 0].max() < 2.5 + 4 * 2 * world.SPACING
    assert made(unsure, tmp_path / "all").xyz[:, 0].max() > 3.9


@pytest.mark.slow
def test_points_far_away_are_bridged_or_left_out(tmp_path):
    cloud = world.cloud()
    gap = np.linalg.norm(cloud.xyz_m - [2.0, 1.5, 2.0], axis=1) < 0.15
    hole = np.linalg.norm(cloud.xyz_m - [2.0, 0.0, 1.0], axis=1) < 0.8
    mesh = made(cloud.where(~gap & ~hole), tmp_path / "scratch")
    near = cKDTree(sampled(mesh))
    assert near.query([2.0, 1.5, 2.0])[0] < 0.1 and near.query([2.0, 0.0, 1.0])[0] > 0.4


def test_no_surface_of_no_points(tmp_path):
    cloud = world.cloud()
    blind = replace(cloud, normal=np.full_like(cloud.normal, np.nan))
    with pytest.raises(ReconstructionError, match="0 points of .* have a normal"):
        made(blind, tmp_path / "a")
    with pytest.raises(ReconstructionError, match=r"raise --mesh.max-sigma-m \(0.001\)"):
        made(cloud, tmp_path / "b", max_sigma_m=0.001)


def test_points_are_thinned_to_means_by_their_sigmas():
    cloud = world.cloud().where(np.arange(2))
    two = replace(
        cloud,
        xyz_m=np.array([[0.1, 0.1, 0.1], [0.4, 0.1, 0.1]]),
        sigma_m=np.array([1.0, 2.0], np.float32),
        normal=np.array([[0, 0, 1], [0, 0, 1]], np.float32),
    )
    one = thinned(two, 1.0)
    assert np.allclose(one.xyz_m, [[0.16, 0.1, 0.1]]) and one.sigma_m.tolist() == [1.0]
    assert np.allclose(one.normal, [[0, 0, 1]]) and len(thinned(two, 0.2)) == 2


def test_a_mesh_comes_back_from_its_ply(tmp_path):
    mesh = world.true_mesh(3)
    (tmp_path / "m.ply").write_bytes(ply_of(mesh, said=("crs none",)))
    back = read_ply(tmp_path / "m.ply")
    assert (back.xyz == mesh.xyz).all() and (back.corners == mesh.corners).all() and (back.rgb == mesh.rgb).all()


def test_neighbours_share_an_edge():
    mesh = world.true_mesh(2)
    pairs = mesh.neighbours()
    shared = [len(set(mesh.corners[a]) & set(mesh.corners[b])) for a, b in pairs]
    assert set(shared) == {2}
    faces, border = len(mesh.corners), 4 * 2
    assert len(pairs) == (3 * faces - border) / 2
    alone = mesh.of_faces(np.arange(faces) < 1)
    assert len(alone.xyz) == 3 and isinstance(alone, Mesh) and not len(alone.neighbours())


def test_teeth_at_the_border_go():
    """A strip whose lower border is cut in teeth: it becomes a line, and what lies within stays where it is."""
    mesh = world.true_mesh(16)
    middle = mesh.xyz[mesh.corners].mean(axis=1)
    row = np.abs(middle[:, 2] - 0.0625) < 0.0625
    teeth = mesh.of_faces(~(row & (np.arange(len(row)) % 2 == 0)))
    smooth, kept = trimmed_border(teeth, TUNING_SURFACE.border_rounds)

    def length(of):
        edges, count = np.unique(np.sort(of.corners[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)), axis=0, return_counts=True)
        ends = of.xyz[edges[count == 1]]
        return np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).sum()

    assert len(kept) == len(teeth.corners) and kept.mean() > 0.95 and len(smooth.corners) == kept.sum()
    assert length(smooth) < 0.9 * length(teeth) and world.distance(smooth.xyz).max() < 0.08
    inner = smooth.xyz[:, 2] > 0.5
    assert np.isin(np.round(smooth.xyz[inner], 9), np.round(mesh.xyz, 9)).all()
    assert (trimmed_border(teeth, 0)[0].xyz == teeth.xyz).all()
