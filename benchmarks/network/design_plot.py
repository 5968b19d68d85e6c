"""The picture of ``design_real.py``: sigma relative to all pairs, and error of the models, against the share kept."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import matplotlib

matplotlib.use("Agg")
import matplotlib.pyplot as plt
import numpy as np

_LOOKS = {  # method: label, colour, marker
    "hybrid": ("hybrid", "#1b6ca8", "o"),
    "top": ("best of each image", "#b8860b", "^"),
    "random": ("random + forest", "#888888", "x"),
    "fuse2014": ("fuse2014", "#c0392b", "v"),
    "fuse2014_safe": ("fuse2014, kept together", "#e67e22", "D"),
    "all": ("all", "#000000", "*"),
}


def plot(rows: list[dict[str, Any]], path: Path) -> None:
    """Two panels a set: sigma relative to all pairs, trajectory error of the model of these pairs."""
    sets = list(dict.fromkeys(r["set"] for r in rows))
    if not sets:
        return
    figure, axes = plt.subplots(2, len(sets), figsize=(3.6 * len(sets) + 1, 6.4), squeeze=False, sharex="col")
    for column, name in enumerate(sets):
        own = [r for r in rows if r["set"] == name]
        _panel(axes[0, column], own, True)
        _panel(axes[1, column], own, False)
        axes[0, column].set_title(name, fontsize=10)
        axes[1, column].set_xlabel("share of the candidate pairs kept, %")
    axes[0, 0].set_ylabel("predicted sigma / that of all pairs")
    axes[1, 0].set_ylabel("ATE of the model, mm")
    found = {label: handle for a in axes.flat for handle, label in zip(*a.get_legend_handles_labels())}
    figure.legend(found.values(), found.keys(), loc="lower center", ncols=len(found), fontsize=9, frameon=False)
    figure.tight_layout(rect=(0, 0.05, 1, 1))
    figure.savefig(path, dpi=110)
    plt.close(figure)


def _panel(axis: plt.Axes, rows: list[dict[str, Any]], sigma: bool) -> None:
    everything = next(r for r in rows if r["method"] == "all")["sigma"]["rms"]
    for method, (label, colour, marker) in _LOOKS.items():
        points: dict[float, list[float]] = {}
        for r in (r for r in rows if r["method"] == method):
            value = r["sigma"]["rms"] / everything if sigma else 1000 * (r.get("model", {}).get("ate_m") or np.nan)
            if np.isfinite(value):
                points.setdefault(round(100 * r["share"], 1), []).append(value)
        x = sorted(points)
        line = "-" if len(x) > 1 else ""
        axis.plot(x, [np.mean(points[k]) for k in x], line, color=colour, marker=marker, ms=5, lw=1.2, label=label)
    axis.set_xscale("log")
    ticks = [5, 10, 20, 40, 100]
    axis.set_xticks(ticks, [str(t) for t in ticks])
    axis.minorticks_off()
    axis.grid(alpha=0.3, which="both")
    if not sigma:
        axis.set_ylim(0, 1.15 * axis.get_ylim()[1])  # from nothing: a millimetre more or less is none
        return
    axis.set_yscale("log")
    axis.minorticks_off()
    axis.axhline(1.05, color="#1b6ca8", lw=0.8, ls=":")
    _even_ticks(axis, *axis.get_ylim())


def _even_ticks(axis: plt.Axes, low: float, high: float) -> None:
    """Round values that spread over a logarithmic axis."""
    steps = [m * 10.0**e for e in range(-4, 4) for m in (1, 1.1, 1.2, 1.5, 2, 3, 5)]
    inside = [s for s in steps if low <= s <= high]
    keep = inside if len(inside) < 8 else [s for s in inside if f"{s:.3e}"[0] in "125" and f"{s:.3e}"[2] in "0"]
    axis.set_yticks(keep, [f"{s:.3g}" for s in keep])
