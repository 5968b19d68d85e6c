"""One case of a campaign: its place, its generator, its result, and what every campaign ends with."""

from __future__ import annotations

import random
import shutil
import time
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

from campaign import oracle
from campaign.compare import differences, left_over
from campaign.process import Ended, Server
from campaign.world import PATIENCE_S, World, fingerprint


@dataclass
class Result:
    """A row of the table. ``only``: what --only takes to run it alone."""

    campaign: str
    only: str
    kind: str
    what: str
    verdict: str
    why: str
    seconds: float
    text: str = ""


@dataclass
class Case:
    """Where a case works and what it draws from."""

    campaign: str
    seed: int
    index: int
    world: World
    server: Server
    folder: Path
    began: float = field(default_factory=time.monotonic)
    context: Any = None  # what the campaign's prepare() made

    def __post_init__(self) -> None:
        self.rng = random.Random(f"{self.campaign}/{self.seed}/{self.index}")
        shutil.rmtree(self.folder, ignore_errors=True)
        self.folder.mkdir(parents=True)

    def result(self, kind: str, what: str, verdict: oracle.Verdict, text: str = "") -> Result:
        """The row of this case."""
        seconds = round(time.monotonic() - self.began, 1)
        shown = "" if verdict.name in oracle.GOOD else text[-3000:]
        only = f"{self.seed}/{self.index}"
        return Result(self.campaign, only, kind, what, verdict.name, verdict.why[:500], seconds, shown)


def finish_again(case: Case, command: list[str], out: Path, own: dict[str, bytes]) -> tuple[oracle.Verdict | None, str]:
    """Run the same command to its end; (what is wrong with it, None = nothing; what it said). ``own``: files of the
    user in the run folder: a refusal that names one is right, they are then moved away."""
    ended = case.server.run(command, case.folder, PATIENCE_S)
    for _ in list(own):
        lines = oracle.error_lines(ended.text)
        named = [n for n in own if lines and Path(n).name in lines[-1]]
        if ended.code == 0 or not named or not _kept(out, own):
            break
        for name in named:
            (out / name).rename(case.folder / f"moved-{Path(name).name}")
            del own[name]
        ended = case.server.run(command, case.folder, PATIENCE_S)
    return wrong(case, ended, out, own), ended.text


def _kept(out: Path, own: dict[str, bytes]) -> bool:
    return all((out / n).is_file() and (out / n).read_bytes() == data for n, data in own.items())


def wrong(case: Case, ended: Ended, out: Path, own: dict[str, bytes], changed: bool = False) -> oracle.Verdict | None:
    """What is wrong with a run that had to end with the clean run's result; None = nothing. ``changed``: a person has
    changed what it made, and that may be set aside."""
    if not _kept(out, own):
        return oracle.Verdict(oracle.LOSS, f"of {sorted(own)} in the run folder some are gone or changed")
    if fingerprint(case.world.inputs) != case.world.marks:
        return oracle.Verdict(oracle.LOSS, "the inputs were changed")
    fault = oracle.text_fault(ended)
    if fault is not None:
        return fault
    if ended.code != 0:
        return oracle.Verdict(oracle.STUCK, f"the same command again: {oracle.error_lines(ended.text)[:2]}")
    different = differences(case.world.clean[max_stage(case.world)], out, own)
    if different:
        return oracle.Verdict(oracle.SILENT, "not the clean run's result: " + "; ".join(different[:4]))
    left = left_over(case.world.clean[max_stage(case.world)], out, own)
    left = [name for name in left if not (changed and Path(name).parts[0] == "set_aside")]
    return oracle.Verdict(oracle.LEFTOVER, "; ".join(left[:4])) if left else None


def max_stage(world: World) -> str:
    """The last stage of the clean runs."""
    return list(world.clean)[-1]
