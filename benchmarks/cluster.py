r"""A survey on the workers of a Dask cluster of this machine, of which some are killed, against a local run.

    TIEGRAPH_DATA=... python -m benchmarks.cluster [--set canal_demo] [--workers 2] [--kill masks match dense] \
        --work DIR [-o FILE]

Printed: seconds of each stage in both runs, the artefacts that differ (by the hashes in the receipts; there must be
none), and which workers were killed when. A worker's nanny starts it again, and it takes part from the next stage on.
The workers share the cores of this machine, so the times say what the cluster costs and not what it would gain.
"""

from __future__ import annotations

import argparse
import json
import os
import signal
import subprocess
import sys
import time
from pathlib import Path
from typing import Any

from benchmarks.datasets import Dataset, load

_LOOK_S = 0.05


def main() -> None:
    """Run both and print what came of them."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--set", default="canal_demo")
    parser.add_argument("--workers", type=int, default=2)
    parser.add_argument("--kill", nargs="*", default=["masks", "match", "dense"], help="stages in which one is killed")
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("-o", "--output", type=Path)
    args = parser.parse_args()
    args.work.mkdir(parents=True, exist_ok=True)
    survey = load(args.set, args.work)
    local, there = args.work / "local", args.work / "cluster"
    _run(survey, local, f"local:{args.workers}")
    killed = _over_cluster(survey, there, args.workers, args.kill)
    found = {
        "set": args.set,
        "workers": args.workers,
        "killed": killed,
        "lost": _said(there).count("the others do its work"),
        "artefacts": len(_hashes(local)),
        "different": sorted(n for n, h in _hashes(local).items() if _hashes(there).get(n) != h),
        "seconds": {s: [_receipt(out, s).get("seconds") for out in (local, there)] for s in _stages(local)},
    }
    text = json.dumps(found, indent=1)
    if args.output:
        args.output.write_text(text + "\n")
    sys.stdout.write(text + "\n")


def _command(survey: Dataset, out: Path, pool: str) -> list[str]:
    run = [sys.executable, "-m", "tiegraph", "run", str(survey.images), "-o", str(out)]
    return [*run, *survey.options(), "--pool", pool, "--quiet"]


def _run(survey: Dataset, out: Path, pool: str) -> None:
    subprocess.run(_command(survey, out, pool), check=True)


def _over_cluster(survey: Dataset, out: Path, workers: int, stages: list[str]) -> dict[str, str]:
    """Run over a cluster and kill a worker in each of the stages; stage -> its address."""
    import distributed

    killed: dict[str, str] = {}
    with (
        distributed.LocalCluster(workers, threads_per_worker=1, dashboard_address="127.0.0.1:0") as cluster,
        distributed.Client(cluster, set_as_default=False) as client,
        subprocess.Popen(_command(survey, out, f"dask:{cluster.scheduler_address}")) as process,
    ):
        while process.poll() is None:
            time.sleep(_LOOK_S)
            begun = [s for s in stages if s not in killed and f"stage {s} started" in _said(out)]
            busy = {w: tasks for w, tasks in client.processing().items() if tasks}
            for stage in begun[-1:] if busy else ():
                worker = sorted(busy)[0]
                os.kill(client.run(os.getpid, workers=[worker])[worker], signal.SIGKILL)
                killed[stage] = f"{worker} at {busy[worker][0].rpartition('-')[0]}"
    if process.returncode:
        raise SystemExit(f"the run over the cluster ended with exit code {process.returncode}")
    return killed


def _said(out: Path) -> str:
    """The log of a run."""
    return (out / "log.txt").read_text(errors="replace") if (out / "log.txt").exists() else ""


def _stages(out: Path) -> list[str]:
    """Stages with a receipt of a finished run, in order."""
    found: dict[str, Any] = {p.stem: json.loads(p.read_text()) for p in (out / "receipts").glob("*.json")}
    done = {s: r["finished"] for s, r in found.items() if r.get("finished")}
    return sorted(done, key=lambda s: done[s])


def _receipt(out: Path, stage: str) -> dict[str, Any]:
    path = out / "receipts" / f"{stage}.json"
    return json.loads(path.read_text()) if path.exists() else {}


def _hashes(out: Path) -> dict[str, str]:
    """Artefact -> hash, of all stages but the report, which tells of the run."""
    found: dict[str, str] = {}
    for path in (out / "receipts" / "files").glob("*.json"):
        if path.stem != "report":
            found |= {name: entry[-1] for name, entry in json.loads(path.read_text()).items()}
    return found


if __name__ == "__main__":
    main()
