"""The funnel: how many pairs each filter leaves (paper 002, table 1)."""

from __future__ import annotations

import numpy as np
from matplotlib.figure import Figure

from tiegraph.network.plots.common import BLUE, DPI, grouped, png
from tiegraph.scene.pairs import REASON_LOOKS, Pairs


def funnel_steps(pairs: Pairs, images: int) -> list[tuple[str, int, int, str]]:
    """(what, pairs left, pairs dropped, colour of the dropped) from all pairs of ``images`` to the used ones."""
    funnel = pairs.funnel()
    every = images * (images - 1) // 2
    left = funnel["candidates"]
    steps = [("all pairs of images", every, 0, BLUE), ("candidates", left, 0, BLUE)]
    for reason, count in funnel.items():
        if reason not in ("candidates", "used"):
            left -= count
            words, colour = REASON_LOOKS[reason]
            steps.append((f"without: {words}", left, count, colour))
    return [*steps, ("used", funnel["used"], 0, BLUE)]


def funnel_table(pairs: Pairs, images: int) -> dict:
    """Receipt table of the funnel: step, pairs dropped, pairs left, share of all pairs."""
    steps = funnel_steps(pairs, images)
    every = max(1, steps[0][1])
    rows = [[name, dropped or None, left, round(100 * left / every, 2)] for name, left, dropped, _ in steps]
    return {"columns": ["step", "dropped", "left", "% of all pairs"], "rows": rows}


def funnel_png(pairs: Pairs, images: int) -> bytes:
    """Bars of what is left after each filter, with what it dropped; all pairs of images are only a number."""
    (_, every, _, _), *steps = funnel_steps(pairs, images)
    figure = Figure(figsize=(9.5, 0.95 + 0.36 * len(steps)), dpi=DPI, layout="constrained")
    axes = figure.add_subplot()
    y = np.arange(len(steps))
    names, left, dropped, colours = zip(*steps)
    axes.barh(y, left, color=BLUE, height=0.68)
    axes.barh(y, dropped, left=left, color=list(colours), height=0.68, edgecolor="#b0b0b0", lw=0.5)
    top = max(max(left), 1)
    for k, (value, lost) in enumerate(zip(left, dropped)):
        text = grouped(value) + (f"   (\N{MINUS SIGN}{grouped(lost)})" if lost else "")
        axes.text(value + lost + 0.01 * top, k, text, va="center", fontsize=9)
    axes.set_yticks(y, names)
    axes.invert_yaxis()
    axes.set_xlim(0, 1.2 * top)
    axes.set_xlabel("pairs of images")
    for side in ("top", "right"):
        axes.spines[side].set_visible(False)
    share = 100 * left[-1] / max(every, 1)
    axes.set_title(f"From {grouped(every)} pairs of images to {grouped(left[-1])} ({share:.1f} %)", loc="left")
    return png(figure)
