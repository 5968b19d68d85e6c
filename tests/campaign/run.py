"""`python tests/campaign/run.py kills|disks|inputs|artefacts --cases N --seed S`: see README.md beside this file."""

from __future__ import annotations

import argparse
import json
import os
import queue
import shutil
import sys
import tempfile
import threading
import traceback
from collections import Counter
from dataclasses import asdict
from pathlib import Path

TESTS = Path(__file__).resolve().parents[1]
CAMPAIGNS = ("kills", "disks", "inputs", "artefacts")


def main() -> int:
    """The exit code: 0 if no case failed, 1 otherwise."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("campaign", choices=[*CAMPAIGNS, "all"])
    parser.add_argument("--cases", type=int, default=20, help="how many cases of each campaign")
    parser.add_argument("--seed", type=int, default=1)
    parser.add_argument("--only", help="SEED/INDEX of one case, as the table names it")
    parser.add_argument("--jobs", type=int, default=len(os.sched_getaffinity(0)), help="cases at once")
    parser.add_argument("--src", type=Path, default=TESTS.parent / "src", help="the source tree under test")
    parser.add_argument("--work", type=Path, help="folder of the survey and its clean runs, used again if it is there")
    parser.add_argument("--json", type=Path, help="write all cases here")
    options = parser.parse_args()
    sys.path[:0] = [str(options.src.resolve()), str(TESTS)]
    names = CAMPAIGNS if options.campaign == "all" else (options.campaign,)
    seed, indices = options.seed, list(range(options.cases))
    if options.only:
        seed, indices = int(options.only.split("/")[0]), [int(options.only.split("/")[1])]
    work = (options.work or Path(tempfile.mkdtemp(prefix="campaign-"))).resolve()
    results = []
    for name in names:
        results += campaign(name, indices, seed, work, options.src.resolve(), options.jobs, say)
    text = table(results)
    say(text)
    if options.json:
        options.json.write_text(json.dumps([asdict(r) for r in results], indent=1))
    if not options.work:
        shutil.rmtree(work, ignore_errors=True)
    return 1 if failures(results) else 0


def say(text: str) -> None:
    """One line for people."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


def campaign(name: str, indices: list[int], seed: int, work: Path, source: Path, jobs: int, tell=None) -> list:
    """The results of the cases of one campaign, ``jobs`` at once, each on a fork server of its own."""
    import importlib

    from campaign.process import Server
    from campaign.world import make

    module = importlib.import_module(f"campaign.{name}")
    first = Server(source)
    world = make(work, first)
    prepare = getattr(module, "prepare", None)
    context = prepare(world, first) if prepare else None
    todo: queue.SimpleQueue = queue.SimpleQueue()
    for index in indices:
        todo.put(index)
    results: list = []

    def work_off(server: Server | None, number: int) -> None:
        server = server or Server(source)
        while True:
            try:
                index = todo.get_nowait()
            except queue.Empty:
                break
            results.append(one(module, name, seed, index, world, server, context))
            if tell:
                r = results[-1]
                tell(f"{len(results):4d}/{len(indices)} {r.only:>8} {r.seconds:6.1f} s {r.verdict:<10} {r.what[:150]}")
        server.close()

    threads = [threading.Thread(target=work_off, args=(first if k == 0 else None, k)) for k in range(jobs)]
    for thread in threads:
        thread.start()
    for thread in threads:
        thread.join()
    return sorted(results, key=lambda r: int(r.only.split("/")[1]))


def one(module, name: str, seed: int, index: int, world, server, context):
    """One case; an error of the harness itself is a failing case of its own name, never a good one."""
    from campaign import oracle
    from campaign.case import Case

    case = Case(name, seed, index, world, server, world.root / "cases" / f"{name}-{seed}-{index}")
    try:
        case.context = context
        result = module.run(case)
    except Exception:
        result = case.result("harness", "harness", oracle.Verdict("harness", traceback.format_exc()[-400:]))
        server.recover()
    shutil.rmtree(case.folder, ignore_errors=True)
    return result


def failures(results: list) -> list:
    """The cases that failed."""
    from campaign import oracle

    return [r for r in results if r.verdict not in oracle.GOOD]


def table(results: list) -> str:
    """Counts by campaign, kind and verdict, then every failing case with what runs it alone."""
    from campaign import oracle

    columns = [*oracle.GOOD, *oracle.FAILURES, "harness"]
    columns = [c for c in columns if any(r.verdict == c for r in results)]
    counts = Counter((r.campaign, r.kind, r.verdict) for r in results)
    lines = ["", f"{'campaign':<10}{'kind':<14}{'cases':>7}" + "".join(f"{c:>11}" for c in columns)]
    rows = sorted({(r.campaign, r.kind) for r in results})
    for campaign_name, kind in rows:
        values = [counts[campaign_name, kind, c] for c in columns]
        lines.append(f"{campaign_name:<10}{kind:<14}{sum(values):>7}" + "".join(f"{v or '.':>11}" for v in values))
    for name in sorted({r.campaign for r in results}):
        values = [sum(r.campaign == name and r.verdict == c for r in results) for c in columns]
        lines.append(f"{name:<10}{'all':<14}{sum(values):>7}" + "".join(f"{v or '.':>11}" for v in values))
    for r in failures(results):
        lines += ["", f"{r.campaign} --only {r.only}: {r.verdict}: {r.what}", f"    {r.why}"]
    return "\n".join(lines)


if __name__ == "__main__":
    sys.exit(main())
