"""What the pictures of the network share: resolution, colours, borders of cells."""

import numpy as np

DPI = 110
BLUE, RED, INK = "#1b6ca8", "#c0392b", "#444444"


def edges_of(nodes: np.ndarray) -> np.ndarray:
    """(K + 1,) borders of cells around rising numbers (K,): half way to the neighbours."""
    nodes = np.asarray(nodes, float)
    if len(nodes) < 2:
        return np.array([nodes[0] - 0.5, nodes[0] + 0.5]) if len(nodes) else np.zeros(1)
    middle = 0.5 * (nodes[:-1] + nodes[1:])
    return np.r_[2 * nodes[0] - middle[0], middle, 2 * nodes[-1] - middle[-1]]


def grouped(number: float) -> str:
    """A whole number with spaces between thousands."""
    return f"{round(number):,}".replace(",", " ")
