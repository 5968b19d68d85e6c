"""Frames of finished models moved to another place: are they found, put back or told, and is no right frame moved?

    .venv/bin/python -m benchmarks.sfm.slid canal_demo=KEEP/canal_demo-tiegraph-0/out ... --cases 12 -o FILE

Each case takes the finished model of a run, moves one frame, one section of a pass (a third of its frames) or one pass
by some steps ``along`` the path, ``across`` it, or by a ``period`` of 8 m along it (without a known scale four steps),
and starts from these poses as the program does from any: points made anew, staged adjustment, the test of places. The
database and the model are read, never changed. Places are compared with what starts from the poses as they are, after
the similarity of the frames that were not moved; ``off`` is a tenth of the usual step. Of each case: ``mended`` (all
moved frames are back), ``told`` (those that are not are left out, or the start was refused), ``missed`` (one stands off
and nothing says so), ``right`` frames that stand off, and ``lost`` ones. ``--only-found``: whether the test of places
has all moved frames in doubt, and how many ``right`` ones, in the model whose points are made anew, before any
adjustment.
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
import tempfile
import time
from collections import Counter
from pathlib import Path
from typing import Any

import numpy as np

import tiegraph  # noqa: F401  before pycolmap

import pycolmap  # isort: skip

from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import robust_umeyama
from tiegraph.scene.colmapmodel import image_poses, model_rigs, read_model
from tiegraph.scene.colmaprows import read_cache, write_working_copy
from tiegraph.scene.scene import Scene
from tiegraph.scene.tuning import Tuning as SceneTuning
from tiegraph.sfm.mapper import Source
from tiegraph.sfm.mapping import Account, Job, _request
from tiegraph.sfm.model import frame_poses
from tiegraph.sfm.placement import explained, leave_out_doubtful
from tiegraph.sfm.rig.rig import rig_modes
from tiegraph.sfm.run import Request, _options, _triangulate, run_mapper
from tiegraph.sfm.settings import SparseSettings
from tiegraph.sfm.start import Start, place_frames
from tiegraph.sfm.tuning import Tuning
from tiegraph.sfm.verified import MatchSource, ViewGraph, read_verified

WHAT, WHERE = ("frame", "section", "pass"), ("along", "across", "period")
_STEPS, _PERIOD_M = (1.0, 2.0, 4.0), 8.0
_OFF = 0.1  # of a step


class Run:
    """A finished run: its scene, poses, and all that starting from other poses needs."""

    def __init__(self, name: str, out: Path, work: Path) -> None:
        self.name, self.out, self.work, self.tuning = name, out, work, Tuning()
        self.scene = Scene.from_json((out / "network" / "scene.json").read_text()).measured()
        model = read_model(out / "sparse" / "0")
        self.scene = self.scene.with_(rigs=model_rigs(model, self.scene))
        self.poses = image_poses(model, self.scene)
        self.database = Path(shutil.copyfile(out / "database.db", work / "database.db"))
        with pycolmap.Database.open(self.database) as database:  # the lenses are known: only places are wrong
            for camera in model.cameras.values():
                database.update_camera(camera)
        self.rig = self.unmoved = frame_poses(self.poses, self.scene)
        world = json.loads((out / "world.json").read_text()) if (out / "world.json").exists() else None
        counts = json.loads((out / "receipts" / "georef.json").read_text())["counts"] if world else {}
        self.metres = float(counts.get("scale", 1.0))
        self._cache: Any = None

    def frames(self, what: str, rng: np.random.Generator) -> np.ndarray:
        """Of a case: one, a third of a pass in a row, a pass; loose photographs count as one pass."""
        placed = np.isfinite(self.rig).all(axis=(1, 2))
        sequence = int(rng.choice(np.unique(self.scene.sequence[placed])))
        order = self.scene.in_order((self.scene.sequence == sequence) & placed)
        if what == "frame":
            return order[[rng.integers(len(order))]]
        if what == "pass":
            return order
        length = max(2, len(order) // 3)
        return order[(first := rng.integers(len(order) - length + 1)) : first + length]

    def step(self, frames: np.ndarray, where: str, rng: np.random.Generator) -> np.ndarray:
        """(3,) of a case, model units."""
        centres = self.rig[:, :3, 3]
        order = self.scene.in_order(
            (self.scene.sequence == self.scene.sequence[frames[0]]) & np.isfinite(centres[:, 0])
        )
        at = int(np.flatnonzero(order == frames[len(frames) // 2])[0])
        ahead = centres[order[min(at + 1, len(order) - 1)]] - centres[order[max(at - 1, 0)]]
        ahead = ahead / np.linalg.norm(ahead)
        size = float(rng.choice(_STEPS)) * self.usual()
        if where == "period":
            size = _PERIOD_M / self.metres if self.metres != 1.0 else 4 * self.usual()
        if where == "across":
            spread = np.linalg.svd(centres[order] - centres[order].mean(axis=0))[2]
            ahead = np.cross(ahead, spread[2] if len(order) > 2 else [0.0, 0.0, 1.0])
            ahead = ahead / np.linalg.norm(ahead)
        return size * float(rng.choice([-1.0, 1.0])) * ahead

    def usual(self) -> float:
        """Mean step between neighbours of a pass, model units: a car stands still at times."""
        steps = []
        for sequence in np.unique(self.scene.sequence):
            order = self.scene.in_order((self.scene.sequence == sequence) & np.isfinite(self.rig[:, 0, 0]))
            steps += np.linalg.norm(np.diff(self.rig[order, :3, 3], axis=0), axis=1).tolist()
        return float(np.mean(steps))

    def request(self, poses: np.ndarray) -> Request:
        """To map from poses (N, 4, 4)."""
        settings = SparseSettings()
        source = Source(self.database, None, preview=poses)
        job = Job(
            source, self.work, self.scene, settings, self.tuning, SceneTuning(), self.work / "log.txt",
            ViewGraph(source.database, self.scene, settings.min_matches), Account(),
            {k: mode for k, mode in rig_modes(self.scene, settings.rig).items() if mode != "derived"},
        )  # fmt: skip
        return _request(job, "preview")

    def started(self, poses: np.ndarray) -> tuple[Any, list[str], str]:
        """The model that starts from poses (N, 4, 4), notes of the test of its places, or why it was refused."""
        made = run_mapper(self.request(poses), lambda frames: None)
        if not made.folders:
            return None, [], made.refused
        model = read_model(made.folders[0])
        found = leave_out_doubtful(model, self.scene, MatchSource(self.database), self.tuning.placement)
        return model, found.notes, ""

    def suspects(self, poses: np.ndarray) -> set[int]:
        """Frames in doubt of a model whose points are made anew from poses (N, 4, 4), before any adjustment."""
        request = self.request(poses)
        if self._cache is None:
            working, rigs = self.work / "working.db", {k: self.scene.rigs[k] for k in request.rigs.given}
            write_working_copy(self.database, working, self.scene, rigs, None)
            self._cache = read_cache(working, request.matches.least)
            self._verified = read_verified(self.database, self.scene)
        model = pycolmap.Reconstruction()
        model.load(self._cache)
        rigs = {k: self.scene.rigs[k] for k in request.rigs.given}
        place_frames(model, self.scene, Start(rigs, frame_poses(poses, self.scene), poses))
        mapper = pycolmap.IncrementalMapper(self._cache)
        mapper.begin_reconstruction(model)
        _triangulate(mapper, _options(request, False))
        mapper.end_reconstruction(False)
        return set(explained(model, self.scene, self._verified, self.tuning.placement).doubts)


def case(run: Run, what: str, where: str, seed: int, only_found: bool) -> dict[str, Any]:
    """One case, and what became of it."""
    rng = np.random.default_rng([seed, WHAT.index(what), WHERE.index(where)])
    frames = run.frames(what, rng)
    step = run.step(frames, where, rng)
    poses, moved = run.poses.copy(), np.isin(run.scene.frame, frames)
    poses[moved] = poses[moved] @ transforms.rigid(np.eye(3), -step)
    names, steps = [run.scene.frame_names[f] for f in frames[[0, -1]]], float(np.linalg.norm(step)) / run.usual()
    row = {"set": run.name, "what": what, "where": where, "seed": seed, "frames": names, "steps": round(steps, 2)}
    start = time.process_time()
    if only_found:
        own, known = set(frames.tolist()), set(np.flatnonzero(np.isfinite(run.rig[:, 0, 0])).tolist())
        found = run.suspects(poses)
        if 2 * len(own) >= len(known) and len(found & own) < len(found - own):
            own = known - own  # which of two halves was moved is a matter of words
        row |= {"outcome": "found" if own <= found else "missed", "right": len(found - own), "lost": 0}
    else:
        row |= _became(run, frames, *run.started(poses))
    return {**row, "cpu_s": round(time.process_time() - start, 1)}


def _became(run: Run, frames: np.ndarray, model: Any, notes: list[str], refused: str) -> dict[str, Any]:
    """Outcome of a start from poses of which those of some frames were moved."""
    if model is None:
        return {"outcome": "told", "refused": refused, "right": 0, "lost": 0}
    there = frame_poses(image_poses(model, run.scene), run.scene)[:, :3, 3]
    true, own = run.unmoved[:, :3, 3], np.isin(np.arange(run.scene.frames), frames)
    placed, known = np.isfinite(there).all(axis=1), np.isfinite(true).all(axis=1)
    rest = placed & known & (~own | (2 * own.sum() >= known.sum()))
    fit, _ = robust_umeyama(there[rest], true[rest], sigma=0.02 * run.usual())
    off = np.linalg.norm(fit(there) - true, axis=1) / run.usual()
    stands_off = placed & known & (off > _OFF)
    told, gone = "doubt" in " ".join(notes), (own & known & ~placed).any()
    wrong = (stands_off & own).any()
    return {
        "outcome": "missed" if wrong and not told else "told" if gone or wrong else "mended", "notes": notes,
        "right": int((stands_off & ~own).sum()), "lost": int((known & ~placed & ~own).sum()),
        "worst": round(float(np.nanmax(np.where(known & placed, off, 0))), 3),
    }  # fmt: skip


def main(argv: list[str] | None = None) -> int:
    """One JSON line a case, and the counts."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("runs", nargs="+", help="SET=FOLDER: a name and the run folder")
    parser.add_argument("--what", nargs="+", default=WHAT, choices=WHAT)
    parser.add_argument("--where", nargs="+", default=WHERE, choices=WHERE)
    parser.add_argument("--cases", type=int, default=4, help="of each kind and set")
    parser.add_argument("--only-found", action="store_true", help="ask the model of the moved poses, adjust nothing")
    parser.add_argument("-o", "--output", type=Path)
    args = parser.parse_args(argv)
    rows: list[dict[str, Any]] = []
    for item in args.runs:
        name, folder = item.split("=", 1)
        with tempfile.TemporaryDirectory() as work:
            run = Run(name, Path(folder), Path(work))
            if not args.only_found:
                run.unmoved = frame_poses(image_poses(run.started(run.poses)[0], run.scene), run.scene)
            passes = len(np.unique(run.scene.sequence[np.isfinite(run.rig[:, 0, 0])]))
            for what in [w for w in args.what if w != "pass" or passes > 1]:
                for where in args.where:
                    for seed in range(args.cases):
                        rows.append(case(run, what, where, seed, args.only_found))
                        sys.stdout.write(json.dumps(rows[-1]) + "\n")
                        sys.stdout.flush()
    kinds = [(what, where) for what in args.what for where in args.where]
    outcomes = {kind: Counter(r["outcome"] for r in rows if (r["what"], r["where"]) == kind) for kind in kinds}
    told = {
        "cases": len(rows), "right frames off": sum(r["right"] for r in rows),
        "right frames lost": sum(r["lost"] for r in rows),
        "outcomes": {" ".join(kind): dict(count) for kind, count in outcomes.items()},
    }  # fmt: skip
    sys.stdout.write(json.dumps(told) + "\n")
    if args.output:
        args.output.write_text(json.dumps({**told, "rows": rows}, indent=1) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
