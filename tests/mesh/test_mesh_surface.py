"""From points to triangles: near the truth on both sides, open where there are no points, as coarse as asked for."""

from dataclasses import replace

import numpy as np
import pytest
from scipy.spatial import cKDTree

import mesh_world as world
from tiegraph.errors import ReconstructionError
from tiegraph.mesh.settings import MeshSettings
from tiegraph.mesh.surface import Mesh, mesh_of, pieces, ply_of, read_ply, thinned, trimmed_border
from tiegraph.mesh.tuning import SurfaceTuning

TUNING = SurfaceTuning()


def here(function, *args):
    return function(*args)


def made(cloud, folder, **settings):
    folder.mkdir(exist_ok=True)
    return mesh_of(cloud, world.SPACING, MeshSettings(**settings), TUNING, folder, here)


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


def test_the_surface_is_the_box_on_both_sides(box):
    off = world.distance(sampled(box))
    assert np.quantile(off, 0.9) < 2 * world.NOISE_M and off.max() < 3 * world.SPACING
    missed = cKDTree(sampled(box)).query(world.surface()[0])[0]
    assert np.quantile(missed, 0.99) < world.SPACING


def test_it_is_open_where_no_points_are_and_faces_outwards(box):
    middle = box.xyz[box.corners].mean(axis=1)
    under = (np.abs(middle[:, 2]) < 0.3) & (np.abs(middle[:, :2] - world.SIZE[:2] / 2) < 0.5).all(axis=1)
    assert not under.any() and middle[:, 2].min() > -0.4
    outward = np.einsum("nk,nk->n", box.normals, middle - world.SIZE / 2)
    assert (outward > 0).mean() > 0.99 and len(np.unique(pieces(len(box.corners), box.neighbours()))) == 1


def test_vertices_have_the_colours_of_the_points(box):
    off = np.abs(box.rgb - np.clip(world.colour(box.xyz), 0, 255))
    assert np.median(off) < 6


def test_a_coarser_mesh_keeps_the_shape(box, tmp_path):
    coarse = made(world.cloud(), tmp_path / "scratch", faces=1500)
    assert len(coarse.corners) <= 1500 < len(box.corners) / 4
    assert np.quantile(world.distance(sampled(coarse)), 0.9) < 0.02


def test_the_same_points_make_the_same_mesh(box, tmp_path):
    again = made(world.cloud(), tmp_path / "scratch")
    assert (again.xyz == box.xyz).all() and (again.corners == box.corners).all()


def test_uncertain_points_end_the_surface(tmp_path):
    cloud = world.cloud()
    doubtful = cloud.xyz_m[:, 0] > 2.5
    unsure = replace(cloud, sigma_m=np.where(doubtful, np.float32(0.2), cloud.sigma_m))
    cut = made(unsure, tmp_path / "scratch", max_sigma_m=0.1)
    assert 2.4 < cut.xyz[:, 0].max() < 2.5 + 4 * 2 * world.SPACING
    assert made(unsure, tmp_path / "all").xyz[:, 0].max() > 3.9


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
    smooth, kept = trimmed_border(teeth, TUNING.border_rounds)

    def length(of):
        edges, count = np.unique(np.sort(of.corners[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)), axis=0, return_counts=True)
        ends = of.xyz[edges[count == 1]]
        return np.linalg.norm(ends[:, 0] - ends[:, 1], axis=1).sum()

    assert len(kept) == len(teeth.corners) and kept.mean() > 0.95 and len(smooth.corners) == kept.sum()
    assert length(smooth) < 0.9 * length(teeth) and world.distance(smooth.xyz).max() < 0.08
    inner = smooth.xyz[:, 2] > 0.5
    assert np.isin(np.round(smooth.xyz[inner], 9), np.round(mesh.xyz, 9)).all()
    assert (trimmed_border(teeth, 0)[0].xyz == teeth.xyz).all()
