"""Figures of the benchmark of meshes, on a grid whose truth is known."""

import numpy as np
import pytest
from benchmarks.mesh import distance, judged

from tiegraph.mesh.surface import Mesh
from tiegraph.scene.results import Cloud


def _plane(width: int) -> Mesh:
    """Two triangles in each square of a grid in the plane z = 0, ``width`` x 10 squares of edge 1."""
    x, y = np.meshgrid(np.arange(width + 1.0), np.arange(11.0), indexing="ij")
    at = np.arange(x.size).reshape(x.shape)
    a, b, c, d = (v.ravel() for v in (at[:-1, :-1], at[1:, :-1], at[1:, 1:], at[:-1, 1:]))
    xyz = np.stack([x.ravel(), y.ravel(), 0 * x.ravel()], axis=1)
    return Mesh(
        xyz, np.concatenate([np.stack([a, b, c], 1), np.stack([a, c, d], 1)]), np.zeros((len(xyz), 3), np.uint8)
    )


def test_half_of_the_points_have_no_mesh_and_a_third_of_the_mesh_no_points() -> None:
    rng = np.random.default_rng(0)
    xyz = np.c_[rng.uniform(10, 50, 40_000), rng.uniform(0, 10, 40_000), np.full(40_000, 0.05)]
    sigma = np.full(len(xyz), 0.01, np.float32)
    cloud = Cloud(
        xyz, np.zeros((len(xyz), 3), np.uint8), np.zeros_like(xyz, np.float32), sigma, np.full(len(xyz), 3, np.uint8)
    )
    mesh = _plane(30)
    np.testing.assert_allclose(distance(mesh, xyz[xyz[:, 0] < 30][:500]), 0.05, atol=1e-9)
    found = judged(mesh, cloud, 0.2)
    assert found["completeness_%"] == pytest.approx(50, abs=2) and found["accuracy_%"] == pytest.approx(67, abs=3)
    assert found["faces"] == 600 and found["area"] == 300
