"""How far what looks like sky lies above the rest: ``python benchmarks/masks/above.py uav_forest camvid canal_demo``.

Of the length of its edges, what faces down more than up, over all level cameras of a set; ``masks.above`` asks for a
quarter. The truth is not opened.
"""

from __future__ import annotations

import argparse
import sys
from collections.abc import Mapping, Sequence
from pathlib import Path
from unittest import mock

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import tiegraph  # noqa: F401  before pycolmap
from benchmarks.masks.measure import load
from tiegraph.masks import learnt
from tiegraph.masks.learnt import not_above
from tiegraph.masks.settings import MasksSettings
from tiegraph.masks.tuning import LabelTuning, Tuning


def above(name: str) -> float:
    """The share (-1..1) of a set; NaN if nothing looks like sky."""
    data, told = load(name), (0.0, 0.0)

    def spied(edges: Mapping[int, Sequence[tuple[float, float]]], tuning: LabelTuning) -> set[int]:
        nonlocal told
        told = tuple(sum(e[n] for own in edges.values() for e in own) for n in (0, 1))
        return not_above(edges, tuning)

    keys = {c: k for k, c in enumerate(data.cameras)}
    images = {keys[c]: [data.folder / n for n in names] for c, names in data.cameras.items()}
    with mock.patch.object(learnt, "not_above", spied):
        learnt.learn(images, MasksSettings(source="learnt"), Tuning(), [keys[c] for c in data.upward])
    return told[0] / told[1] if told[1] else float("nan")


if __name__ == "__main__":
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("sets", nargs="+")
    for chosen in parser.parse_args().sets:
        print(f"{chosen}: {above(chosen):.2f}", flush=True)  # noqa: T201
