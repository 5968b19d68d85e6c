"""Share of pairs kept against accuracy, every design method: ``python -m benchmarks.network.design_simulated``.

Choices are made on previews (12 % of the points), judged by the exact covariance of the bundle adjustment over the full
tracks: position sigma of the images relative to that of all candidate pairs. Rig: five cameras, a corridor there and
back, all pairs. Video: one camera around a structure, window 20 (paper 002).
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np

from benchmarks.network.simulated import Survey, position_sigma, survey
from tiegraph import papers
from tiegraph.design.design import METHODS, choose, design
from tiegraph.design.matchprediction import expected_matches
from tiegraph.design.settings import DesignSettings
from tiegraph.design.tracks import Candidates
from tiegraph.design.tuning import Tuning
from tiegraph.scene.graph import forest
from tiegraph.scene.matches import PreviewMatches
from tiegraph.scene.pairs import Pairs

TUNING = Tuning(few_pairs=0)
for name in papers.DESIGNS:
    papers.plug_in(papers.DESIGNS, name, METHODS)
SHARES = {"rig": (0.05, 0.1, 0.15, 0.2, 0.4), "video": (0.12, 0.2, 0.3, 0.4, 0.6)}


def orders(world: Survey, most: int, seed: int) -> dict[str, np.ndarray]:
    """Candidates in the order each method takes them, ``most`` of them, as rows of the pair table."""
    rng = np.random.default_rng(seed)
    pairs, ties = world.pairs(), world.ties()
    i, j, score = pairs.i, pairs.j, pairs.score.astype(float)
    tree = forest(i, j, score, len(world))
    third = rng.random(len(pairs)) < 1 / 3
    blind = pairs.with_(score=np.where(third, score, np.nan), overlap=score / 200)
    some_ties = ties.where(third)
    guess = expected_matches(blind, some_ties, TUNING.match_prediction)
    counted = Candidates.make(i, j, score, ties, len(world))

    def after(rest: np.ndarray) -> np.ndarray:
        return np.concatenate([tree, rest[~np.isin(rest, tree)]])

    def drawn(c: Candidates) -> np.ndarray:
        return choose(c, forest(c.i, c.j, c.expected, c.images), most, TUNING)[0]

    return {
        "random + forest": after(rng.permutation(len(pairs))),
        "most matches + forest": after(np.argsort(-score, kind="stable")),
        "top (round robin)": _by_top(world, pairs, ties),
        "hybrid": drawn(counted),
        "hybrid, 1/3 previewed": drawn(Candidates.make(i, j, guess, some_ties, len(world))),
    }


def _by_top(world: Survey, pairs: Pairs, ties: PreviewMatches) -> np.ndarray:
    """The pairs of method top with one pair an image, then two, ..."""
    taken: list[int] = []
    for k in range(1, 60):
        settings = DesignSettings(method="top", pairs_per_image=k)
        kept = design(pairs, world.scene, ties, settings, TUNING).pairs.dropped == 0
        taken += [int(r) for r in np.flatnonzero(kept) if r not in set(taken)]
    return np.array(taken)


def table(kind: str, seed: int, rigid: bool, budgets_only: bool = False) -> None:
    """Print sigma relative to all pairs for every method and share, and what the budgets choose."""
    world = survey(kind, seed)
    pairs, ties = world.pairs(), world.ties()
    total = len(pairs)
    everything = position_sigma(world, np.arange(total), rigid)
    shares = SHARES[kind]
    _say(f"\n{kind}, seed {seed}: {len(world)} images, {total} candidates, sigma of all {1000 * everything:.2f} mm")
    _say(f"{'share of pairs kept':26}", *[f"{s:7.2f}" for s in shares])
    taken = {} if budgets_only else orders(world, round(max(shares) * total), seed)
    for name, order in taken.items():
        figures = [position_sigma(world, order[: round(s * total)], rigid) / everything for s in shares]
        _say(f"{name:26}", *[f"{f:7.2f}" for f in figures])
    third = np.random.default_rng(seed).random(total) < 1 / 3
    partly = pairs.with_(score=np.where(third, pairs.score, np.nan), overlap=pairs.score / 200)
    for label, settings, own, known in (
        ("hybrid, loss 2 %", DesignSettings(loss_percent=2), pairs, ties),
        ("hybrid, loss 5 %", DesignSettings(), pairs, ties),
        ("hybrid, loss 20 %", DesignSettings(loss_percent=20), pairs, ties),
        ("hybrid 1/3 seen, loss 5 %", DesignSettings(), partly, ties.where(third)),
        ("fuse2014", DesignSettings(method="fuse2014"), pairs, ties),
        ("fuse2014_safe", DesignSettings(method="fuse2014_safe"), pairs, ties),
    ):
        began = time.process_time()
        found = design(own, world.scene, known, settings, TUNING)
        seconds = time.process_time() - began
        rows = np.flatnonzero(found.pairs.dropped == 0)
        ratio = position_sigma(world, rows, rigid) / everything
        extra = f"predicted loss {found.counts.get('preview_loss_percent', np.nan):5.1f} %"
        extra += f", {int(found.counts.get('pieces', found.counts['components']))} components"
        _say(f"{label:26} kept {len(rows) / total:.3f}, sigma x {ratio:.3f}, {extra}, {seconds:.2f} CPU s")


def _say(*words: object) -> None:
    sys.stdout.write(" ".join(str(w) for w in words) + "\n")
    sys.stdout.flush()


def main() -> None:
    """Print the tables."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--kind", choices=["rig", "video", "both"], default="both")
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--rigid", action="store_true", help="the rig is known: six unknowns a frame")
    parser.add_argument("--budgets-only", action="store_true", help="leave out the table by share of pairs")
    given = parser.parse_args()
    for kind in ("rig", "video") if given.kind == "both" else (given.kind,):
        table(kind, given.seed, given.rigid and kind == "rig", given.budgets_only)


if __name__ == "__main__":
    main()
