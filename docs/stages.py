"""Draws the table of stages as `docs/stages.svg`: `python docs/stages.py` writes it anew after a change of the table.

One row a stage, in the order of `tiegraph.pipeline.STAGES`. What the next stage needs is the arrow between two boxes;
what later stages need runs down in a lane of its own at the left, with an arrow into each of them. Plain SVG text, so
that nothing but the table decides about a byte of it.
"""

from collections.abc import Sequence
from html import escape
from pathlib import Path

from tiegraph.pipeline import STAGES
from tiegraph.project.stages import Stage

OUT = Path(__file__).with_name("stages.svg")
ROW, BOX, LANE = 44, 30, 18  # heights of a row and of a box, distance of two lanes
BOX_WIDTH, WIDTH, TOP, MARGIN = 96, 780, 38, 6
COLOURS = ("#1f77b4", "#d62728", "#2ca02c", "#9467bd", "#b35900", "#17808a", "#c2378c", "#5f5f5f", "#7a7a00")


def consumers(stages: Sequence[Stage]) -> dict[int, list[int]]:
    """Row of a stage -> rows of the stages that need it."""
    return {row: [k for k, t in enumerate(stages) if s.name in t.needs] for row, s in enumerate(stages)}


def lanes(needed: dict[int, list[int]]) -> dict[int, int]:
    """Row of a stage -> its lane, counted from the boxes; a lane is used again below the last arrow out of it."""
    out: dict[int, int] = {}
    free_from: list[int] = []  # of each lane
    for row, to in needed.items():
        if max(to, default=0) <= row + 1:
            continue
        lane = next((k for k, end in enumerate(free_from) if end <= row), len(free_from))
        free_from[lane:] = [max(to), *free_from[lane + 1 :]]
        out[row] = lane
    return out


def drawing(stages: Sequence[Stage] = STAGES) -> str:
    """The picture."""
    needed = consumers(stages)
    lane_of = lanes(needed)
    left = MARGIN + LANE * (max(lane_of.values(), default=0) + 2)
    height = TOP + ROW * len(stages) + 8
    middle = left + BOX_WIDTH / 2
    text = left + BOX_WIDTH + 18
    parts = [
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="0 0 {WIDTH} {height}" width="{WIDTH}" height="{height}" '
        'font-family="Helvetica, Arial, sans-serif" font-size="14">',
        "<title>The stages of tiegraph, what each needs and what it makes</title>",
        f'<rect width="{WIDTH}" height="{height}" fill="#ffffff"/>',
        f'<g font-size="12" fill="#555555"><text x="{left}" y="24">stage</text><text x="{text}" y="24">needs</text>'
        f'<text x="{text + 230}" y="24">makes (below the run folder)</text></g>',
    ]
    for row, to in needed.items():
        colour = COLOURS[row % len(COLOURS)]
        if row + 1 in to:
            parts.append(_arrow(f"M{middle:g} {_middle(row) + BOX / 2:g}V{_middle(row + 1) - BOX / 2:g}", colour))
        if row in lane_of:
            x = left - LANE * (lane_of[row] + 1) - 4
            ends = [_entry(needed, row, k) for k in to if k > row + 1]
            parts.append(_line(f"M{left} {_middle(row) + 10:g}H{x}V{ends[-1]:g}", colour))
            for y in ends:
                dot = f'<circle cx="{x}" cy="{y:g}" r="2.5" fill="{colour}"/>'
                parts.append(_arrow(f"M{x} {y:g}H{left}", colour) + dot)
    for row, stage in enumerate(stages):
        y = _middle(row)
        needs = ", ".join(stage.needs) or "what you hand over"
        makes = ", ".join((*stage.makes, *(f"rows in {name}" for name in stage.changes)))
        parts.append(
            f'<rect x="{left}" y="{y - BOX / 2:g}" width="{BOX_WIDTH}" height="{BOX}" rx="4" fill="#f3f6fa" '
            f'stroke="{COLOURS[row % len(COLOURS)]}" stroke-width="1.5"/>'
            f'<text x="{middle:g}" y="{y + 5:g}" text-anchor="middle" font-weight="bold">{escape(stage.name)}</text>'
            f'<text x="{text}" y="{y + 5:g}" font-size="13">{escape(needs)}</text>'
            f'<text x="{text + 230}" y="{y + 5:g}" font-size="12" font-family="monospace">'
            f"{escape(makes)}</text>"
        )
    return "\n".join([*parts, "</svg>", ""])


def _entry(needed: dict[int, list[int]], source: int, row: int) -> float:
    """Height at which the lane of a source enters the box of a row: those of several sources lie below each other."""
    through_lanes = [k for k in range(row - 1) if row in needed[k]]
    return _middle(row) - BOX / 2 + 4 + 6 * through_lanes.index(source)


def _middle(row: int) -> float:
    return TOP + ROW * row + BOX / 2


def _line(path: str, colour: str) -> str:
    return f'<path d="{path}" fill="none" stroke="{colour}" stroke-width="1.5"/>'


def _arrow(path: str, colour: str) -> str:
    """A line with a head at its end; it ends to the right or downwards."""
    end = path.split("M")[1]
    if "H" in end:
        x, y = float(end.split("H")[1]), float(end.split("H")[0].split()[1])
        head = f"M{x:g} {y:g}l-6 -2.8v5.6z"
    else:
        x, y = float(end.split()[0]), float(end.split("V")[1])
        head = f"M{x:g} {y:g}l-3.5 -6h7z"
    return f'{_line(path, colour)}<path d="{head}" fill="{colour}"/>'


if __name__ == "__main__":
    OUT.write_text(drawing())
