"""The counts of the bench: verdicts by fault, the silent failures one by one, false alarms on clean sets."""

from __future__ import annotations

from collections import Counter
from collections.abc import Sequence
from typing import Any

import numpy as np

from benchmarks.confront.judge import SIGMAS, VERDICTS


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
    """Actual over stated (with the truth's own error) of each quantity, a line a case in which nothing is said against
    it; of several cameras the root mean square. Last the median of the cases, and how many lie within a sigma."""
    kinds = ["camera", "scale", "plan", "height", "yaw", "tilt", "place", "turn", "focal"]
    lines = [f"| actual over stated | {' | '.join(kinds)} |", "|---" * (len(kinds) + 1) + "|"]
    found: dict[str, list[float]] = {k: [] for k in kinds}
    for row in rows:
        cells = []
        for kind in kinds:
            own = [e for e in row["errors"] if e["quantity"].partition(":")[0] == kind and e["sigma"]]
            own = [SIGMAS * e["off"] / e["limit"] for e in own if e["quantity"] not in row["wrong"]]
            cells.append(f"{np.sqrt(np.mean(np.square(own))):.2f}" if own else "")
            found[kind] += own
        lines.append(f"| {row['set']}/{row['fault']}/{row['size']} | {' | '.join(cells)} |")
    for name, of in (("median", np.median), ("within a sigma", lambda v: np.mean(np.array(v) < 1))):
        lines.append(f"| {name} | {' | '.join(f'{of(v):.2f}' if v else '' for v in found.values())} |")
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
