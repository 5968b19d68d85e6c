"""Two or more runs side by side: the papers' tables (000 tables 1-2, 001 tables 1-5, 002 table 1)."""

import io
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from rich import box
from rich.console import Console
from rich.table import Table as RichTable

from tiegraph.errors import InputError
from tiegraph.report import formatting
from tiegraph.report.network import funnel_rows, is_loss
from tiegraph.report.runfolder import STAGES, RunFolder, read_run
from tiegraph.report.summary import metric_values
from tiegraph.scene.pairs import REASON_LOOKS

_SFM = ("preview", "candidates", "coarse", "network", "design", "features", "match", "sparse", "georef")
_TIMES: dict[str, tuple[str, ...]] = {  # row -> its stages; names as in paper 000 table 1, 001 table 5
    "Mask image creation": ("masks", "refine"),
    "Matching search": ("preview", "candidates", "coarse", "network"),
    "Matching list creation": ("design",),
    "Feature extraction": ("features",),
    "Feature matching": ("match",),
    "Reconstruction and georeferencing": ("sparse", "georef"),
    "SfM, all of it": _SFM,
    "MVS (dense and cloud)": ("dense", "cloud"),
    "Scan, evaluation, report": ("scan", "evaluate", "report"),
    "Total time": STAGES,
}
_METRICS = {
    "backprojection_rmse": "Back-projection RMSE, {}",  # in the model's own unit
    "ate_sim3_rmse": "ATE after Sim3, m",
    "ate_se3_rmse": "ATE after SE3, m",
    "absolute_rmse": "Absolute position error, m",
    "images_within_0.3m": "Images within 0.3 m, %",
    "cloud_to_cloud_median": "Cloud to reference, median, m",
    "fscore_0.1m": "F-score at 0.1 m, %",
    "ghosts": "Ghost points, %",
}
_MIXED = "m, or units of a model that nothing told the scale of"


@dataclass(frozen=True)
class Block:
    """A table: title, rows of (name, value per run; NaN = not known), and how a value is printed."""

    title: str
    rows: tuple[tuple[str, tuple[float, ...]], ...]
    text: Callable[[float], str]


@dataclass(frozen=True)
class Comparison:
    """Runs side by side."""

    names: tuple[str, ...]
    blocks: tuple[Block, ...]
    notes: tuple[str, ...]


def compare_runs(folders: Sequence[Path]) -> str:
    """Tables of two or more run folders side by side, plain text for a terminal; two have a column first / second.

    Raises InputError for fewer than two folders, or one without a run.
    """
    comparison = compared(folders)
    names, two = comparison.names, len(comparison.names) == 2
    out = io.StringIO()
    width = max(80, 44 + 18 * len(names))
    console = Console(file=out, width=width, force_terminal=False, highlight=False, markup=False, emoji=False)
    for block in comparison.blocks:
        table = RichTable("", title=block.title, box=box.SIMPLE_HEAD, title_justify="left", pad_edge=False)
        for name in (*names, *(["ratio"] if two else [])):
            table.add_column(name, justify="right", overflow="fold")
        for name, values in block.rows:
            table.add_row(name, *map(block.text, values), *([ratio(values)] if two else []))
        console.print(table)
    for note in comparison.notes:
        console.print(f"Note: {note}")
    return "\n".join(line.rstrip() for line in out.getvalue().splitlines()) + "\n"


def compared(folders: Sequence[Path]) -> Comparison:
    """The tables of the runs."""
    if len(folders) < 2:
        raise InputError("tiegraph compare needs at least two run folders")
    runs = [read_run(Path(f), cloud_points=1000) for f in folders]
    paths = [Path(f).resolve() for f in folders]
    names = [p.name for p in paths]
    if len(set(names)) < len(names):
        names = ["/".join(p.parts[-2:]) for p in paths]
    found = (
        ("Wall time", _times(runs, "seconds"), formatting.seconds),
        ("CPU time", _times(runs, "cpu_s"), formatting.seconds),
        ("Images and points", _sizes(runs), formatting.count),
        ("Pairs of images", _funnel(runs), formatting.count),
        ("Errors", _errors(runs), formatting.number),
    )
    blocks = []
    for title, rows, text in found:
        known = tuple((name, tuple(values)) for name, values in rows.items() if np.isfinite(values).any())
        blocks += [Block(title, known, text)] if known else []
    return Comparison(tuple(names), tuple(blocks), tuple(_notes(runs)))


def _times(runs: Sequence[RunFolder], key: str) -> dict[str, list[float]]:
    def of(run: RunFolder, stages: tuple[str, ...]) -> float:
        found = [run.receipts.get(stage, {}).get(key) for stage in stages]
        known = [value for value in found if isinstance(value, (int, float))]
        return float(sum(known)) if known else np.nan

    return {name: [of(run, stages) for run in runs] for name, stages in _TIMES.items()}


def _sizes(runs: Sequence[RunFolder]) -> dict[str, list[float]]:
    return {
        "Input images": [len(r.scene) if r.scene else np.nan for r in runs],
        "Registered images": [_used(r) for r in runs],
        "Separate models": [1 + len(r.model.others) if r.model else np.nan for r in runs],
        "Sparse points": [r.model.points if r.model else np.nan for r in runs],
        "Dense points": [r.cloud.count if r.cloud else np.nan for r in runs],
        "Peak memory, MiB": [max((v.get("peak_mib") or 0 for v in r.receipts.values()), default=np.nan) for r in runs],
    }


def _used(run: RunFolder) -> float:
    return float(run.model.images.registered.sum()) if run.model is not None else np.nan


def _funnel(runs: Sequence[RunFolder]) -> dict[str, list[float]]:
    """The rows of the report's funnel; a filter that dropped nothing of a run has 0 there."""
    found = [{n: v for n, v, _ in funnel_rows(r.pairs, r.network)} if r.pairs is not None else {} for r in runs]
    last = f"dropped: {REASON_LOOKS['match'][0]}"
    losses = dict.fromkeys(n for rows in found for n in rows if is_loss(n) and n != last)
    after = [last] if any(last in rows for rows in found) else []
    out = {}
    for name in ("candidates", *losses, "pairs to match", "matched at full resolution", *after, "verified"):
        nothing = 0.0 if is_loss(name) else np.nan
        values = [float(rows.get(name, nothing)) if rows else np.nan for rows in found]
        out[f"  {name}" if is_loss(name) else name.capitalize()] = values
    return out


def _errors(runs: Sequence[RunFolder]) -> dict[str, list[float]]:
    known = [metric_values(r) for r in runs]
    own = "m" if all(r.metric for r in runs) else "units of the models" if not any(r.metric for r in runs) else _MIXED
    rows = {label.format(own): [float(k.get(name, np.nan)) for k in known] for name, label in _METRICS.items()}
    return {"Mean reprojection error, px": [r.model.reprojection_px if r.model else np.nan for r in runs], **rows}


def _notes(runs: Sequence[RunFolder]) -> list[str]:
    out = []
    scenes = [set(r.scene.names) for r in runs if r.scene is not None]
    if any(s != scenes[0] for s in scenes):
        out.append("The runs are on different images.")
    used = [n for n in map(_used, runs) if np.isfinite(n)]
    if used and max(used) > 1.05 * min(used):
        out.append("The runs used different numbers of images: less time may mean less surveyed.")
    if any("backprojection_rmse" in metric_values(r) for r in runs):
        out.append(
            "Back-projection RMSE is the papers' round trip: it grows with depth / focal length, is taken on different "
            "points in each run, and says nothing about the poses."
        )
    return out


def ratio(values: Sequence[float]) -> str:
    """First / second of two values."""
    known = np.isfinite(values).all() and values[1] != 0
    return f"{formatting.number(values[0] / values[1], 2)} x" if known else formatting.NONE
