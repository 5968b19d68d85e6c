"""The sparse stage from the coarse model's poses beside the same stage mapped from nothing, on finished runs.

    TIEGRAPH_DATA=... .venv/bin/python -m benchmarks.sfm.start --runs RUNS --sets canal kitti_stereo

``RUNS`` holds kept runs of ``benchmarks/run.py --keep RUNS``; their databases, pairs and coarse models are read,
nothing in them is changed. CPU seconds are of the stage with its child processes.
"""

from __future__ import annotations

import argparse
import json
import resource
import sys
import tempfile
from pathlib import Path
from typing import Any

import numpy as np

import tiegraph  # noqa: F401  before pycolmap
from benchmarks import datasets
from benchmarks.accuracy import evaluate
from tiegraph.geometry import transforms
from tiegraph.geometry.align import umeyama
from tiegraph.scene.colmapmodel import image_poses
from tiegraph.scene.pairs import REASONS, Pairs
from tiegraph.scene.scene import Scene
from tiegraph.scene.tuning import Tuning as SceneTuning
from tiegraph.sfm.mapper import Source, reconstruct
from tiegraph.sfm.settings import SparseSettings
from tiegraph.sfm.tuning import Tuning


def measure(name: str, out: Path, mapper: str, work: Path) -> dict[str, Any]:
    """Figures of one set and mapper; ``out``: the run folder of the kept run."""
    dataset = datasets.load(name, work)
    scene = Scene.from_json((out / "network" / "scene.json").read_text()).measured()
    with np.load(out / "filter.npz") as data:
        pairs = Pairs.from_npz(dict(data))
    away = pairs.where(pairs.dropped == REASONS.index("repeat"))
    refused = tuple(zip(away.i.tolist(), away.j.tolist()))
    source = Source(out / "database.db", out / "images", refused, preview=_preview(out))
    before = _cpu_s()
    settings = SparseSettings(mapper=mapper)
    made = reconstruct(source, work / "sparse", scene, settings, Tuning(), SceneTuning(), work / "log.txt")
    cpu_s = _cpu_s() - before
    found = image_poses(made.load(), scene)
    truth = np.full_like(found, np.nan)
    for k, image in enumerate(scene.names):
        truth[k] = dataset.cam_from_world.get(image, truth[k])
    both = np.isfinite(found).all(axis=(1, 2)) & np.isfinite(truth).all(axis=(1, 2))
    a, b = transforms.centre(found[both]), transforms.centre(truth[both])
    figures = evaluate([m.folder for m in made.models], dataset)
    return {
        "set": name, "asked": mapper, "mapper": made.mapper, "cpu_s": round(cpu_s, 1),
        "registered": figures["largest"], "images": len(scene), "ate_m": figures["ate_m"],
        "largest_m": float(np.linalg.norm(umeyama(a, b)(a) - b, axis=1).max()), "notes": made.remarks.notes,
    }  # fmt: skip


def _preview(out: Path) -> np.ndarray | None:
    path = out / "coarse" / "model.npz"
    if not path.exists():
        return None
    with np.load(path) as data:
        return np.where(data["trusted"][:, None, None], data["cam_from_world"], np.nan)


def _cpu_s() -> float:
    used = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in used)


def main(argv: list[str] | None = None) -> int:
    """Measure, one JSON line a row."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--runs", type=Path, required=True)
    parser.add_argument("--sets", nargs="+", required=True)
    parser.add_argument("--mappers", nargs="+", default=["auto", "global"])
    args = parser.parse_args(argv)
    for name in args.sets:
        for mapper in args.mappers:
            with tempfile.TemporaryDirectory() as work:
                row = measure(name, args.runs / f"{name}-tiegraph-0" / "out", mapper, Path(work))
            sys.stdout.write(json.dumps(row) + "\n")
            sys.stdout.flush()
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
