"""Pictures: figures as PNG; pairs, depth maps and clouds as HTML for notebooks."""

from __future__ import annotations

import io
import warnings
from typing import TYPE_CHECKING

if TYPE_CHECKING:
    from matplotlib.figure import Figure


import base64
from collections.abc import Iterable, Sequence
from html import escape
from typing import Any

import cv2
import numpy as np


def png(figure: Figure) -> bytes:
    """A figure as PNG. Names of folders and cameras are not parsed as formulas (``$\\frac{`` would be an error), and
    letters that the font lacks are boxes without a warning for each."""
    import matplotlib
    from matplotlib.backends.backend_agg import FigureCanvasAgg
    from matplotlib.text import Text

    for text in figure.findobj(Text):
        text.set_parse_math(False)
    out = io.BytesIO()
    with matplotlib.rc_context({"text.parse_math": False}), warnings.catch_warnings():  # ticks are made when drawn
        warnings.filterwarnings("ignore", message="Glyph .* missing")
        FigureCanvasAgg(figure).print_png(out)
    return out.getvalue()


# --- notebooks --------------------------------------------------------------------------------------------------------


_SIDE_PX = 400


def table(said: str, rows: Iterable[Sequence[Any]]) -> str:
    """A heading and rows of cells."""
    lines = "".join(f"<tr>{''.join(f'<td>{escape(str(cell))}</td>' for cell in row)}</tr>" for row in rows)
    return f"<p>{escape(said)}</p><table>{lines}</table>"


def picture(said: str, bgr: np.ndarray) -> str:
    """A heading and an image (H, W, 3) u1."""
    data = base64.b64encode(cv2.imencode(".png", bgr)[1].tobytes()).decode()
    return f'<p>{escape(said)}</p><img src="data:image/png;base64,{data}">'


def depth_colours(depth: np.ndarray) -> np.ndarray:
    """(h, w, 3) u1 BGR of a depth map (H, W): near is bright, by inverse depth; grey = none."""
    scale = min(1.0, _SIDE_PX / max(depth.shape))
    size = (max(1, round(depth.shape[1] * scale)), max(1, round(depth.shape[0] * scale)))
    inverse = cv2.resize((1 / depth).astype(np.float32), size, interpolation=cv2.INTER_NEAREST)
    known = np.isfinite(inverse)
    low, high = np.percentile(inverse[known], (2, 98)) if known.any() else (0.0, 1.0)
    share = np.clip((np.where(known, inverse, low) - low) / max(high - low, 1e-12), 0, 1)
    colours = cv2.applyColorMap((255 * share).astype(np.uint8), cv2.COLORMAP_VIRIDIS)
    return np.where(known[..., None], colours, np.uint8(160))


def cloud_from_above(xyz: np.ndarray, rgb: np.ndarray) -> np.ndarray:
    """(h, w, 3) u1 BGR of points (M, 3) and their colours (M, 3) RGB seen against the third axis; white = no point."""
    low, high = np.percentile(xyz[:, :2], (0.5, 99.5), axis=0)
    pixel = max(float(np.max(high - low)) / _SIDE_PX, 1e-12)
    width, height = (np.ceil((high - low) / pixel).astype(int) + 1).tolist()
    column, row = np.floor((xyz[:, :2] - low) / pixel).astype(int).T
    inside = (column >= 0) & (column < width) & (row >= 0) & (row < height)
    order = np.flatnonzero(inside)[np.argsort(xyz[inside, 2], kind="stable")]  # the highest last
    out = np.full((height, width, 3), 255, np.uint8)
    out[height - 1 - row[order], column[order]] = rgb[order, ::-1]
    return out
