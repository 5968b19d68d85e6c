"""Predicted sigmas where observations share errors, and of long passes."""

from __future__ import annotations

import time

import numpy as np
import pytest
from benchmarks.network.matched import positions_free_gauge
from scipy import sparse
from scipy.spatial.transform import Rotation
from sfm_worlds import make_world, true_frames

from tiegraph.geometry import transforms
from tiegraph.geometry.align import umeyama
from tiegraph.geometry.transforms import skew
from tiegraph.scene.colmapmodel import image_poses, matrix
from tiegraph.sfm.adjustment.adjust import _solve
from tiegraph.sfm.adjustment.jacobians import Layout, jacobians
from tiegraph.sfm.adjustment.normal import Normal, by_blocks, gauge, point_inverse, reduced
from tiegraph.sfm.covariance import LENS, position_sigma
from tiegraph.sfm.model import frame_poses
from tiegraph.sfm.settings import SparseSettings
from tiegraph.sfm.systematic.mountings import two_sizes
from tiegraph.sfm.tuning import Tuning

import pycolmap  # isort: skip

TUNING = Tuning()

PLACE, TURN = 1e-3, 2e-4  # of cameras in their rig, units (the world has 5) and rad


class _Pass:
    """The unknowns of a pass of frames a unit apart, without images."""

    sensor: dict = {}
    camera: dict = {}
    sensor_centre: dict = {}

    def __init__(self, frames: int) -> None:
        at = np.arange(frames)
        self.centres = np.stack([at, 0.2 * np.sin(at / 7), 0.1 * np.cos(at / 11)], axis=1).astype(float)
        self.frame_ids, self.frame, self.size = tuple(range(frames)), {k: 6 * k for k in range(frames)}, 6 * frames

    def normal(self, reach: int = 3) -> sparse.csr_matrix:
        """Frames tied to the next ones to a hundredth and a thousandth."""
        frames, rows = len(self.frame_ids), []
        for d in range(1, reach + 1):
            for k in range(frames - d):  # shift of the second beside what a turn of the first does; turn of both
                row = np.zeros((6, self.size))
                row[:, 6 * k : 6 * k + 6] = -np.eye(6)
                row[:3, 6 * k + 3 : 6 * k + 6] = skew(self.centres[k + d] - self.centres[k])
                row[:, 6 * (k + d) : 6 * (k + d) + 6] = np.eye(6)
                rows.append(sparse.csr_matrix(row / np.repeat([0.01, 0.001], 3)[:, None]))
        every = sparse.vstack(rows).tocsr()
        return (every.T @ every).tocsr()


def test_sparse_solution_is_the_dense_one() -> None:
    """Of a short pass: the pseudo-inverse, similarities taken out of the positions."""
    world = _Pass(40)
    normal, motions = world.normal(), gauge(world)
    own = np.arange(world.size).reshape(-1, 6)[:, :3].ravel()
    keep = np.eye(len(own)) - motions[own] @ np.linalg.pinv(motions[own])
    # Shift and turn are motions of all unknowns (ties know the scale): any inverse will do, here with them made stiff.
    stiff = np.abs(normal.diagonal()).max() * motions[:, :6] @ motions[:, :6].T
    expected = keep @ np.linalg.inv(normal.toarray() + stiff)[np.ix_(own, own)] @ keep
    np.testing.assert_allclose(positions_free_gauge(normal, world), expected, atol=1e-6 * np.abs(expected).max())


@pytest.mark.slow
def test_a_pass_of_two_thousand_frames_has_sigmas() -> None:
    """Grows linearly: under ten seconds; a pass four times as long bends at its ends 4^1.5 to 4^2 times as far."""
    assert SparseSettings().covariance_frames >= 2000
    ends = []
    start = time.process_time()
    for frames in (500, 2000):
        world = _Pass(frames)
        factor = Normal(world.normal(), world)
        end = sparse.csc_matrix((np.ones(3), ([0, 1, 2], [0, 1, 2])), shape=(world.size, 3))
        asked = factor.asked(end)
        ends.append(float(np.sqrt(np.trace(asked.T @ factor.solve(asked)))))
    assert 4**1.4 < ends[1] / ends[0] < 4**2.1
    assert time.process_time() - start < 10


@pytest.fixture(scope="module")
def world(tmp_path_factory):
    return make_world(tmp_path_factory.mktemp("world") / "database.db", cameras=3, frames=8, noise_px=0.0, points=200)


def _drawn(truth: pycolmap.Reconstruction, seed: int, kind: str) -> pycolmap.Reconstruction:
    """A quarter of a pixel of noise, and what a kind of shared error adds; adjusted with the rig held."""
    model, rng = pycolmap.Reconstruction(truth), np.random.default_rng(seed)
    rig = {c: _off(rng) for c in truth.cameras}
    lens = {c: rng.standard_normal(4) for c in truth.cameras}
    for image_id in model.reg_image_ids():
        image = model.image(image_id)
        camera, pose = image.camera, matrix(image.cam_from_world())
        assert camera is not None
        if kind == "unrest":
            pose = pose @ transforms.rigid(np.eye(3), np.array([PLACE * rng.standard_normal(), 0, 0]))  # fires off time
        if kind == "mounting" and image.camera_id != 1:
            pose = rig[image.camera_id] @ pose
        seen = [k for k in range(image.num_points2D()) if image.points2D[k].has_point3D()]
        xyz = np.array([model.point3D(image.points2D[k].point3D_id).xyz for k in seen])
        xy = np.asarray(camera.img_from_cam(xyz @ pose[:3, :3].T + pose[:3, 3]))
        if kind == "lens":
            xy = xy + _unlike(xy, camera, lens[image.camera_id])
        for k, place in zip(seen, xy + 0.25 * rng.standard_normal(xy.shape)):
            image.points2D[k].xy = place
    _solve(model, list(model.rigs), set(), True, None, TUNING.adjust)
    return model


def _off(rng: np.random.Generator) -> np.ndarray:
    turn = Rotation.from_rotvec(TURN * rng.standard_normal(3)).as_matrix()
    return transforms.rigid(turn, PLACE * rng.standard_normal(3))


def _unlike(xy: np.ndarray, camera: pycolmap.Camera, by: np.ndarray) -> np.ndarray:
    """What a lens with other radial, decentring and scale terms does: half a pixel half way to the edge."""
    u = (xy - [camera.width / 2, camera.height / 2]) / (0.25 * camera.width)
    square = np.sum(u**2, axis=1, keepdims=True)
    tangential = by[1] * (square + 2 * u[:, :1] ** 2) * [1, 0] + by[1] * 2 * u[:, :1] * u[:, 1:] * [0, 1]
    return np.asarray(0.25 * (by[0] * square * u + tangential + by[2] * u * [1, -1] + by[3] * u[:, ::-1]))


@pytest.mark.slow
@pytest.mark.parametrize("kind", ["clean", "lens", "unrest", "mounting"])
def test_sigma_is_right_where_observations_share_errors(world, kind) -> None:
    """Positions, attitudes and points over two draws; what is shared is found, and nothing where there is nothing."""
    truth, scene = world
    true = true_frames(truth, scene)
    off = {"place": [], "turn": [], "point": []}
    for seed in range(2):
        model = _drawn(truth, seed, kind)
        found = position_sigma(model, False, False, tuning=TUNING)
        here = frame_poses(image_poses(model, scene), scene)
        fit = umeyama(here[:, :3, 3], true[:, :3, 3])
        turned = Rotation.from_matrix(fit.rotation @ here[:, :3, :3] @ np.swapaxes(true[:, :3, :3], 1, 2)).as_rotvec()
        xyz, exact = (np.array([m.point3D(k).xyz for k in found.points.ids]) for m in (model, truth))
        off["place"].append((_square(found.sigma), _square(fit(here[:, :3, 3]) - true[:, :3, 3])))
        off["turn"].append((_square(found.turn), _square(turned)))
        off["point"].append((_square(found.points.sigma), _square(fit(xyz) - exact)))
    low, high = (0.75, 1.35) if kind == "clean" else (0.5, 2.0)
    for what, pairs in off.items():
        predicted, actual = np.sum(pairs, axis=0)
        assert low < np.sqrt(predicted / actual) < high, (what, kind)
    assert found.scale is not None and 0 < found.scale < 0.05


def _square(values: np.ndarray) -> float:
    """Median of the squared lengths: one point far off says nothing of the others."""
    return float(np.median(np.sum(values**2, axis=1)))


@pytest.mark.slow
def test_what_a_lens_does_unlike_its_model_is_told(world) -> None:
    truth, _ = world
    told = position_sigma(_drawn(truth, 1, "lens"), False, False, tuning=TUNING).tables({1: "left"})
    assert LENS in told and len(told[LENS]["rows"][0]) == len(told[LENS]["columns"])
    assert all(row[-1] > 4 for row in told[LENS]["rows"])
    assert LENS not in position_sigma(_drawn(truth, 1, "clean"), False, False, tuning=TUNING).tables({})


def test_sizes_of_two_effects_are_found() -> None:
    """Sixty images with shifts of 2 and turns of 0.5, noise 1: both within a third; none where there is none."""
    rng = np.random.default_rng(0)
    information = np.tile(np.diag([1.0, 2, 1, 3, 1, 2]), (60, 1, 1))
    shifts = rng.standard_normal((60, 6)) * [2, 2, 2, 0.5, 0.5, 0.5]
    noise = rng.standard_normal((60, 6)) * np.sqrt(np.diagonal(information[0]))
    place, turn, gain = two_sizes(np.einsum("kij,kj->ki", information, shifts) + noise, information, information)
    assert np.sqrt(place) == pytest.approx(2, rel=0.33) and np.sqrt(turn) == pytest.approx(0.5, rel=0.33)
    assert gain > 100
    place, turn, gain = two_sizes(noise, information, information)
    assert place < 0.1 and turn < 0.1 and 0 <= gain < 5


@pytest.mark.slow
def test_a_part_of_many_frames_is_looked_at(world) -> None:
    """Places of the frames looked at are those of all; a long model names which."""
    truth, _ = world
    model = _drawn(truth, 0, "clean")
    seen = jacobians(model, Layout(model, False, False), sorted(model.point3D_ids()))
    assert len(seen.image) == len(seen.xy) == len(seen.lever) == len(seen.residual) // 2
    assert position_sigma(model, False, False, tuning=TUNING).frame_ids == tuple(sorted(model.reg_frame_ids()))
    assert TUNING.sigma.frames > model.num_reg_frames()


@pytest.mark.slow
def test_the_reduced_system_is_that_of_its_definition(world) -> None:
    """Unknowns that most points know are taken apart from those of frames, and in parts."""
    model = _drawn(world[0], 0, "clean")
    layout = Layout(model, True, True)
    seen = jacobians(model, layout, sorted(model.point3D_ids()))
    jc, jp, frames = seen.cameras.toarray(), seen.points.toarray(), 6 * model.num_reg_frames()
    known = jp.T @ jp
    assert 0 < frames < layout.size and np.linalg.matrix_rank(known) == len(known)
    crossed, inverse = (seen.points.T @ seen.cameras).tocsr(), by_blocks(point_inverse(seen.points))
    found = reduced(seen.cameras, crossed, inverse, frames).toarray()
    true = jc.T @ jc - jc.T @ jp @ np.linalg.solve(known, jp.T @ jc)
    assert np.abs(found - true).max() <= 1e-9 * np.abs(true).max()
