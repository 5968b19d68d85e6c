"""What each subsystem buys: it is switched off or replaced, on each set, and the figures stand beside those with it.

``python -m benchmarks.ablate --sets boat canal_demo fountain-P11 -o FILE [--only NAME ...] [--repeat 3] [--work DIR]``.
Rows are kept after each run; what has a row is not run again. The table says by how much a figure of a variant differs
from the base; what lies within the base's own spread buys nothing there.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from pathlib import Path
from typing import Any

from benchmarks.variants import Book, Variant, load, median, run, spread

BASE = Variant("base")
_RIGID = {"prior_test": {"held_to_m": 1e9}, "diagnostics": {"min_scatter_px": 1e9, "min_kept": 0}}
VARIANTS = (
    Variant("rig check off", {"tuning": {"network": {"rig": {"frames": 0}}}}, "given order believed"),
    Variant("offsets constant", {"candidates": {"offsets": "constant"}}, "one offset for each two passes (paper 000)"),
    Variant("offsets none", {"candidates": {"sources": ["sequence", "retrieval"]}}, "neighbours and look-alikes only"),
    Variant("retrieval off", {"candidates": {"sources": ["sequence", "offsets"]}}, "no look-alikes"),
    Variant("coarse model off", {"coarse": {"method": "off"}}, "counts of preview matches decide"),
    Variant("trust off", {"tuning": {"network": {"coarse": {"tries": 1}}}}, "the first coarse model is taken"),
    Variant("minimum cut off", {"tuning": {"design": {"wanted": 0.01}}}, "no pairs to hold the parts"),
    Variant("law of matches off", {"tuning": {"design": {"match_prediction": {"least_previewed": 10**9}}}}, "usual"),
    Variant("design even where cheap", {"tuning": {"design": {"few_pairs": 0.0}}}, "small sets are chosen from"),
    Variant("design top", {"design": {"method": "top", "pairs_per_image": 20}}, "the 20 best pairs of an image"),
    Variant("design top 10", {"design": {"method": "top", "pairs_per_image": 10}}, "the 10 best pairs of an image"),
    Variant("design all", {"design": {"method": "all"}}, "every candidate is matched"),
    Variant("sections split", {"network": {"sections": "split"}}, "sections mapped separately, then joined"),
    Variant("start from nothing", {"sparse": {"mapper": "global"}}, "COLMAP's global mapper"),
    Variant("rig held", {"sparse": {"rig": "fixed"}}, "never in its own time nor adjusted"),
    Variant("times not found", {"tuning": {"sfm": {"rig": _RIGID}}}, "cameras of a rig fire at one instant"),
    Variant("rig not confronted", {"tuning": {"sfm": {"rig": {"prior_test": {"strong": 1e12}}}}}, "nothing is doubted"),
    Variant("placement not tested", {"tuning": {"sfm": {"placement": {"max_left_out": 0}}}}, "nothing is left out"),
    Variant("rig absent", {"sparse": {"rig": "absent"}}, "images map one by one"),
    Variant("lever-arm prior off", {"tuning": {"sfm": {"adjust": {"lever_arms": {"least_others": 10**6}}}}}, "none"),
    Variant("robust adjustment off", {"tuning": {"sfm": {"adjust": {"robust_rounds": 0}}}}, "plain least squares"),
    Variant("few points off", {"tuning": {"sfm": {"adjust": {"few_points": {"worth": 0.0}}}}}, "all points at once"),
    Variant("masks none", {"masks": {"source": "none"}}, "nothing masked"),
    Variant("masks not refuted", {"tuning": {"masks": {"matchability": {"near": 1e9}}}}, "no class is taken back"),
    Variant("masks of paper 000", {"masks": {"source": "meguro2024"}}, "two-image difference"),
    Variant("masks of paper 001", {"masks": {"source": "meguro2025"}}, "two stages"),
)  # fmt: skip
_KEYS = ("registered", "ate_m", "cpu_s", "predicted_over_actual")


def main(argv: list[str] | None = None) -> int:
    """Command line; 0 if every run came to its end."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sets", nargs="+", required=True)
    parser.add_argument("--only", nargs="+", choices=[v.name for v in VARIANTS], help="some subsystems")
    parser.add_argument("--repeat", type=int, default=1, help="runs of the base from nothing, and of each variant")
    parser.add_argument("--work", type=Path, help="a folder that keeps the base runs")
    parser.add_argument("-o", "--output", type=Path, required=True)
    args = parser.parse_args(argv)
    cache = Book(args.output)
    with tempfile.TemporaryDirectory() as scratch:
        work = args.work or Path(scratch)
        for name in args.sets:
            dataset, base = load(name, work), work / "base" / name
            for repeat in range(args.repeat):
                out = base if repeat == 0 else work / "again"
                if not cache.has(name, BASE.name, repeat) or (repeat == 0 and not base.exists()):
                    cache.add(name, BASE, repeat, run(dataset, out, {}))
            for variant in (v for v in VARIANTS if args.only is None or v.name in args.only):
                for repeat in range(args.repeat):
                    if not cache.has(name, variant.name, repeat):
                        cache.add(name, variant, repeat, run(dataset, work / "variant", variant.settings, base))
    sys.stdout.write(table(cache, args.sets) + "\n")
    return int(any(r["status"] != "done" for r in cache.rows if r["set"] in args.sets))


def table(cache: Book, names: list[str]) -> str:
    """A table a set: each variant, and how it differs from the base."""
    lines = []
    for name in names:
        base = cache.of(name, BASE.name)
        lines += [f"\n{name}: base {_said(base)}; spread of {len(base)} runs {spread(base, 'ate_m'):.4f} m\n"]
        lines += ["| variant | registered | ATE | CPU | predicted / actual | |", "|---|---|---|---|---|---|"]
        for variant in VARIANTS:
            rows = cache.of(name, variant.name)
            if rows:
                lines.append(f"| {variant.name} | {_cells(rows, base)} | {variant.what} |")
    return "\n".join(lines)


def _said(rows: list[dict[str, Any]]) -> str:
    values = [median(rows, key) for key in _KEYS]
    return ", ".join(f"{key} {'-' if v is None else f'{v:.4g}'}" for key, v in zip(_KEYS, values))


def _cells(rows: list[dict[str, Any]], base: list[dict[str, Any]]) -> str:
    if any(r["status"] != "done" for r in rows):
        return f"{next(r['status'] for r in rows if r['status'] != 'done')[:60]} | | | "
    there = [(median(rows, key), median(base, key)) for key in _KEYS]
    (registered, _), (ate, ate0), (cpu, cpu0), (ratio, _) = there
    more = "-" if ate is None or not ate0 else f"{1000 * ate:.1f} mm ({100 * (ate / ate0 - 1):+.0f} %)"
    cost = "-" if cpu is None or not cpu0 else f"{cpu:.0f} s ({100 * (cpu / cpu0 - 1):+.0f} %)"
    return f"{registered:.0f} | {more} | {cost} | {'-' if ratio is None else f'{ratio:.2f}'}"


if __name__ == "__main__":
    sys.exit(main())
