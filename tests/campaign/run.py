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
from collections.abc import Callable
from dataclasses import asdict, dataclass
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
    parser.add_argument("--short", action="store_true", help="leave out cases that need minutes, as CI does")
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
    plan = Plan(seed, indices, work, options.src.resolve(), options.jobs, options.short)
    results = []
    for name in names:
        done = list(results)

        def tell(now: list, done: list = done, out: Path | None = options.json) -> None:
            r = now[-1]
            say(f"{len(now):4d}/{len(indices)} {r.only:>8} {r.seconds:6.1f} s {r.verdict:<10} {r.what[:150]}")
            if out:  # after every case, for the machine can stop
                out.write_text(json.dumps([asdict(r) for r in [*done, *now]], indent=1))

        results += campaign(name, plan, tell)
    text = table(results)
    say(text)
    if not options.work:
        shutil.rmtree(work, ignore_errors=True)
    lost = len(names) * len(indices) - len(results)
    if lost:
        say(f"{lost} cases were not run")
    return 1 if failures(results) or lost else 0


def say(text: str) -> None:
    """One line for people."""
    sys.stdout.write(text + "\n")
    sys.stdout.flush()


@dataclass(frozen=True)
class Plan:
    """``seed`` and numbers of the cases, the folder of survey and clean runs, the source tree under test, how many
    cases at once; ``short``: cases of minutes are left to the long form."""

    seed: int
    indices: list[int]
    work: Path
    source: Path
    jobs: int = 2
    short: bool = False


def campaign(name: str, plan: Plan, tell: Callable[[list], None] | None = None, server=None) -> list:
    """The results of the cases of one campaign, each worker on a fork server of its own, the first on ``server`` if one
    is given (it stays open)."""
    import importlib

    from campaign.process import Server
    from campaign.world import make

    module = importlib.import_module(f"campaign.{name}")
    first = server or Server(plan.source)
    world = make(plan.work, first)
    prepare = getattr(module, "prepare", None)
    context = prepare(world, first, plan.short) if prepare else None
    todo: queue.SimpleQueue = queue.SimpleQueue()
    for index in plan.indices:
        todo.put(index)
    results: list = []
    lock = threading.Lock()

    def work_off(number: int) -> None:
        own = Server(plan.source) if number else first
        while True:
            try:
                index = todo.get_nowait()
            except queue.Empty:
                break
            result = one(module, name, plan.seed, index, world, own, context)
            with lock:
                results.append(result)
                if tell:
                    tell(results)
        if own is not server:
            own.close()

    threads = [threading.Thread(target=work_off, args=(k,)) for k in range(plan.jobs)]
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

    return [r for r in results if r.verdict not in (*oracle.GOOD, oracle.LATER)]


def table(results: list) -> str:
    """Counts by campaign, kind and verdict, then every failing case with what runs it alone."""
    from campaign import oracle

    columns = [*oracle.GOOD, oracle.LATER, *oracle.FAILURES, "harness"]
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
