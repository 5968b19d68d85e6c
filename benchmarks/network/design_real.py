"""Share of pairs kept against accuracy on real sets.

    python benchmarks/network/design_real.py --sets canal_demo --work WORK -o x.json

All candidates of a set are matched once (``tiegraph run --design.method all --until filter``). Each design method then
chooses from the previews, as the stage does, and its choice is judged in two ways: the predicted sigma of the frames'
positions, by the exact covariance of the bundle adjustment over the tracks that the chosen pairs make, and the error
of a model mapped from these pairs alone, against the truth.
"""

from __future__ import annotations

import argparse
import json
import sys
import time
from collections.abc import Iterator
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np

import tiegraph  # noqa: F401  before pycolmap

import pycolmap  # isort: skip
from benchmarks import accuracy, datasets, run
from benchmarks.network.design_plot import plot
from benchmarks.network.matched import Run, Tracks
from benchmarks.network.measure import run_tiegraph
from tiegraph import papers
from tiegraph.design.design import METHODS as PLUGGED
from tiegraph.design.design import design
from tiegraph.design.matchprediction import expected_matches
from tiegraph.design.settings import DesignSettings
from tiegraph.design.tuning import MatchPredictionTuning, Tuning
from tiegraph.errors import InputError, TiegraphError
from tiegraph.scan.rigfiles.rigspec import write_rig_toml
from tiegraph.scene.graph import forest
from tiegraph.scene.rig import Rig, Sensor

SETS = ("canal_demo", "canal", "pandaset", "kitti_stereo", "kitti_stereo:image_l", "pandaset:front_camera")
SHARES = (0.05, 0.1, 0.2, 0.4)
for name in papers.DESIGNS:
    papers.plug_in(papers.DESIGNS, name, PLUGGED)
METHODS = ("hybrid", "top", "random", "fuse2014", "fuse2014_safe", "all")
SEEDS = 3
WINDOW = 20  # frames, paper 002


@dataclass(frozen=True)
class Choice:
    """Rows of the pair table that a method keeps; ``share`` is what was asked for, 0 if the method has its own."""

    method: str
    share: float
    seed: int
    rows: np.ndarray
    seconds: float
    counts: dict[str, float]

    @property
    def name(self) -> str:
        """Of its folder."""
        return f"{self.method}_{100 * self.share:g}_{self.seed}"


def main(argv: list[str] | None = None) -> int:
    """Run what the command line asks; prints one table a set."""
    args = _arguments(argv)
    results = run.load_results(args.output, args.note)
    for name in args.sets:
        work = args.work / name.replace(":", "_")
        base = _matched(name, work)
        judge = Judge(name, work, Run.read(base), datasets.load(name.partition(":")[0], work / "inputs"))
        for choice in choices(judge.run, args.methods, args.shares, args.seeds):
            row = {**judge.row(choice, mapped=not args.sigma_only and choice.seed == 0), "set": name}
            run.add_row(results, row, args.output, ("set", "method", "asked_share", "seed"))
            sys.stderr.write(f"{name} {choice.name}: {_short(row)}\n")
    plot(results["runs"], args.output.with_suffix(".png"))
    sys.stdout.write(markdown(results["runs"]) + "\n")
    return 0


def _arguments(argv: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sets", nargs="+", default=list(SETS), metavar="SET",
                        help="SET:CAMERA takes the frames of one camera as a video, window 20")  # fmt: skip
    parser.add_argument("--methods", nargs="+", default=list(METHODS), choices=METHODS, metavar="METHOD",
                        help=", ".join(METHODS))  # fmt: skip
    parser.add_argument("--shares", nargs="+", type=float, default=list(SHARES), help="of the candidate pairs")
    parser.add_argument("--seeds", type=int, default=SEEDS, help="random choices a share; the first is mapped")
    parser.add_argument("--sigma-only", action="store_true", help="map nothing but the model of all pairs")
    parser.add_argument("--work", type=Path, required=True, help="work folder; what is there is continued")
    parser.add_argument("--note", default="", help="said in the JSON, for instance what else the machine was doing")
    parser.add_argument("-o", "--output", type=Path, required=True, help="JSON file, added to; the plot goes beside it")
    return parser.parse_args(argv)


# ---------------------------------------------------------------------------------------------- all pairs, matched


def _matched(name: str, work: Path) -> Path:
    """The run folder in which all candidates of the set were matched; made where it is not there."""
    out = work / "base" / "out"
    if (out / "filter.npz").exists():
        return out
    work.mkdir(parents=True, exist_ok=True)
    kind, _, camera = name.partition(":")
    dataset = datasets.load(kind, work / "inputs")
    options = ["--design.method", "all", "--until", "filter"]
    if camera:
        dataset = _video(dataset, camera, work)
        options += [
            "--candidates.sources",
            "sequence",
            "--candidates.sequence-frames",
            str(WINDOW),
            "--coarse.method",
            "off",
        ]
    said = run_tiegraph(dataset, work / "base", options)
    if said["returncode"] != 0:
        raise InputError(f"{name}: tiegraph ended with {said['returncode']}, see {work}/base/log.txt")
    return out


def _video(dataset: datasets.Dataset, camera: str, work: Path) -> datasets.Dataset:
    """The frames of one camera (a folder of the set's images) as a set of its own, without times and positions."""
    folder = work / "inputs" / "images" / camera
    folder.mkdir(parents=True, exist_ok=True)
    files = sorted((dataset.images / camera).iterdir())
    if not files:
        raise InputError(f"{dataset.name}: no images in folder {camera!r}")
    for path in files:
        link = folder / path.name
        if not link.exists():
            link.symlink_to(path.resolve())
    rig = None
    known = dataset.cameras.get(Path(camera).name)
    if known is not None:
        rig = work / "inputs" / "rig.toml"
        write_rig_toml(Rig("camera", (Sensor("camera", known, folder=camera),)), rig)
    return replace(dataset, images=work / "inputs" / "images", rig=rig, gnss=None, times=None, trajectory=None)


# ---------------------------------------------------------------------------------------------- choosing


def choices(matched: Run, methods: list[str], shares: list[float], seeds: int) -> Iterator[Choice]:
    """What each method chooses from the previews; ``all`` comes first, for the others are judged by its model."""
    yield _chosen(matched, "all", 0.0, 0)
    for method in (m for m in methods if m != "all"):
        if method.startswith("fuse2014"):
            yield _chosen(matched, method, 0.0, 0)
            continue
        for share in shares:
            for seed in range(seeds if method == "random" else 1):
                yield _chosen(matched, method, share, seed)
    if "hybrid" in methods:
        yield _chosen(matched, "hybrid", 0.0, 0)  # the default: 5 % loss predicted


def _chosen(matched: Run, method: str, share: float, seed: int) -> Choice:
    pairs = matched.pairs
    count = round(share * len(pairs.kept()))
    began = time.process_time()
    if method == "random":
        rows, counts = _random(matched, count, seed), {}
    else:
        settings = DesignSettings(method=method)
        if method == "top":
            settings = DesignSettings(method=method, pairs_per_image=_top(matched, count))
        elif share:
            each = max(1, round(2 * count / len(matched.scene)))
            settings = DesignSettings(method=method, budget="pairs", pairs_per_image=each)
        if method.startswith("fuse2014"):
            pairs = matched.with_accuracy()
        found = design(pairs, matched.scene, matched.ties, settings, Tuning(few_pairs=0), matched.visibility)
        rows, counts = np.flatnonzero(found.pairs.dropped == 0), dict(found.counts)
    return Choice(method, share, seed, rows, time.process_time() - began, counts)


def _top(matched: Run, count: int) -> int:
    """The pairs an image that make about the wanted number."""
    best = (np.inf, 1)
    for k in range(1, 80):
        settings = DesignSettings(method="top", pairs_per_image=k)
        kept = int(
            np.sum(design(matched.pairs, matched.scene, matched.ties, settings, Tuning(few_pairs=0)).pairs.dropped == 0)
        )
        best = min(best, (abs(kept - count), k))
        if kept > count:
            break
    return int(best[1])


def _random(matched: Run, count: int, seed: int) -> np.ndarray:
    """A maximum spanning forest and pairs drawn at random."""
    rows = np.flatnonzero(matched.pairs.dropped == 0)
    kept = matched.pairs.kept()
    tree = forest(kept.i, kept.j, expected_matches(kept, matched.ties, MatchPredictionTuning()), len(matched.scene))
    rest = np.random.default_rng(seed).permutation(np.setdiff1d(np.arange(len(rows)), tree))
    return np.sort(rows[np.concatenate([tree, rest[: max(count - len(tree), 0)]])])


# ---------------------------------------------------------------------------------------------- judging


class Judge:
    """The figures of choices on one set; models and figures stay in the work folder and are not made again."""

    def __init__(self, name: str, work: Path, matched: Run, dataset: datasets.Dataset) -> None:
        self.name, self.run, self.work = name, matched, work
        scene = matched.scene
        prefix = "" if not name.partition(":")[1] else None
        sources = [scene.source_name(k) for k in range(len(scene))]
        self.truth = {n: dataset.cam_from_world[s] for n, s in zip(scene.names, sources) if s in dataset.cam_from_world}
        if len(self.truth) < len(scene) and prefix is None:
            raise InputError(f"{name}: {len(scene) - len(self.truth)} images have no true pose")
        self._tracks: Tracks | None = None

    def tracks(self) -> Tracks:
        """Of the model of all pairs."""
        if self._tracks is None:
            self._tracks = Tracks(self.run, pycolmap.Reconstruction(self._map(_chosen(self.run, "all", 0.0, 0))[0]))
        return self._tracks

    def row(self, choice: Choice, mapped: bool) -> dict[str, Any]:
        """Figures of a choice: pairs, sigma (metres), error of its own model."""
        used = self.run.used(choice.rows)
        row: dict[str, Any] = {
            "method": choice.method,
            "asked_share": choice.share,
            "seed": choice.seed,
            "images": len(self.run.scene),
            "candidates": len(self.run.pairs.kept()),
            "pairs": len(choice.rows),
            "share": len(choice.rows) / len(self.run.pairs.kept()),
            "verified": len(used),
            "select_cpu_s": choice.seconds,
            "preview_loss_percent": choice.counts.get("preview_loss_percent"),
        }
        row["sigma"] = self.tracks().sigma(choice.rows)
        if mapped or choice.method == "all" or self._is_mapped(choice):
            row["model"] = self._error(choice)
        return row

    def _error(self, choice: Choice) -> dict[str, Any]:
        try:
            folders = self._map(choice)
        except TiegraphError as error:
            return {"failed": str(error).splitlines()[0]}
        model = pycolmap.Reconstruction(folders[0])
        poses = {n: p for n, p in accuracy._poses(model).items() if n in self.truth}
        figures = accuracy.trajectory_error(poses, self.truth)
        return {"registered": len(poses), "models": len(folders), "points": model.num_points3D(), **figures}

    def _folder(self, choice: Choice) -> Path:
        return self.work / "maps" / choice.name

    def _is_mapped(self, choice: Choice) -> bool:
        listed = self._folder(choice) / "rows.json"
        return listed.exists() and json.loads(listed.read_text()) == choice.rows.tolist()

    def _map(self, choice: Choice) -> list[Path]:
        """Models of a choice, largest first; made anew when the choice is another one than last time."""
        folder = self._folder(choice)
        listed = folder / "rows.json"
        if not self._is_mapped(choice):
            folder.mkdir(parents=True, exist_ok=True)
            listed.unlink(missing_ok=True)
            self.run.map(choice.rows, folder, folder / "log.txt")
            listed.write_text(json.dumps(choice.rows.tolist()))
        return sorted((p for p in folder.iterdir() if p.name.isdigit()), key=lambda p: int(p.name))


# ---------------------------------------------------------------------------------------------- results


def relative(rows: list[dict[str, Any]]) -> list[dict[str, Any]]:
    """The rows of one set with ``ratio``: sigma over that of all pairs, the mean where there are several seeds."""
    everything = next(r for r in rows if r["method"] == "all")["sigma"]["rms"]
    out = []
    for method, share in dict.fromkeys((r["method"], r["asked_share"]) for r in rows):
        own = sorted((r for r in rows if (r["method"], r["asked_share"]) == (method, share)), key=lambda r: r["seed"])
        out.append({**own[0], "ratio": float(np.mean([r["sigma"]["rms"] for r in own])) / everything})
    return out


def markdown(rows: list[dict[str, Any]]) -> str:
    """One table a set."""
    blocks = []
    for name in dict.fromkeys(r["set"] for r in rows):
        own = relative([r for r in rows if r["set"] == name])
        first = own[0]
        lines = [f"### {name}: {first['images']} images, {first['candidates']} candidates", ""]
        lines += ["| method | share kept | pairs | sigma / all | ATE m | registered | select CPU s |"]
        lines += ["|" + "---|" * 7]
        for r in sorted(own, key=lambda r: (r["method"], r["share"])):
            model = r.get("model", {})
            ate = f"{model['ate_m']:.3f}" if model.get("ate_m") is not None else "-"
            label = r["method"] + (" (5 % loss)" if r["method"] == "hybrid" and not r["asked_share"] else "")
            lines.append(
                f"| {label} | {100 * r['share']:.1f} % | {r['pairs']} | {r['ratio']:.3f} | {ate} | "
                f"{model.get('registered', '-')} | {r['select_cpu_s']:.1f} |"
            )
        blocks.append("\n".join(lines))
    return "\n\n".join(blocks)


def _short(row: dict[str, Any]) -> str:
    model = row.get("model", {})
    ate = model.get("ate_m")
    return f"{row['pairs']} pairs, sigma {row['sigma']['rms']:.4g}, ATE {ate if ate is None else round(ate, 4)}"


if __name__ == "__main__":
    sys.exit(main())
