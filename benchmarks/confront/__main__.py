"""Run the bench: ``python -m benchmarks.confront --sets boat vehicle --json out.json --work DIR``.

Each set first runs without a fault; each case then changes one input by one fault of one size and is judged against
the truth. Rows are written after each case; a row that is there is not run again (``--again``).
"""

from __future__ import annotations

import argparse
import json
import os
import shutil
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import tiegraph  # noqa: F401  before pycolmap
from benchmarks import run as runner
from benchmarks.confront import judge, sets
from benchmarks.confront.faults import SIZES, Fault, Wronged
from benchmarks.confront.given import Given, write
from benchmarks.confront.said import read
from benchmarks.confront.table import table

CLEAN = "clean"
_DRIVE = Path(__file__).resolve().parent / "drive.py"


@dataclass(frozen=True)
class Bench:
    """Where and how: folder of inputs and runs, the tree under test, the last stage, seconds a run may take."""

    work: Path
    src: Path
    label: str
    until: str
    timeout_s: float
    keep: bool

    def run_folder(self, name: str) -> Path:
        """Where the run of a set without faults is."""
        return self.work / "runs" / self.label / name.replace(":", "-")


def main(argv: list[str] | None = None) -> int:
    """The exit code: 0 without a silent failure or a false alarm."""
    args = _arguments(argv)
    bench = Bench(args.work.resolve(), args.src.resolve(), args.label, args.until, args.timeout, args.keep)
    results = _load(args.json, args)
    for name, fault, size in _wanted(args):
        if not args.again and _known(results, name, fault, size):
            continue
        row = one(bench, name, fault, size)
        if row is not None:
            _add(results, row, args.json, bench.work)
            wrong = ", ".join(f"{q}{f' ({h})' if h else ''}" for q, h in zip(row["wrong"], row["how"]))
            _say(f"{name}/{fault}/{size}: {row['verdict']} {wrong} {row['cpu_s']:.0f} CPU s")
    _say(table(results["rows"]))
    bad = [r for r in results["rows"] if r["verdict"] in ("silent", "alarm", "crashed")]
    return 1 if bad else 0


def _arguments(argv: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--sets", nargs="+", default=["tiny"], choices=sets.names(), metavar="SET")
    parser.add_argument("--faults", nargs="+", default=[], help="default: all that a set can be given")
    parser.add_argument("--sizes", nargs="+", type=int, default=list(SIZES), choices=SIZES)
    parser.add_argument("--only", nargs="+", default=[], metavar="SET/FAULT/SIZE", help="these cases and no others")
    parser.add_argument("--again", action="store_true", help="run cases anew whose rows are there")
    parser.add_argument("--until", default="georef", help="the last stage of a run")
    parser.add_argument("--timeout", type=float, default=1800.0, help="seconds a run may take")
    parser.add_argument(
        "--src",
        type=Path,
        default=_DRIVE.parents[2] / "src",
        help="the source tree under test; a checkout with its own .venv if not this one",
    )
    parser.add_argument("--label", default="now", help="name of that tree; its clean runs are used again")
    parser.add_argument("--keep", action="store_true", help="keep the run folders of the cases")
    parser.add_argument("--work", type=Path, required=True, help="folder of inputs and runs, used again")
    parser.add_argument("--json", type=Path, required=True, help="rows are added here")
    return parser.parse_args(argv)


def _wanted(args: argparse.Namespace) -> list[tuple[str, str, int]]:
    """The cases in order: of a set first the clean one, then small to large."""
    if args.only:
        words = [w.rsplit("/", 2) for w in args.only]
        return [(name, fault, int(size)) for name, fault, size in words]
    out = []
    for name in args.sets:
        known = [*sets.FAULTS, "apart", "stranger"]
        faults = [f for f in args.faults if f != CLEAN] or ([] if args.faults else known)
        out.append((name, CLEAN, 0))
        out += [(name, fault, size) for fault in faults for size in args.sizes]
    return out


def one(bench: Bench, name: str, fault: str, size: int) -> dict[str, Any] | None:
    """One case; None where the survey has nothing that this fault could spoil."""
    given = sets.load(name, bench.work)
    if fault == CLEAN:
        return _case(bench, name, (CLEAN, 0), Wronged(given, "nothing", {}), None)
    table = sets.faults_of(name, given, bench.work)
    if fault not in table:
        return None
    kind = table[fault]
    wronged = kind.make(given, kind.sizes[size])
    if wronged is None:
        return None
    clean = bench.run_folder(name)
    if "scan" not in kind.redo and not (clean / "world.json").exists():
        _case(bench, name, (CLEAN, 0), Wronged(given, "nothing", {}), None)
    return _case(bench, name, (fault, size), wronged, kind) | {"size_is": kind.sizes[size]}


def _case(bench: Bench, name: str, which: tuple[str, int], wronged: Wronged, kind: Fault | None) -> dict[str, Any]:
    fault, size = which
    clean = bench.run_folder(name)
    out = clean if kind is None else bench.work / "cases" / bench.label / f"{name.replace(':', '-')}-{fault}-{size}"
    inputs = bench.work / "inputs" / (out.name if kind else f"{out.name}-clean")
    shutil.rmtree(out, ignore_errors=True)
    out.parent.mkdir(parents=True, exist_ok=True)
    same = kind is not None and "scan" not in kind.redo  # the images are the clean ones
    given = write(wronged.given, inputs, bench.work / "inputs" / f"{clean.name}-clean" / "images" if same else None)
    done = _run(bench, given, out, (clean if same else None, kind.redo if kind else ("scan",)))
    row = {
        "set": name,
        "fault": fault,
        "size": size,
        "what": wronged.what,
        **_judged(out, wronged, kind, done["error"]),
    }
    row |= {"cpu_s": done["cpu_s"], "wall_s": done["wall_s"]}
    if kind is not None and not bench.keep:
        shutil.rmtree(out, ignore_errors=True)
        shutil.rmtree(inputs, ignore_errors=True)
    return row


def _run(bench: Bench, files: dict[str, Path], out: Path, base: tuple[Path | None, tuple[str, ...]]) -> dict[str, Any]:
    """Run the child in a process of its own; how it ended in ``error``, "" if well."""
    command: list[str] = ["run", str(files["images"]), "-o", str(out), "--pool", "serial"]
    for option in ("rig", "gnss", "times"):
        command += [f"--{option}", str(files[option])] if option in files else []
    clean, redo = base
    spec = {"src": str(bench.src), "command": command, "out": str(out), "until": bench.until, "redo": list(redo)}
    path, log = out.with_name(out.name + ".json"), out.with_name(out.name + ".txt")
    path.write_text(json.dumps({**spec, "clean": str(clean) if clean else None}))
    # An editable install finds its own sources before any path: another tree runs by its own environment.
    own = bench.src.parent / ".venv" / "bin" / "python"
    python = str(own) if own.exists() else sys.executable
    words = ["env", f"PYTHONPATH={bench.src}", python, str(_DRIVE), str(path)]
    log.unlink(missing_ok=True)
    done = runner.measured(words, log, bench.timeout_s)
    done["error"] = _ended(done["returncode"], log)
    path.unlink()
    return done


def _ended(code: int | None, log: Path) -> str:
    lines = [line for line in log.read_text(errors="replace").splitlines() if line.strip()]
    last = lines[-1] if lines else "nothing"
    if code is None:
        return f"unexpected: took longer than the limit; {last}"
    if code < 0 or (code and any(line.startswith("Traceback") for line in lines)):
        return f"unexpected: ended by {code}; {last}"
    return last if code else ""


def _judged(out: Path, wronged: Wronged, kind: Fault | None, error: str) -> dict[str, Any]:
    given: Given = wronged.given
    said, wrong_input = read(out, error), kind.input if kind else ""
    errors: tuple[judge.Error, ...] = ()
    registered = 0
    if not error:
        world = json.loads((out / "world.json").read_text())
        found = judge.model_of(out, given, world.get("origin"))
        errors, registered = judge.errors_of(found, given, said, wronged.held), len(found.cam_from_world)
    row = judge.verdict(errors, said, wrong_input, registered).row()
    return row | {"images": len(given.images), "contradictions": list(said.contradictions), "hedges": list(said.hedges)}


# --- results file ---------------------------------------------------------------------------------------------------


def _load(path: Path, args: argparse.Namespace) -> dict[str, Any]:
    if path.exists():
        return json.loads(path.read_text())
    return {"format": 1, "machine": runner._machine(), "label": args.label, "rows": []}


def _known(results: dict[str, Any], name: str, fault: str, size: int) -> bool:
    return any((r["set"], r["fault"], r["size"]) == (name, fault, size) for r in results["rows"])


def _add(results: dict[str, Any], row: dict[str, Any], path: Path, work: Path) -> None:
    row = runner._without_paths(row, work, path.parent)
    rest = [r for r in results["rows"] if any(r[k] != row[k] for k in ("set", "fault", "size"))]
    results["rows"] = [*rest, row]
    path.parent.mkdir(parents=True, exist_ok=True)
    part = path.with_suffix(".part")
    part.write_text(json.dumps(runner._rounded(results), indent=1) + "\n")
    os.replace(part, path)


def _say(text: str) -> None:
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


if __name__ == "__main__":
    sys.exit(main())
