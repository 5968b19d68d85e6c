"""How well each method finds the pairs that tie: ``python benchmarks/network/find.py --sets canal_demo -o x.json``.

For every method the pair list before any design, what the chain to it costs, and how it compares with the truth. A pair
is *useful* when its true overlap is 0.15 or more and exhaustive matching at full resolution verified it.
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
import tempfile
from dataclasses import dataclass
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np

import tiegraph  # noqa: F401  before pycolmap
from benchmarks import datasets, run
from benchmarks.measure import finished_tiegraph, measured, run_tiegraph
from benchmarks.network import overlap as truths
from benchmarks.network.lists import METHODS as LISTS
from benchmarks.network.lists import NEED_PREVIEWS
from tiegraph.errors import InputError
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.scene import Scene

USEFUL, FALSE = 0.15, 0.02  # overlap from which a pair is right, below which it is wrong
TIEGRAPH = "tiegraph"
PRESETS = ("meguro2024", "meguro2025", "conventional")
DEFAULT = ("tiegraph", "exhaustive", "sequential", "sequential_rig", "spatial", "meguro2024", "meguro2025", "vlad")
COLUMNS = (
    ("method", "method", ""), ("pairs", "pairs", "d"), ("recall", "recall of useful", "%"),
    ("recall_cross", "of useful out-and-back", "%"), ("recall_overlap", "of overlap >= 0.15", "%"),
    ("precision", "precision (overlap >= 0.15)", "%"), ("false", "false (overlap < 0.02)", "%"),
    ("previews_share", "previews, of all pairs", "%"), ("cpu_s", "CPU s to the list", "1"),
    ("peak_mib", "peak MiB", "d"), ("verified", "verified", "d"), ("false_verified", "false verified", "%%"),
    ("verified_cpu_s", "CPU s to verified", "d"),
)  # fmt: skip


@dataclass(frozen=True)
class Truth:
    """What the lists are judged by: images by name, true overlap (N, N), verified exhaustively (N, N) bool or None,
    pass of each image (N,)."""

    names: tuple[str, ...]
    overlap: np.ndarray
    verified: np.ndarray | None
    track: np.ndarray

    def upper(self, matrix: np.ndarray) -> np.ndarray:
        """(P,) values of all pairs i < j."""
        return matrix[np.triu_indices(len(self.names), 1)]


def main(argv: list[str] | None = None) -> int:
    """Run what the command line asks; prints one table a set."""
    args = _arguments(argv)
    results = run.load_results(args.output, args.note)
    failed = False
    with tempfile.TemporaryDirectory(prefix="tiegraph-find-", dir=args.work) as folder:
        for name in args.sets:
            dataset = datasets.load(name, Path(folder) / "inputs")
            work = (args.keep or Path(folder)) / name
            work.mkdir(parents=True, exist_ok=True)
            base = _base(dataset, work / "base", args)
            scene = Scene.from_json((work / "base" / "out" / "scene.json").read_text())
            database = _exhaustive_database(dataset, work, args)
            truth = _truth(dataset, scene, database)
            for method in args.methods:
                row = _row(dataset, method, work, args)
                row |= _found(dataset, method, work, base, args)
                if row["status"] == "done":
                    row |= judged(_pairs(work / method, row, scene, truth), truth)
                    row |= _verified(method, row, work / method, truth, database)
                failed |= row["status"] != "done"
                row.pop("out", None)
                run.add_row(results, row, args.output, ("set", "method"))
                sys.stderr.write(f"{name} {method}: {row['status']}\n")
    sys.stdout.write(markdown(results) + "\n")
    return int(failed)


def _arguments(argv: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sets", nargs="+", required=True, choices=sorted(datasets.LOADERS), metavar="SET")
    methods = [TIEGRAPH, *PRESETS, *LISTS]
    parser.add_argument("--methods", nargs="+", default=list(DEFAULT), choices=methods, metavar="METHOD",
                        help=", ".join(methods))  # fmt: skip
    parser.add_argument("--exhaustive-db", type=Path, metavar="PATH",
                        help="COLMAP database of exhaustive matching; SET in the path stands for the set's name; "
                        "default: made here, which takes long")  # fmt: skip
    parser.add_argument("--runs", type=Path, metavar="FOLDER",
                        help="take the default runs that benchmarks/run.py --keep FOLDER left there")  # fmt: skip
    parser.add_argument("--verified", action="store_true", help="run tiegraph on to its last verification of pairs")
    parser.add_argument("--keep", type=Path, help="keep the work folders below this folder, and continue what is there")
    parser.add_argument("--work", type=Path, help="where temporary folders go")
    parser.add_argument("--timeout", type=float, default=7200.0, help="seconds a method may take")
    parser.add_argument("--note", default="", help="said in the JSON, for instance what else the machine was doing")
    parser.add_argument("-o", "--output", type=Path, required=True, help="JSON file; runs are added to it")
    return parser.parse_args(argv)


# ---------------------------------------------------------------------------------------------- running


def _row(dataset: datasets.Dataset, method: str, work: Path, args: argparse.Namespace) -> dict[str, Any]:
    return {
        "set": dataset.name,
        "method": method,
        "images": len(dataset.cam_from_world),
        "started": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "load_at_start": round(os.getloadavg()[0], 2),
        "software": run._software(),
    }


def _kept(dataset: datasets.Dataset, args: argparse.Namespace) -> Path | None:
    """A finished default run of the set, where there is one."""
    out = args.runs / f"{dataset.name}-tiegraph-0" / "out" if args.runs else None
    return out if out is not None and (out / "match.npz").exists() else None


def _base(dataset: datasets.Dataset, folder: Path, args: argparse.Namespace) -> dict[str, Any]:
    """A run up to the previews, which some lists are made of."""
    kept = _kept(dataset, args)
    if kept is not None:
        return finished_tiegraph(kept, folder, "preview")
    return run_tiegraph(dataset, folder, ["--until", "preview"])


def _found(
    dataset: datasets.Dataset, method: str, work: Path, base: dict[str, Any], args: argparse.Namespace
) -> dict[str, Any]:
    """Run a method to its pair list: status, cost, ``out`` = where the list is."""
    if method in LISTS:
        folder = work / method
        folder.mkdir(parents=True, exist_ok=True)
        out = folder / "pairs.txt"
        command = [sys.executable, str(Path(__file__).with_name("lists.py")), method]
        said = measured([*command, "--run", str(work / "base" / "out"), "--out", str(out)], folder / "log.txt",
                        args.timeout)  # fmt: skip
        if method in NEED_PREVIEWS:
            said["cpu_s"] += base["cpu_s"]
            said["peak_mib"] = max(said["peak_mib"], base["peak_mib"])
    elif method == TIEGRAPH and (kept := _kept(dataset, args)) is not None:
        said = finished_tiegraph(kept, work / method, "network")
        said["verified_cpu_s"] = finished_tiegraph(kept, work / method, "match")["cpu_s"]
    else:
        options = [] if method == TIEGRAPH else ["--preset", method]
        said = run_tiegraph(dataset, work / method, [*options, "--until", "network"], args.timeout)
        if args.verified and said["returncode"] == 0:
            more = run_tiegraph(dataset, work / method, [*options, "--until", "match"], args.timeout)
            said["verified_cpu_s"] = more["cpu_s"]
    code = said.pop("returncode")
    status = {"status": "done"} if code == 0 else {"status": "timeout" if code is None else "failed"}
    return {**status, **said}


def _exhaustive_database(dataset: datasets.Dataset, work: Path, args: argparse.Namespace) -> Path | None:
    """The database of exhaustive matching: the given one, else made by the competitor's program."""
    if args.exhaustive_db is not None:
        path = Path(str(args.exhaustive_db).replace("SET", dataset.name))
        if path.exists():
            return path
        sys.stderr.write(f"{dataset.name}: no {path}, so it is made\n")
    folder = work / "colmap_exhaustive"
    path = folder / "out" / "database.db"
    if (folder / "matched").exists():
        return path
    shutil.rmtree(folder, ignore_errors=True)
    path.parent.mkdir(parents=True)
    program = ["-c", _MATCH_ALL, path, dataset.images, folder / "figures.json"]
    said = measured([sys.executable, *map(str, program)], folder / "log.txt", args.timeout)
    if said["returncode"] != 0:
        raise InputError(f"{dataset.name}: exhaustive matching ended with {said['returncode']}, see {folder}/log.txt")
    (folder / "matched").touch()
    return path


_MATCH_ALL = """
import sys, zlib
from pathlib import Path
import pycolmap
from tiegraph.papers.measured import Stages
database, images, figures = map(Path, sys.argv[1:4])
stages = Stages(figures)
mode = pycolmap.CameraMode.PER_FOLDER
stages.run("features", lambda: pycolmap.extract_features(database, images, camera_mode=mode))
stages.run("match", lambda: pycolmap.match_exhaustive(database))
"""


# ---------------------------------------------------------------------------------------------- judging


def _truth(dataset: datasets.Dataset, scene: Scene, database: Path | None) -> Truth:
    names = tuple(scene.source_name(k) for k in range(len(scene)))
    verified = truths.verified_pairs(database, names) if database is not None else None
    overlap = truths.true_overlap(dataset, names, database)
    return Truth(names, overlap, verified, scene.sequence[scene.frame])


def _pairs(folder: Path, row: dict[str, Any], scene: Scene, truth: Truth) -> np.ndarray:
    """(N, N) bool list of a method; adds the share of previews to the row."""
    out = np.zeros((len(scene), len(scene)), bool)
    if row["method"] in LISTS:
        place = {name: k for k, name in enumerate(scene.names)}
        lines = (folder / "pairs.txt").read_text().splitlines()
        i, j = np.array([[place[n] for n in line.split()] for line in lines], int).reshape(-1, 2).T
    else:
        kept = _table(folder / "out" / "network.npz").kept()
        i, j = kept.i, kept.j
        counts = next(s["counts"] for s in row["stages"] if s["stage"] == "network")
        row["previews_share"] = counts["previews"] / len(truth.upper(truth.overlap))
    out[i, j] = out[j, i] = True
    return out


def _table(path: Path) -> Pairs:
    with np.load(path) as data:
        return Pairs.from_npz(dict(data))


def judged(chosen: np.ndarray, truth: Truth) -> dict[str, Any]:
    """Figures of a pair list (N, N) bool against the truth; None where there is nothing to count."""
    listed, overlap = truth.upper(chosen), truth.upper(truth.overlap)
    right = overlap >= USEFUL
    cross = truth.upper(truth.track[:, None] != truth.track[None])
    figures: dict[str, Any] = {
        "pairs": int(listed.sum()),
        "of_pairs": len(listed),
        "recall_overlap": _share(listed, right),
        "precision": _share(right, listed),
        "false": _share(overlap < FALSE, listed),
    }
    if truth.verified is not None:
        useful = right & truth.upper(truth.verified)
        figures |= {"useful": int(useful.sum()), "useful_cross": int((useful & cross).sum())}
        figures |= {"recall": _share(listed, useful), "recall_cross": _share(listed, useful & cross)}
    return figures


def _share(what: np.ndarray, of: np.ndarray) -> float | None:
    """Share of the pairs of a mask that are in another one."""
    return float(np.mean(what[of])) if of.any() else None


def _verified(method: str, row: dict[str, Any], folder: Path, truth: Truth, database: Path | None) -> dict[str, Any]:
    """Pairs verified at the end of the chain, the false ones among them, and its CPU seconds.

    A method that only lists pairs is verified by what exhaustive matching made of them; its time is then estimated from
    that of exhaustive matching by the number of pairs (``verified_cpu_estimated``).
    """
    if method not in LISTS:
        path = folder / "out" / "match.npz"
        if not path.exists() or "verified_cpu_s" not in row:
            return {}
        kept = _table(path).kept()
        kept = kept.where(kept.inliers >= truths.VERIFIED)
        right = truth.overlap[kept.i, kept.j]
        return {"verified": len(kept), "false_verified": float(np.mean(right < FALSE)), "verified_by": path.stem}
    if truth.verified is None or database is None:
        return {}
    place = {name: k for k, name in enumerate(truth.names)}
    listed = np.zeros_like(truth.verified)
    for line in (folder / "pairs.txt").read_text().splitlines():
        i, j = (place[n] for n in line.split())
        listed[i, j] = listed[j, i] = True
    kept_pairs = truth.upper(listed & truth.verified)
    out: dict[str, Any] = {"verified": int(kept_pairs.sum()), "verified_by": "colmap"}
    out["false_verified"] = _share(truth.upper(truth.overlap) < FALSE, kept_pairs)
    figures = database.parent.parent / "figures.json"
    spent = {s["stage"]: s["cpu_s"] for s in json.loads(figures.read_text())["stages"]} if figures.exists() else {}
    if {"features", "match"} <= set(spent):
        share = row["pairs"] / row["of_pairs"]
        out |= {"verified_cpu_s": row["cpu_s"] + spent["features"] + share * spent["match"]}
        out |= {"verified_cpu_estimated": method != "exhaustive"}
    return out


# ---------------------------------------------------------------------------------------------- results


def markdown(results: dict[str, Any]) -> str:
    """One table a set."""
    blocks = []
    for name in dict.fromkeys(row["set"] for row in results["runs"]):
        rows = [row for row in results["runs"] if row["set"] == name]
        one = next((r for r in rows if "useful" in r), None)
        said = f", {one['of_pairs']} pairs, {one['useful']} useful, {one['useful_cross']} out and back" if one else ""
        lines = [f"### {name}: {rows[0]['images']} images{said}", "", _line(title for _, title, _ in COLUMNS)]
        lines += [_line(["---"] * len(COLUMNS))]
        lines += [_line(_cell(row, key, kind) for key, _, kind in COLUMNS) for row in rows]
        blocks.append("\n".join(lines))
    machine = ", ".join(f"{key} {value}" for key, value in results["machine"].items())
    note = f"Machine: {machine}. {results.get('note', '')} `~`: estimated by the number of pairs."
    return "\n\n".join([note, *blocks])


def _line(cells: Any) -> str:
    return "| " + " | ".join(cells) + " |"


def _cell(row: dict[str, Any], key: str, kind: str) -> str:
    value = row.get(key)
    if key == "method":
        return row["method"] + ("" if row["status"] == "done" else f" ({row['status']})")
    if value is None:
        return "-"
    mark = "~" if key == "verified_cpu_s" and row.get("verified_cpu_estimated") else ""
    if kind in ("%", "%%"):
        return f"{100 * value:.{len(kind)}f} %"
    return mark + f"{value:.{1 if kind == '1' else 0}f}"


if __name__ == "__main__":
    sys.exit(main())
