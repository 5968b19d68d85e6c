"""Runs of the papers' tables: which survey by which method, and what a row keeps of each."""

from __future__ import annotations

import json
import shutil
import sys
from collections.abc import Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np

import tiegraph  # noqa: F401  before pycolmap

import pycolmap  # isort: skip

from benchmarks import accuracy, datasets, run, variants
from benchmarks.papers import scenes
from benchmarks.papers.ours import ours
from tiegraph.api import open_project
from tiegraph.child import run_in_child
from tiegraph.geometry.transforms import umeyama
from tiegraph.papers import colmap
from tiegraph.scene.scene import Scene
from tiegraph.sfm.covariance import position_sigma
from tiegraph.sfm.tuning import Tuning

RESULTS = Path(__file__).resolve().parents[1] / "results" / "papers.json"
_KEYS = ("set", "method", "seed")
SEEDS = 5
_ONCE = scenes.SIX[:4]  # what paper 003 compares there, pairs and times, does not depend on a mapper's seed
_PLAIN = {"coarse": {"method": "off"}, "design": {"method": "all"}}  # every candidate is matched
_VIDEO = {"sources": ["sequence"], "sequence_frames": 20}  # paper 002: the 20 frames before and after


@dataclass(frozen=True)
class Method:
    """How a survey is run: a preset, settings on top, and the last stage."""

    name: str
    preset: str = "default"
    settings: Mapping[str, Any] = field(default_factory=dict)
    until: str = "evaluate"
    trajectory: str | None = None  # instead of the set's


COLMAP = Method("COLMAP")
_OURS = Method("tiegraph")
_TO_CLOUD = Method("tiegraph", until="cloud")
_PAPERS = {n: Method(n, n) for n in ("conventional", "meguro2024", "meguro2025")}
WITHOUT = (
    Method("meguro2024, no list", "conventional", {"masks": {"source": "meguro2024"}}, "georef"),
    Method("meguro2024, no masks", "meguro2024", {"masks": {"source": "none"}}, "georef"),
)
"""Paper 000 with one of its two parts: what each buys."""
_DESIGNS = tuple(
    Method(name, settings={"candidates": _VIDEO, "design": {"method": design}}, until="georef")
    for name, design in (("all pairs", "all"), ("fuse2014", "fuse2014"), ("fuse2014_safe", "fuse2014_safe"),
                         ("tiegraph", "hybrid"))
)  # fmt: skip
_BY = tuple(
    Method(name, settings={"candidates": {"sources": [source]}, **_PLAIN}, until="cloud")
    for name, source in (("all pairs", "exhaustive"), ("by poses", "poses"))
)
_FOLLOWED = Method("by odometry", settings=_BY[1].settings, until="cloud", trajectory="auto")
_SECTIONS = ("canal_demo section 0", "canal_demo section 1")
_TO_WORLD = {n: replace(m, until="georef") for n, m in {"tiegraph": _OURS, **_PAPERS}.items()}
"""The same without a cloud: `canal` has 300 images, and a cloud is made of images, not of pairs. Every image with every
other is there COLMAP's row."""

RUNS: dict[str, tuple[tuple[str, tuple[Method, ...]], ...]] = {
    "000": (
        ("canal_demo", (_OURS, _PAPERS["conventional"], _PAPERS["meguro2024"], *WITHOUT)),
        ("canal", (_TO_WORLD["tiegraph"], _TO_WORLD["meguro2024"])),
    ),
    "001": (
        ("canal_demo", (_OURS, _PAPERS["conventional"], _PAPERS["meguro2025"])),
        ("canal", (_TO_WORLD["tiegraph"], _TO_WORLD["meguro2025"])),
        *((name, (_OURS, _PAPERS["meguro2025"])) for name in _SECTIONS),
    ),
    "002": (("kitchen 40", (*_DESIGNS, COLMAP)),),
    "003": (
        *((name, (_TO_CLOUD, *_BY, _FOLLOWED, COLMAP)) for name in scenes.SIX[:3]),
        *((name, (_TO_CLOUD, *_BY, COLMAP)) for name in scenes.SIX[3:]),
    ),
    "004": (),
}


def measure(paper: str, work: Path, note: str = "") -> None:
    """Run what ``RESULTS`` lacks of a paper; each row is kept when it is made."""
    kept = run.load_results(RESULTS, note)
    for name, methods in RUNS[paper]:
        dataset = None
        for method in methods:
            place = work / name.replace(" ", "-")
            for seed in range(1 if name in _ONCE else SEEDS):
                if any((r["set"], r["method"], r["seed"]) == (name, method.name, seed) for r in kept["runs"]):
                    continue
                dataset = dataset or scenes.load(
                    name, place / "inputs", lambda: _scene(work / "canal_demo" / "tiegraph")
                )
                row = one_run(dataset, method, place / method.name.replace(" ", "-"), seed)
                run.add_row(kept, {"set": name, "method": method.name, "seed": seed, **row}, RESULTS, _KEYS)
                sys.stderr.write(f"{name} {method.name} {seed}: {row['status']}, {row.get('registered')} registered\n")


def results() -> dict[str, Any]:
    """What is kept."""
    return json.loads(RESULTS.read_text())


def _scene(folder: Path) -> Scene:
    return open_project(None, folder).scene()


def one_run(dataset: datasets.Dataset, method: Method, out: Path, seed: int = 0) -> dict[str, Any]:
    """A survey by a method; what was begun goes on. A method other than the defaults (whose folder would keep the
    other's settings) starts from a copy of another's run beside it: stages that are the same in both are not made
    twice, and their times count in both. With another ``seed`` than 0 it is that of the seed 0 mapped anew, up to the
    world."""
    if method is COLMAP:
        return _colmap(dataset, out, seed)
    if seed:
        again = out.parent / f"{out.name}-{seed}"
        if not again.exists():
            shutil.copytree(out, again, symlinks=True)
        sparse = {**method.settings.get("sparse", {}), "seed": seed}
        error = variants.start(dataset, again, "georef", {**method.settings, "sparse": sparse}, method.preset)
        return {"status": error or "done", **figures(dataset, again)}
    others = sorted(p.parent for p in out.parent.glob("*/tiegraph.toml"))
    if not out.exists() and others and (method.settings or method.preset != "default"):
        shutil.copytree(others[0], out, symlinks=True)
    if method.trajectory is not None:
        dataset = replace(dataset, trajectory=Path(method.trajectory))
    error = variants.start(dataset, out, method.until, method.settings, method.preset)
    return {"status": error or "done", **figures(dataset, out)}


def _colmap(dataset: datasets.Dataset, place: Path, seed: int) -> dict[str, Any]:
    first, out = (place.with_name(f"{place.name}-{k}") for k in (0, seed))
    shutil.rmtree(out, ignore_errors=True)  # a run that was stopped half-way: COLMAP takes its database for whole
    out.mkdir(parents=True)
    record = out / "stages.json"
    run_in_child(colmap.exhaustive, dataset.images, out, record, seed, first if seed else None, log=out / "log.txt")
    said = json.loads(record.read_text())
    return {
        "status": said["status"],
        "stages": {s["stage"]: [s["cpu_s"], s["wall_s"]] for s in said["stages"]},
        "counts": {"matched": said["pairs"]["matched"], "verified": said["pairs"]["verified"]},
        **_of_model(dataset, [Path(m) for m in said["models"]]),
    }


def figures(dataset: datasets.Dataset, out: Path) -> dict[str, Any]:
    """What a table may ask of a run folder, as far as it came."""
    receipts = {p.stem: json.loads(p.read_text()) for p in sorted((out / "receipts").glob("*.json"))}
    done = {n: r for n, r in receipts.items() if "finished" in r}
    counts = {n: r["counts"] for n, r in done.items()}
    row: dict[str, Any] = {"stages": {n: [r["cpu_s"], r["seconds"]] for n, r in done.items()}}
    row["counts"] = {
        "matched": counts.get("match", {}).get("asked"),
        "verified": counts.get("match", {}).get("verified"),
        "sections": counts.get("network", {}).get("sections"),
        "dense_points": counts.get("cloud", {}).get("points"),
    }
    if "design" in done:
        row["funnel"] = open_project(None, out).pairs().funnel()
    if "evaluate" in done:
        metrics = {m["name"]: m["value"] for m in json.loads((out / "metrics.json").read_text())["metrics"]}
        row["rmse_m"] = metrics.get("backprojection_rmse")
    if "georef" in done:
        world = accuracy.evaluate([out / "sparse" / "world"], dataset)
        row |= {
            "in_world": world["registered"] + world["placed_by_rig"],
            "world_ate_m": world["ate_m"],
            "ours": ours(done),
        }
    models = sorted(p for p in (out / "sparse").glob("*") if p.name.isdigit())
    return {**row, **_of_model(dataset, models)}


def _of_model(dataset: datasets.Dataset, models: list[Path]) -> dict[str, Any]:
    found = accuracy.evaluate(models, dataset)
    kept = ("images", "registered", "largest", "components", "placed_by_rig", "points", "ate_m")
    row = {n: found[n] for n in kept if n in found}
    if models:
        row["precision"] = precision(models[0], dataset)
    return row


def precision(model: Path, dataset: datasets.Dataset) -> dict[str, Any] | None:
    """Mean coordinate and mean standard deviation of points and of cameras, metres along the truth's axes (paper 002,
    tables 2 and 3), by the covariance of the bundle adjustment, after a similarity to the truth."""
    made = pycolmap.Reconstruction(model)
    images = [i for i in made.images.values() if i.has_pose and i.name in dataset.cam_from_world]
    truth = np.array([datasets.pose_centre(dataset.cam_from_world[i.name]) for i in images])
    if len(images) < 3:
        return None
    fit = umeyama(np.array([i.projection_center() for i in images]), truth)
    made.transform(pycolmap.Sim3d(fit.scale, pycolmap.Rotation3d(fit.rotation), fit.translation))
    try:
        found = position_sigma(made, tuning=Tuning())
    except (ValueError, RuntimeError, np.linalg.LinAlgError):
        return None
    xyz = np.array([made.points3D[k].xyz for k in found.points])
    centres = np.array([i.projection_center() for i in images])
    return {
        "points": {
            "mean_m": xyz.mean(axis=0).tolist(),
            "sd_m": np.median(list(found.points.values()), axis=0).tolist(),
        },
        "cameras": {"mean_m": centres.mean(axis=0).tolist(), "sd_m": np.median(found.sigma, axis=0).tolist()},
    }
