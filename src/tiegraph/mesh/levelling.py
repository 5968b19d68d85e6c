"""Colours of patches made equal where they meet.

What is added to the colours of a patch varies smoothly over it, so that two patches agree along their border (Lempitsky
and Ivanov 2007; Waechter, Moehrle and Goesele 2014): least squares over all vertices of all patches.
"""

import numpy as np
from scipy.sparse import coo_matrix, diags
from scipy.sparse.linalg import cg

from tiegraph.mesh.texture import Nodes
from tiegraph.mesh.tuning import TextureTuning
from tiegraph.mesh.views import UNSEEN

_HELD = 1e-4  # weight by which colours stay: what no border tells
_CLOSE, _MOST_ROUNDS = 1e-4, 1000  # of conjugate gradients


def levelled(nodes: Nodes, colour: np.ndarray, tuning: TextureTuning) -> np.ndarray:
    """(N, 3) what is added to the colours (N, 3) of nodes."""
    count = len(nodes.vertex)
    if not count:
        return np.zeros((0, 3))
    across = _across(nodes)
    corner = nodes.corner[nodes.corner[:, 0] != UNSEEN]
    inside = np.unique(np.sort(corner[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1), axis=0)
    ends = np.concatenate([across, inside])
    weight = np.concatenate([np.ones(len(across)), np.full(len(inside), tuning.smooth)])
    links = coo_matrix((weight, ends.T), (count, count)).tocsr()
    links = links + links.T
    system = diags(np.asarray(links.sum(axis=1)).ravel() + _HELD) - links
    wanted = np.zeros((count, 3))
    step = colour[across[:, 1]] - colour[across[:, 0]]
    np.add.at(wanted, across[:, 0], step)
    np.subtract.at(wanted, across[:, 1], step)
    inverse = diags(1 / system.diagonal())
    solved = [cg(system, wanted[:, c], rtol=_CLOSE, maxiter=_MOST_ROUNDS, M=inverse)[0] for c in range(3)]
    return np.stack(solved, axis=1)


def _across(nodes: Nodes) -> np.ndarray:
    """(E, 2) pairs of nodes of one vertex in different patches."""
    order = np.argsort(nodes.vertex, kind="stable")
    same = np.flatnonzero(nodes.vertex[order][1:] == nodes.vertex[order][:-1])
    return np.stack([order[same], order[same + 1]], axis=1)


def vertex_mean(nodes: Nodes, colour: np.ndarray, rgb: np.ndarray) -> np.ndarray:
    """(V, 3) u1 colours of the vertices: the mean of their nodes', and ``rgb`` (V, 3) where they have none."""
    total = np.zeros(rgb.shape)
    np.add.at(total, nodes.vertex, colour)
    count = np.bincount(nodes.vertex, minlength=len(rgb))[:, None]
    mean = np.where(count > 0, total / np.maximum(count, 1), rgb)
    return np.clip(np.rint(mean), 0, 255).astype(np.uint8)
