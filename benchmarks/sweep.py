"""Which constants matter: each number of the engines' Tuning a third down and up, and what that changes.

``python -m benchmarks.sweep --sets fountain-P11 boat --engines filter sfm.adjust -o FILE [--work DIR] [--most 10]``.
An engine or a group of one, with points. Counts stay whole, shares stay within 0 and 1; a value that the Tuning refuses
is left out and counted. The table lists the constants by the larger change of the trajectory error or of the registered
images. ``--groups`` moves all constants of a group together: nine hundred take days, and most groups move nothing; what
does is swept again without it.
"""

from __future__ import annotations

import argparse
import sys
import tempfile
from collections.abc import Iterator, Mapping
from pathlib import Path
from typing import Any

from pydantic import ValidationError

from benchmarks.variants import Book, Variant, load, run
from tiegraph.project.settings import Settings, Tunings
from tiegraph.settings import Section

BASE = Variant("base")
FACTORS = (2 / 3, 4 / 3)


def numbers(section: Section, where: str = "") -> Iterator[tuple[str, float | int]]:
    """Every number of a Tuning by its place, such as ``motion.trials``; tables of numbers are left as they are."""
    for name in type(section).model_fields:
        value, place = getattr(section, name), f"{where}.{name}".strip(".")
        if isinstance(value, Section):
            yield from numbers(value, place)
        elif isinstance(value, (int, float)) and not isinstance(value, bool) and value:
            yield place, value


def varied(place: str, value: float | int, factor: float) -> Variant | None:
    """The variant of one constant; None where the Tuning refuses it."""
    new: float | int = value * factor
    if isinstance(value, int):
        new = round(new)
        if new == value:
            new = value + (1 if factor > 1 else -1)
    settings: dict[str, Any] = {place.rpartition(".")[2]: new}
    for name in reversed(place.split(".")[:-1]):
        settings = {name: settings}
    try:
        Settings.model_validate({"tuning": settings})
    except ValidationError:
        return None
    return Variant(f"{place} {value:g} -> {new:g}", {"tuning": settings})


def grouped(asked: list[tuple[str, float | int]], factor: float) -> list[Variant]:
    """One variant a group, all its constants moved that the Tuning lets move, one after the other."""
    groups: dict[str, dict[str, Any]] = {}
    count: dict[str, int] = {}
    for place, value in asked:
        one, group = varied(place, value, factor), place.rpartition(".")[0]
        if one is None:
            continue
        both = _merged(groups.get(group, {}), one.settings)
        try:
            Settings.model_validate(both)
        except ValidationError:  # an order among them
            continue
        groups[group], count[group] = both, count.get(group, 0) + 1
    return [Variant(f"{g}: {count[g]} constants x {factor:.2f}", settings) for g, settings in groups.items()]


def _merged(a: Mapping[str, Any], b: Mapping[str, Any]) -> dict[str, Any]:
    return {**a, **{k: _merged(a.get(k, {}), v) if isinstance(v, Mapping) else v for k, v in b.items()}}


def main(argv: list[str] | None = None) -> int:
    """Command line; 0."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sets", nargs="+", required=True)
    parser.add_argument("--engines", nargs="+", help="engines or groups, such as verify or sfm.adjust (default: all)")
    parser.add_argument("--groups", action="store_true", help="all constants of a group at once")
    parser.add_argument("--work", type=Path, help="a folder that keeps the base runs")
    parser.add_argument("--most", type=int, default=10, help="constants in the table")
    parser.add_argument("-o", "--output", type=Path, required=True)
    args = parser.parse_args(argv)
    asked = [(p, v) for p, v in numbers(Tunings()) if _within(p, args.engines)]
    variants: list[Variant | None] = [varied(place, value, factor) for place, value in asked for factor in FACTORS]
    if args.groups:
        variants = [v for factor in FACTORS for v in grouped(asked, factor)]
    cache = Book(args.output)
    with tempfile.TemporaryDirectory() as scratch:
        work = args.work or Path(scratch)
        for name in args.sets:
            dataset, base = load(name, work), work / "base" / name
            if not cache.has(name, BASE.name) or not base.exists():
                cache.add(name, BASE, 0, run(dataset, base, {}))
            for variant in (v for v in variants if v is not None and not cache.has(name, v.name)):
                cache.add(name, variant, 0, run(dataset, work / "variant", variant.settings, base))
    refused = sum(v is None for v in variants)
    sys.stdout.write(f"{len(asked)} constants, {refused} values refused\n{table(cache, args.sets, args.most)}\n")
    return 0


def _within(place: str, engines: list[str] | None) -> bool:
    return engines is None or any(place == e or place.startswith(f"{e}.") for e in engines)


def table(cache: Book, names: list[str], most: int) -> str:
    """The constants that change most, over all sets."""
    changes: dict[str, list[str]] = {}
    size: dict[str, float] = {}
    for name in names:
        base = cache.of(name, BASE.name)[0]
        for row in (r for r in cache.rows if r["set"] == name and r["variant"] != BASE.name):
            if row["status"] != "done":
                size[row["variant"]] = float("inf")
                changes.setdefault(row["variant"], []).append(f"{name}: {row['status'][:60]}")
                continue
            lost = (base["registered"] - row["registered"]) / max(base["registered"], 1)
            moved = (row["ate_m"] or 0.0) / max(base["ate_m"] or 0.0, 1e-12) - 1
            size[row["variant"]] = max(size.get(row["variant"], 0.0), abs(lost), abs(moved))
            text = f"{name}: {row['registered']} images, ATE {100 * moved:+.0f} %"
            changes.setdefault(row["variant"], []).append(text)
    ordered = sorted(size, key=lambda v: -size[v])[:most]
    return "\n".join(["| constant | |", "|---|---|", *(f"| `{v}` | {'; '.join(changes[v])} |" for v in ordered)])


if __name__ == "__main__":
    sys.exit(main())
