"""Learned features against SIFT: ``python -m benchmarks.learned CASE ... --models ONNX ... --work DIR -o FILE``.

A case is SET[/STEP][:CONDITION:SEVERITY]: a survey with truth, of which every STEP-th image is taken (a wider base),
made worse as ``benchmarks.conditions`` does it. Each is run until georef with SIFT and with each network
(``features.engine = onnx``); a row is kept when it is made. ``--ratios`` adds rows of the networks with other values of
``match.max_ratio``, ``--write`` puts the table of FILE between its markers in docs/benchmarks.md. ``--underside
FOLDER`` prints, for the upward camera of ``canal_demo`` in that folder, how many matches of neighbouring frames lie
within 2 px of the true epipolar line.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np

import tiegraph  # noqa: F401  before pycolmap

import pycolmap  # isort: skip

from benchmarks import datasets, variants
from benchmarks.conditions import worsened
from benchmarks.table import line, put
from tiegraph.features import matchers
from tiegraph.features.settings import FeaturesSettings
from tiegraph.features.sift import extract_image
from tiegraph.features.tuning import Tuning

_ROOT = Path(__file__).resolve().parents[1]
_RESULTS, _DOCUMENT = _ROOT / "benchmarks" / "results" / "learned.json", _ROOT / "docs" / "benchmarks.md"
BEGIN, END = "<!-- python -m benchmarks.learned --write -->", "<!-- end of the learned features -->"


def case_of(case: str, work: Path) -> datasets.Dataset:
    """The survey of a case, its images below ``work``."""
    named, *worse = case.split(":")
    name, _, step = named.partition("/")
    dataset = datasets.load(name, work / "inputs")
    folder = work / "images" / case.replace("/", "-").replace(":", "-")
    if step:
        kept = dict(sorted(dataset.cam_from_world.items())[:: int(step)])
        for image in kept:
            (folder / "kept" / image).parent.mkdir(parents=True, exist_ok=True)
            shutil.copy(dataset.images / image, folder / "kept" / image)
        dataset = replace(dataset, images=folder / "kept", cam_from_world=kept)
    return worsened(dataset, worse[0], float(worse[1]), folder / "worse") if worse else dataset


def main(argv: list[str] | None = None) -> int:
    """Measure what FILE lacks."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("cases", nargs="*")
    parser.add_argument("--models", nargs="*", type=Path, default=[])
    parser.add_argument("--ratios", nargs="*", type=float, default=[])
    parser.add_argument("--work", type=Path)
    parser.add_argument("-o", "--output", type=Path, default=_RESULTS)
    parser.add_argument("--underside", type=Path)
    parser.add_argument("--write", action="store_true")
    args = parser.parse_args(argv)
    methods: dict[str, tuple[dict, str]] = {"SIFT": ({}, "")}  # settings, and the method whose run it starts from
    for model in args.models:
        learned = {"features": {"engine": "onnx", "model": model.resolve()}}
        methods[model.stem] = learned, "SIFT"
        for ratio in args.ratios:
            methods[f"{model.stem}, {ratio:g}"] = {**learned, "match": {"max_ratio": ratio}}, model.stem
    kept = json.loads(args.output.read_text()) if args.output.exists() else []
    for case in args.cases:
        left = [m for m in methods if not any((r["case"], r["method"]) == (case, m) for r in kept)]
        dataset = case_of(case, args.work) if left else None
        for method in left:
            settings, before = methods[method]
            runs = args.work / "runs" / case.replace("/", "-").replace(":", "-")
            out, base = runs / method, runs / before
            row = variants.run(dataset, out, settings, base if before and base.exists() else None)
            receipts = {n: out / "receipts" / f"{n}.json" for n in ("features", "match")}
            found = {n: json.loads(p.read_text()) for n, p in receipts.items() if p.exists()}
            row |= {f"{n}_cpu_s": r["cpu_s"] for n, r in found.items()}
            row |= {n: found.get("match", {}).get("counts", {}).get(n) for n in ("matches", "inliers", "verified")}
            kept.append({"case": case, "method": method, **row})
            args.output.write_text(json.dumps(kept, indent=1, default=str) + "\n")
            sys.stderr.write(f"{case} {method}: {row}\n")
    if args.underside:
        for method, (settings, _) in methods.items():
            found = FeaturesSettings(**settings.get("features", {})), settings.get("match", {}).get("max_ratio", 0.8)
            sys.stdout.write(f"{method}: {underside(args.underside, *found)}\n")
    if args.write:
        put(_DOCUMENT, BEGIN, END, table(kept))
    return 0


def underside(folder: Path, settings: FeaturesSettings, ratio: float) -> str:
    """Matches and true ones of frames 1, 2 and 3 apart, summed over the outward pass."""
    truth = {i.name: i for i in pycolmap.Reconstruction(folder / "gt" / "colmap").images.values()}
    names = sorted(n for n in truth if n.startswith("up/cam5"))
    found = [extract_image(folder / "images" / n, None, settings, Tuning()) for n in names]
    said = []
    for apart in (1, 2, 3):
        counts = np.zeros(2, int)
        for k in range(len(names) - apart):
            (points, one), (others, other) = found[k], found[k + apart]
            rows = matchers.matches(one, other, pycolmap.SiftMatchingOptions(max_ratio=ratio))
            a, b = truth[names[k]], truth[names[k + apart]]
            relative = b.cam_from_world() * a.cam_from_world().inverse()
            across = np.cross(relative.translation, relative.rotation.matrix(), axisb=0, axisc=0)
            inner = [np.linalg.inv(i.camera.calibration_matrix()) for i in (a, b)]
            xa, xb = (np.c_[p[r, :2], np.ones(len(r))].astype(float) for p, r in zip((points, others), rows.T))
            lines = xa @ (inner[1].T @ across @ inner[0]).T
            off = np.abs((xb * lines).sum(axis=1)) / np.maximum(np.linalg.norm(lines[:, :2], axis=1), 1e-12)
            counts += len(rows), int((off < 2).sum())
        said.append(f"{apart} apart: {counts[1]} of {counts[0]}")
    return "; ".join(said)


def table(rows: list[dict]) -> str:
    """A row a case and method."""
    head = ["case", "features", "images", "ATE, mm", "pairs verified", "inliers", "of the matches", "CPU s (features)"]
    out = [line(head), line(["---"] * len(head))]
    for r in rows:
        share = f"{r['inliers'] / r['matches']:.2f}" if r.get("matches") else "-"
        error = "-" if r.get("ate_m") is None else f"{1000 * r['ate_m']:.1f}"
        images = f"{r['registered']} of {r['images']}" if r.get("registered") else "none"
        cells = [f"`{r['case']}`", r["method"], images, error, *(str(r.get(n)) for n in ("verified", "inliers"))]
        spent = f"{r['cpu_s']:.0f} ({r.get('features_cpu_s') or 0:.0f})" if r.get("cpu_s") else "-"
        out.append(line([*cells, share, spent]))
    return "\n".join(out)


if __name__ == "__main__":
    sys.exit(main())
