"""Time and memory of network and design against the number of images: ``python benchmarks/network/scale.py``.

A simulated canal survey (``canalworld``: 6 cameras, two passes, repeated walls); everything but the previews themselves
is the program's own: candidates, coarse (COLMAP's mapper), network, then ``design``.
Each size runs in a process of its own. The time of the simulated matching is taken off; what real previews would cost
is given beside it (6 ms each, measured on canal).
"""

from __future__ import annotations

import argparse
import cProfile
import json
import logging
import pstats
import resource
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from functools import partial
from pathlib import Path
from typing import Any
from unittest.mock import patch

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np

import tiegraph  # noqa: F401  before pycolmap
from benchmarks.network.canalworld import CanalWorld, canal_world
from benchmarks.network.measure import measured
from tiegraph.design.design import design
from tiegraph.features.preview import PreviewMatch
from tiegraph.network.candidates import find_candidates
from tiegraph.network.coarse.search import Coarse
from tiegraph.network.network import Network, join_network
from tiegraph.network.passes import MatchCache
from tiegraph.network.sections import UpLight
from tiegraph.pipeline import coarse as coarse_glue
from tiegraph.pipeline.candidates import _Descriptors
from tiegraph.project.inputs import Inputs
from tiegraph.project.run import Run
from tiegraph.project.settings import Settings
from tiegraph.scene.pairs import Pairs

SIZES = (500, 1000, 2000, 4000)
PREVIEW_S = 0.006  # of one match of two previews, CPU
USEFUL, FALSE = 0.15, 0.02
COLUMNS = (
    ("images", "images", "d"), ("previews", "previews", "d"), ("previews_share", "of all pairs", "%"),
    ("network_cpu_s", "network CPU s", "1"), ("model_cpu_s", "coarse model CPU s", "1"),
    ("pictures_cpu_s", "pictures CPU s", "1"), ("design_cpu_s", "design CPU s", "1"),
    ("wall_s", "wall s", "d"), ("world_mib", "MiB before", "d"),
    ("peak_mib", "peak MiB, all processes", "d"), ("placed", "in the model", "%"), ("kept", "candidates", "d"),
    ("recall", "recall (overlap >= 0.15)", "%"), ("recall_cross", "out and back", "%"),
    ("precision", "precision", "%"), ("false", "false (overlap < 0.02)", "%"), ("designed", "designed", "d"),
)  # fmt: skip


class Clock:
    """CPU seconds of this process and its ended children, by name."""

    def __init__(self) -> None:
        self.spent: dict[str, float] = {}

    def timed(self, name: str, function: Callable[..., Any]) -> Callable[..., Any]:
        """The function, with its CPU time added up under ``name``."""

        def call(*args: Any) -> Any:
            start = _cpu_s()
            try:
                return function(*args)
            finally:
                self.spent[name] = self.spent.get(name, 0.0) + _cpu_s() - start

        return call


def _cpu_s() -> float:
    both = [resource.getrusage(who) for who in (resource.RUSAGE_SELF, resource.RUSAGE_CHILDREN)]
    return sum(u.ru_utime + u.ru_stime for u in both)


def one(
    images: int, folder: Path, skip: Sequence[str] = (), profile: Path | None = None, seed: int = 0
) -> dict[str, Any]:
    """Network and design of one simulated survey; times, counts, and how right the candidates are.

    ``skip``: ``model`` (no coarse model), ``design``, ``pictures``.
    """
    world = canal_world(images, seed)
    run = Run(folder, Inputs(folder), Settings(), pool="serial")
    (folder / "images").mkdir(parents=True, exist_ok=True)  # the mapper wants the folder, and reads nothing in it
    world.write_previews(folder / "preview")
    before_mib = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    clock = Clock()
    previews = [0]

    def match(pairs: np.ndarray) -> list[PreviewMatch]:
        previews[0] += len(pairs)
        return world.match(pairs)

    watch = cProfile.Profile()
    if profile is not None:
        watch.enable()
    asked = run if "model" not in skip else Run(folder, Inputs(folder), _without_model(), pool="serial")
    with patch.object(coarse_glue, "coarse_model", clock.timed("model", coarse_glue.coarse_model)):
        cache = MatchCache(clock.timed("match", match), len(world))
        descriptors = partial(_Descriptors, folder, world.scene)
        coarse, found = clock.timed("network", _network)(world, asked, cache, descriptors)
    if "pictures" not in skip:
        clock.timed("pictures", found.plots)(None if coarse.model is None else coarse.model.cam_from_world)
    made = None
    if "design" not in skip:
        how = run.settings.design, run.settings.tuning.design
        made = clock.timed("design", design)(found.pairs, found.scene, cache.matches(), *how)
    if profile is not None:
        watch.disable()
        _write_profile(watch, profile)
    spent = {"match": 0.0, "model": 0.0, **clock.spent}
    total = len(world) * (len(world) - 1) / 2
    return {
        "images": len(world),
        "previews": previews[0],
        "previews_share": previews[0] / total,
        "network_cpu_s": spent["network"] - spent["match"] - spent["model"],
        "model_cpu_s": spent["model"],
        "match_cpu_s": spent["match"],
        "previews_cpu_s": previews[0] * PREVIEW_S,
        "pictures_cpu_s": spent.get("pictures"),
        "design_cpu_s": spent.get("design"),
        "world_mib": before_mib,
        "own_peak_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024,
        "child_peak_mib": resource.getrusage(resource.RUSAGE_CHILDREN).ru_maxrss / 1024,
        "placed": float(coarse.model.placed().mean()) if coarse.model is not None else None,
        "ties_mib": cache.matches().matches.nbytes / 2**20,
        **judged(found.pairs.kept(), world),
        "designed": len(made.pairs.kept()) if made is not None else None,
        "notes": [*coarse.notes, *found.notes, *(made.notes if made is not None else ())],
    }


def _without_model() -> Settings:
    return Settings.model_validate({"coarse": {"method": "off"}})


def _network(
    world: CanalWorld, run: Run, cache: MatchCache, descriptors: Callable[[], Sequence[np.ndarray]]
) -> tuple[Coarse, Network]:
    """The stages candidates, coarse and network."""
    settings, tuning = run.settings, run.settings.tuning.network
    found = find_candidates(world.scene, cache, settings.candidates, tuning, descriptors)
    coarse = coarse_glue.judged_by_model(run, (found.pairs, found.scene), cache)
    both = settings.candidates, settings.network
    return coarse, join_network(coarse.pairs, coarse.scene, cache.matches(), UpLight(world.brightness), both, tuning)


def judged(kept: Pairs, world: CanalWorld) -> dict[str, Any]:
    """Candidates against the true overlap."""
    overlap = world.overlap()
    track = world.scene.sequence[world.scene.frame]
    share = overlap[kept.i, kept.j]
    right = np.triu(overlap >= USEFUL, 1)
    cross = right & (track[:, None] != track[None])
    hit = np.zeros_like(right)
    hit[kept.i, kept.j] = True
    return {
        "kept": len(kept),
        "recall": float(hit[right].mean()),
        "recall_cross": float(hit[cross].mean()) if cross.any() else None,
        "precision": float(np.mean(share >= USEFUL)),
        "false": float(np.mean(share < FALSE)),
    }


def _write_profile(watch: cProfile.Profile, path: Path) -> None:
    with path.open("w") as stream:
        for order in ("cumulative", "tottime"):
            pstats.Stats(watch, stream=stream).sort_stats(order).print_stats(40)


def markdown(rows: list[dict[str, Any]]) -> str:
    """The table of all sizes, and how each figure grows with the images (1 = linear) between the last two."""
    lines = [
        "| " + " | ".join(title for _, title, _ in COLUMNS) + " |",
        "| " + " | ".join(["---"] * len(COLUMNS)) + " |",
    ]
    for row in rows:
        lines.append("| " + " | ".join(_cell(row.get(key), kind) for key, _, kind in COLUMNS) + " |")
    if len(rows) > 1:
        a, b = rows[-2:]
        grown = np.log(b["images"] / a["images"])
        keys = ("previews", "network_cpu_s", "model_cpu_s", "design_cpu_s", "peak_mib", "kept")
        said = [f"{k} {np.log(max(b[k], 1e-9) / max(a[k], 1e-9)) / grown:.2f}" for k in keys if a.get(k) and b.get(k)]
        lines += ["", f"Exponent of growth from {a['images']} to {b['images']} images: {', '.join(said)}."]
    return "\n".join(lines)


def _cell(value: Any, kind: str) -> str:
    if value is None:
        return "-"
    return f"{100 * value:.1f} %" if kind == "%" else f"{value:.{1 if kind == '1' else 0}f}"


def main(argv: list[str] | None = None) -> int:
    """All sizes, each in a process of its own; prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=int, nargs="+", default=list(SIZES))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--profile", type=Path, help="write cProfile's tables of the size below this folder")
    parser.add_argument("--skip", nargs="+", default=[], choices=["model", "pictures", "design"], help="leave out")
    parser.add_argument("--note", default="")
    parser.add_argument("--one", type=Path, help=argparse.SUPPRESS)  # the child: where its figures go
    parser.add_argument("-o", "--output", type=Path, help="JSON file of all sizes")
    given = parser.parse_args(argv)
    if given.one is not None:
        logging.basicConfig(level=logging.INFO, format="%(relativeCreated)8d %(name)s %(message)s")
        given.one.write_text(json.dumps(one(given.images[0], given.one.parent, given.skip, given.profile, given.seed)))
        return 0
    rows = []
    for images in given.images:
        with tempfile.TemporaryDirectory(prefix="tiegraph-scale-") as folder:
            figures, log = Path(folder) / "figures.json", Path(folder) / "output.txt"
            command = [
                sys.executable,
                __file__,
                "--images",
                str(images),
                "--seed",
                str(given.seed),
                "--one",
                str(figures),
            ]
            command += ["--skip", *given.skip] if given.skip else []
            if given.profile is not None:
                given.profile.mkdir(parents=True, exist_ok=True)
                command += ["--profile", str(given.profile / f"{images}.txt")]
            began = time.monotonic()
            cost = measured(command, log)
            if cost["returncode"] != 0:
                sys.stderr.write(log.read_text()[-3000:])
                return 1
            rows.append({**json.loads(figures.read_text()), "wall_s": time.monotonic() - began})
            rows[-1]["peak_mib"] = cost["peak_mib"]
            sys.stderr.write(f"{images} images: {rows[-1]['wall_s']:.0f} s\n")
        if given.output is not None:
            from benchmarks import run

            results = {"format": 1, "machine": run._machine(), "software": run._software(), "note": given.note}
            given.output.write_text(json.dumps(run._rounded({**results, "runs": rows}), indent=1) + "\n")
    sys.stdout.write(markdown(rows) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
