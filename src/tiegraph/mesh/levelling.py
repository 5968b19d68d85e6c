"""Colours of patches made equal where they meet.

What is added to the colours of a patch varies smoothly over it, so that two patches agree along their border (Lempitsky
and Ivanov 2007; Waechter, Moehrle and Goesele 2014): least squares over all vertices of all patches.
"""

import numpy as np
from scipy.sparse import coo_matrix, csr_matrix, diags, identity
from scipy.sparse.linalg import cg

from tiegraph.mesh.surface import Mesh
from tiegraph.mesh.texture import Nodes
from tiegraph.mesh.tuning import TextureTuning
from tiegraph.mesh.views import UNSEEN

_HELD = 1e-4  # weight by which colours stay: what no border tells
_CLOSE, _MOST_ROUNDS = 1e-4, 1000  # of conjugate gradients


def levelled(nodes: Nodes, edges: np.ndarray, tuning: TextureTuning) -> np.ndarray:
    """(N, 3) what is added to the colours of nodes, by the colours (S, 2, 3) that both patches of each seam have along
    it."""
    count = len(nodes.vertex)
    if not count:
        return np.zeros((0, 3))
    corner = nodes.corner[nodes.corner[:, 0] != UNSEEN]
    inside = np.unique(np.sort(corner[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    across = _rows(nodes.seam, np.array([0.5, 0.5, -0.5, -0.5]), count)
    along = _rows(inside, np.sqrt(tuning.smooth) * np.array([1.0, -1.0]), count)
    system = (across.T @ across + along.T @ along + _HELD * identity(count)).tocsr()
    wanted = across.T @ (edges[:, 1] - edges[:, 0])
    inverse = diags(1 / system.diagonal())
    solved = [cg(system, wanted[:, c], rtol=_CLOSE, maxiter=_MOST_ROUNDS, M=inverse)[0] for c in range(3)]
    return np.stack(solved, axis=1)


def _rows(nodes: np.ndarray, weights: np.ndarray, count: int) -> csr_matrix:
    """(M, count) of equations between nodes (M, K) with weights (K,)."""
    row = np.repeat(np.arange(len(nodes)), nodes.shape[1])
    return coo_matrix((np.tile(weights, len(nodes)), (row, nodes.ravel())), (len(nodes), count)).tocsr()


def vertex_mean(mesh: Mesh, nodes: Nodes, change: np.ndarray, faces: np.ndarray) -> np.ndarray:
    """(V, 3) u1 colours of the vertices: the mean of the colours (F, 3) of the faces around, NaN = not known, with what
    was added to them; that of the mesh where none is known."""
    known = np.isfinite(faces[:, 0])
    level = faces[known] + change[nodes.corner[known]].mean(axis=1)
    total = np.zeros(mesh.rgb.shape)
    for k in range(3):
        np.add.at(total, mesh.corners[known, k], level)
    count = np.bincount(mesh.corners[known].ravel(), minlength=len(total))[:, None]
    mean = np.where(count > 0, total / np.maximum(count, 1), mesh.rgb)
    return np.clip(np.rint(mean), 0, 255).astype(np.uint8)
