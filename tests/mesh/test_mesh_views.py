"""Which image a face has its colour from: one that sees it, that shows it best, and that its neighbours have too."""

from dataclasses import replace

import numpy as np
import pytest

import mesh_world as world
from tiegraph.geometry import transforms
from tiegraph.mesh.tuning import ViewTuning
from tiegraph.mesh.views import UNSEEN, Seen, chosen, patches, seen_by, without_bubbles

TUNING = ViewTuning()
ALL = np.ones((360, 480), bool)


@pytest.fixture(scope="module")
def mesh():
    return world.true_mesh(16)


@pytest.fixture(scope="module")
def seen(mesh):
    return [seen_by(v, mesh, ALL, world.depth_map(v), TUNING) for v in world.views()]


def middles(mesh):
    return mesh.xyz[mesh.corners].mean(axis=1)


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


def test_what_stands_before_the_mesh_in_the_image_is_not_its_colour(mesh, seen):
    view = world.views()[0]
    own = world.depth_map(view)
    person = own.depth_m.copy()
    person[150:220, 200:260] -= 1.5
    found = seen_by(view, mesh, ALL, replace(own, depth_m=person), TUNING)
    lost = np.setdiff1d(seen[0].face, found.face)
    x, y = view.project(middles(mesh))[0][lost].T
    assert len(lost) > 20 and (x > 195).all() and (x < 265).all() and (y > 145).all() and (y < 225).all()


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


def test_without_a_depth_map_an_image_counts_little(mesh, seen):
    bare = seen_by(world.views()[0], mesh, ALL, None, TUNING)
    assert set(seen[0].face) <= set(bare.face)
    assert bare.quality.max() < 0.1 * seen[0].quality.max()


def test_a_nearer_and_a_more_frontal_image_is_better(mesh):
    front, top = world.view("f", [2.0, -6.0, 1.0]), int(np.argmin(np.linalg.norm(middles(mesh) - [2, 0, 1], axis=1)))

    def quality(view):
        found = seen_by(view, mesh, ALL, None, TUNING)
        return dict(zip(found.face.tolist(), found.quality.tolist()))[top]

    assert quality(front) > quality(world.view("far", [2.0, -9.0, 1.0]))
    assert quality(front) > quality(world.view("oblique", [6.0, -4.5, 1.0]))


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
