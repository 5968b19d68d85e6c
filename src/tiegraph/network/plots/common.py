"""What the pictures of the network share: resolution, colours, PNG bytes."""

from __future__ import annotations

import io

import numpy as np
from matplotlib.backends.backend_agg import FigureCanvasAgg
from matplotlib.figure import Figure

DPI = 110
BLUE, RED, GREY, INK = "#1b6ca8", "#c0392b", "#9a9a9a", "#444444"


def png(figure: Figure) -> bytes:
    """A figure as PNG."""
    out = io.BytesIO()
    FigureCanvasAgg(figure).print_png(out)
    return out.getvalue()


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
