"""The counts of the bench: verdicts by fault, the silent failures one by one, false alarms on clean sets."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.confront.judge import VERDICTS


def table(rows: Sequence[dict[str, Any]]) -> str:
    """Markdown: a row a fault, a column a verdict; then the figure that counts and every silent failure."""
    faults = sorted({r["fault"] for r in rows}, key=lambda f: (f == "clean", f))
    lines = [f"| fault | cases | {' | '.join(VERDICTS)} |", "|---|---|" + "---|" * len(VERDICTS)]
    for fault in [*faults, None]:
        own = [r for r in rows if fault is None or r["fault"] == fault]
        count = Counter(r["verdict"] for r in own)
        cells = " | ".join(str(count[v] or ".") for v in VERDICTS)
        lines.append(f"| {fault or 'all'} | {len(own)} | {cells} |")
    spoilt = [r for r in rows if r["fault"] != "clean"]
    clean = [r for r in rows if r["fault"] == "clean"]
    silent = [r for r in spoilt if r["verdict"] == "silent"]
    hedged = sum(r["verdict"] == "said" and "hedge" in r["how"] for r in spoilt)
    alarms = sum(r["verdict"] == "alarm" for r in clean)
    quiet = sum(r["verdict"] == "silent" for r in clean)
    lines += [
        "",
        f'silent failures: {len(silent)} of {len(spoilt)} cases; said only by a sigma or "cannot be told": {hedged}',
        f"clean sets: {len(clean)}, wrong in silence {quiet}, false alarms {alarms}",
        "",
    ]
    lines += _ratios(rows)
    return "\n".join([*lines, *map(_line, [r for r in rows if r["verdict"] == "silent"])])


def _ratios(rows: Sequence[dict[str, Any]]) -> list[str]:
    """Actual over stated of each quantity, in the cases in which nothing is said against it."""
    found: dict[str, list[float]] = {}
    for row in rows:
        for e in row["errors"]:
            if e["sigma"] and e["quantity"] not in row["wrong"]:
                found.setdefault(e["quantity"].partition(":")[0], []).append(e["off"] / e["sigma"])
    lines = ["| actual over stated | cases | median | 90 % | within a sigma |", "|---|---|---|---|---|"]
    for name, values in found.items():
        middle, most = np.percentile(values, [50, 90])
        within = np.mean(np.array(values) < 1)
        lines.append(f"| {name} | {len(values)} | {middle:.2f} | {most:.2f} | {within:.0%} |")
    return [*lines, ""]


def _line(row: dict[str, Any]) -> str:
    """A silent failure: what was wrong, by how much, against what was stated."""
    told = dict(zip(row["wrong"], row["how"]))
    worst = [e for e in row["errors"] if e["quantity"] in told and not told[e["quantity"]]]
    parts = []
    for e in sorted(worst, key=lambda e: -e["off"] / max(e["limit"], 1e-12))[:3]:
        held = "limit" if e["quantity"] == "images" else "held as given; limit"
        stated = f"{held} {e['limit']:.2g}" if e["sigma"] is None else f"stated {e['sigma']:.2g}"
        parts.append(f"{e['quantity']} off {e['off']:.3g} ({stated})")
    return f"- {row['set']}/{row['fault']}/{row['size']} ({row['what']}): {'; '.join(parts)}"
