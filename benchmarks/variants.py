"""One survey run in variants: the same inputs with some settings changed, each against the survey as it is.

A variant starts from a copy of the finished base run, so that only the stages that follow what is changed run again; a
repeated run of the base starts from nothing. What a variant costs is the sum over its receipts, of stages that were
taken over too: what the whole run would have cost.
"""

from __future__ import annotations

import json
import os
import shutil
import statistics
import subprocess
import sys
from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

import tiegraph  # noqa: F401  before pycolmap

import pycolmap  # isort: skip

from benchmarks import accuracy, datasets
from benchmarks.confront import sets
from benchmarks.confront.given import write
from benchmarks.sigma import reference_poses
from tiegraph.geometry.transforms import umeyama

UNTIL = "georef"
_DRIVER = "import json, sys, tiegraph\nif __name__ == '__main__':\n    given = json.loads(sys.argv[1])\n"
_DRIVER += "    from tiegraph.project.progress import Reporter\n"
_DRIVER += "    tiegraph.open(**given).run(sys.argv[2], Reporter('quiet'))\n"

Settings = Mapping[str, Mapping[str, Any]]


@dataclass(frozen=True)
class Variant:
    """Settings, by section, that differ from the survey as it is: ``{"tuning": {"sfm": {"rig": ...}}}``."""

    name: str
    settings: Settings = field(default_factory=dict)
    what: str = ""


def load(name: str, work: Path) -> datasets.Dataset:
    """A set of ``datasets`` or, as ``confront/NAME``, a clean survey of the confront bench."""
    if not name.startswith("confront/"):
        return datasets.load(name, work / "inputs")
    given = sets.load(name.partition("/")[2], work / "inputs")
    written = write(given, work / "inputs" / name.replace(":", "-"))
    return datasets.Dataset(name=name, cam_from_world=given.truth.cam_from_world, **written)


def run(dataset: datasets.Dataset, out: Path, settings: Settings, base: Path | None = None) -> dict[str, Any]:
    """Run a survey to ``out`` until georef, from a copy of ``base`` if given; its figures (``figures``).

    A run that ends with an error is a row too: ``status`` holds its last line.
    """
    shutil.rmtree(out, ignore_errors=True)
    if base is not None:
        shutil.copytree(base, out, symlinks=True)
    error = start(dataset, out, UNTIL, settings)
    return {"status": error} if error else {"status": "done", **figures(dataset, out)}


def start(dataset: datasets.Dataset, out: Path, until: str, settings: Settings, preset: str = "default") -> str:
    """Run a survey to ``out`` in a process of its own, or go on with it; the last line of its error, "" = none."""
    given: dict[str, Any] = {"images": dataset.images, "out": out, "settings": settings, "preset": preset}
    given |= dataset.files()
    command = [sys.executable, "-c", _DRIVER, json.dumps(given, default=str), until]
    done = subprocess.run(command, capture_output=True, text=True, env={**os.environ})
    return (done.stderr.strip().splitlines() or ["no word"])[-1][:300] if done.returncode else ""


def figures(dataset: datasets.Dataset, out: Path) -> dict[str, Any]:
    """Registered images of all, trajectory error, CPU seconds, predicted over actual of a finished run."""
    receipts = {p.stem: json.loads(p.read_text()) for p in (out / "receipts").glob("*.json")}
    found = accuracy.evaluate([out / "sparse" / "0"], dataset)
    row = {n: found.get(n) for n in ("images", "registered", "placed_by_rig", "ate_m", "reprojection_px")}
    row["cpu_s"] = round(sum(r.get("cpu_s") or 0.0 for r in receipts.values()), 1)
    row["pairs"] = receipts.get("design", {}).get("counts", {}).get("pairs")
    row["models"] = receipts.get("sparse", {}).get("counts", {}).get("models")
    row["contradictions"] = sum(len(r.get("contradictions") or ()) for r in receipts.values())
    row["predicted_over_actual"] = _ratio(dataset, out, receipts.get("sparse", {}).get("counts", {}))
    return row


def _ratio(dataset: datasets.Dataset, out: Path, counts: Mapping[str, float]) -> float | None:
    """Stated median sigma of the reference cameras' places over their median error after the best similarity."""
    sigma = counts.get("position_sigma_median")
    model = pycolmap.Reconstruction(out / "sparse" / "0")
    truth = {f: datasets.pose_centre(pose) for f, pose in reference_poses(model, dataset).items()}
    if sigma is None or len(truth) < 3:
        return None
    frames = sorted(truth)
    here = np.stack([model.frame(f).rig_from_world.inverse().translation for f in frames])
    there = np.stack([truth[f] for f in frames])
    fit = umeyama(here, there)
    return round(fit.scale * sigma / max(float(np.median(np.linalg.norm(fit(here) - there, axis=1))), 1e-12), 3)


class Book:
    """Rows kept as JSON, written after each: {"rows": [{"set", "variant", "repeat", ...}]}; what is there stays."""

    def __init__(self, path: Path) -> None:
        self.path = path
        self.rows: list[dict[str, Any]] = json.loads(path.read_text())["rows"] if path.exists() else []

    def has(self, name: str, variant: str, repeat: int = 0) -> bool:
        """Whether a row is there."""
        return any((r["set"], r["variant"], r["repeat"]) == (name, variant, repeat) for r in self.rows)

    def add(self, name: str, variant: Variant, repeat: int, row: Mapping[str, Any]) -> None:
        """Keep a row."""
        kept = {"set": name, "variant": variant.name, "repeat": repeat, "settings": variant.settings, **row}
        self.rows.append(kept)
        self.path.write_text(json.dumps({"rows": self.rows}, indent=1, default=str) + "\n")
        sys.stderr.write(f"{name} {variant.name} {repeat}: {row.get('registered')} {row.get('ate_m')}\n")

    def of(self, name: str, variant: str) -> list[dict[str, Any]]:
        """All repeats of a variant."""
        return [r for r in self.rows if (r["set"], r["variant"]) == (name, variant)]


def median(rows: Sequence[Mapping[str, Any]], key: str) -> float | None:
    """Median of a figure over repeats; None where none has it."""
    found = [float(r[key]) for r in rows if r.get(key) is not None]
    return statistics.median(found) if found else None


def spread(rows: Sequence[Mapping[str, Any]], key: str) -> float:
    """Largest minus smallest of a figure over repeats; 0 of one."""
    found = [float(r[key]) for r in rows if r.get(key) is not None]
    return max(found) - min(found) if found else 0.0
