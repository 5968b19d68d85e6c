"""A run folder in use: its lock, its log, its pool, and the loop over the stages."""

import logging
import time
from collections.abc import Callable, Iterable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager, suppress
from datetime import datetime, timezone
from pathlib import Path
from typing import Any

from tiegraph import forking
from tiegraph.child import end_helpers, start_server
from tiegraph.errors import ChildDied, EngineMissing, InputError, ReconstructionError, SettingsError, TiegraphError
from tiegraph.limits import explained
from tiegraph.plugins import packages
from tiegraph.project.artefacts import DIED, LOST, OTHER_KEY, Artefacts
from tiegraph.project.folder import LOG, check_folder, check_inputs, working_in
from tiegraph.project.inputs import Inputs, Stamps
from tiegraph.project.pool import LocalPool, Place, check_pool, map_items, open_pool
from tiegraph.project.progress import Elsewhere, Meter, Reporter
from tiegraph.project.stages import Receipts, Stage, engines, key_parts, needed, software, stage_keys
from tiegraph.scene.bags import source_of
from tiegraph.text import counted

log = logging.getLogger("tiegraph")


class Run:
    """The context of a stage's code: the folder, the settings, the pool and the progress."""

    def __init__(
        self, folder: Path, inputs: Inputs, settings: Any, pool: str = "local", reporter: Reporter | None = None
    ):
        self.folder = folder.absolute()  # a worker elsewhere has another working folder
        self.inputs = inputs
        self.settings = settings
        self.reporter = reporter or Reporter("quiet")
        self.receipts = Receipts(self.folder)
        self.stamps = Stamps(self.folder)
        self.elsewhere = Elsewhere()
        check_pool(pool)
        self._pool_spec = pool
        self._executor: Executor | None = None
        self._serves = False  # whether this run started the server of helpers
        self._workers = 1

    def keys(self, stages: Sequence[Stage]) -> dict[str, str]:
        """The key of every stage by its present inputs and settings."""
        return stage_keys(stages, self.settings, self.inputs.parts(self.stamps), self.stamps)

    def parts(self, stage: Stage) -> dict[str, str]:
        """The parts of a stage's key besides the keys of the stages it needs."""
        sources = {} if stage.needs else self.inputs.parts(self.stamps)
        return key_parts(stage, self.settings, sources, self.stamps)

    def path(self, *parts: str) -> Path:
        """A path below the run folder."""
        return self.folder.joinpath(*parts)

    @property
    def log(self) -> Path:
        """The run's log file."""
        return self.folder / LOG

    @property
    def workers(self) -> int:
        """How many items run at once."""
        self.open()
        return self._workers

    @property
    def distributed(self) -> bool:
        """Whether the workers may be on other machines."""
        return self._pool_spec.startswith(("dask:", "slurm:"))

    def open(self) -> Executor:
        """The pool, opened when first asked for. Raises what ``open_pool`` raises."""
        if self._executor is None:
            self._serves = start_server() or self._serves
            place = Place(self.folder, (source_of(self.inputs.images),), self.elsewhere, say=self.reporter.say)
            self._executor, self._workers = open_pool(self._pool_spec, place=place)
        return self._executor

    def map(self, function: Callable[..., Any], items: Iterable[Any], *args: Any) -> list[Any]:
        """``[function(item, *args) for item in items]`` over the pool."""
        asked = list(items)
        if not asked:
            return []
        return map_items(self.open(), self._workers, function, asked, args, self.reporter.advance)

    def map_untold(self, function: Callable[..., Any], items: Sequence[Any], *args: Any) -> list[Any]:
        """``map`` without progress: the caller reports it."""
        return map_items(self.open(), self._workers, function, items, args) if items else []

    def make_missing(
        self, function: Callable[..., Any], items: Sequence[str], artefact: Callable[[str], Path], *args: Any
    ) -> list[Any]:
        """``map`` over the items without an artefact; results of those only."""
        todo = [item for item in items if not artefact(item).exists()]
        self.reporter.total(len(items), len(items) - len(todo))
        return self.map(function, todo, *args)

    def rest(self) -> None:
        """End the workers if new ones cost next to nothing: their cached data serves one stage."""
        if isinstance(self._executor, LocalPool) and forking.running():
            self._executor.shutdown()
            self._executor = None

    @contextmanager
    def one_by_one(self) -> Iterator[None]:
        """With a single worker of this machine meanwhile: it takes the least memory, and dies alone."""
        self.close()
        before, self._pool_spec = self._pool_spec, "serial" if self._pool_spec == "serial" else "local:1"
        try:
            yield
        finally:
            self.close()
            self._pool_spec = before

    def close(self) -> None:
        """End the workers."""
        if self._executor is not None:
            self._executor.shutdown(cancel_futures=True)
            self._executor = None
        if self._serves:
            forking.stop()
            self._serves = False


def check_run(stages: Sequence[Stage], run: Run) -> None:
    """Raise InputError, before anything is written, for a run folder that is not ours or where inputs lie."""
    check_folder(run.folder)
    sections = {name: getattr(run.settings, name) for name in type(run.settings).model_fields}
    named = ((s, n, getattr(v, n)) for s, v in sections.items() for n in type(v).model_fields)
    files = {f"--{s}.{n.replace('_', '-')}": value for s, n, value in named if isinstance(value, Path)}
    check_inputs(run.folder, run.inputs.given() | files, [made for s in stages for made in (*s.makes, *s.scratch)])


def without_inputs(stages: Sequence[Stage], run: Run, until: str | None) -> bool:
    """Whether inputs are gone, and no stage that is out of date, up to and including ``until``, reads any."""
    run.keys(stages)  # asks for every input
    if not run.stamps.gone:
        return False
    names = {s.name for s in needed(stages, until) if not s.alone}
    return not any(why for name, why, _ in status(stages, run) if name in names)


def run_stages(
    stages: Sequence[Stage],
    run: Run,
    until: str | None = None,
    remember: Callable[[], Callable[[], None]] = lambda: lambda: None,
) -> list[str]:
    """Run what is out of date, up to and including ``until``; the names of the stages that ran.

    ``remember`` keeps the settings in the run folder and returns a function that undoes this: called if they are
    refused before any stage was finished with them. A stage for which the images give no result (ReconstructionError),
    or whose process ends twice (ChildDied), does not end the run: stages that need it are left out, and the report
    lists it. Raises InputError for files in the run folder that are not ours, other errors of the stages, and in the
    end that error if the stage is ``until`` itself. Such stages are tried again when anything changed, or as ``until``.
    """
    wanted = needed(stages, until)
    check_run(stages, run)
    keys = run.keys(stages)
    artefacts = Artefacts(run.folder, stages)
    ran: list[str] = []
    with working_in(run.folder):
        take_back = remember()
        try:
            artefacts.recover()
            artefacts.look()
            for stage in wanted:
                if artefacts.why(stage, keys[stage.name]):
                    artefacts.refuse(stage)
            while (lost := _run_through(wanted, keys, run, artefacts, ran, until)) is None:
                pass
            artefacts.end_journal()
        except (InputError, SettingsError, EngineMissing):
            if not ran:
                take_back()
            raise
        except KeyboardInterrupt:
            end_helpers()  # idle workers would take seconds to leave in good order
            raise
        finally:
            run.close()
    if until in lost:
        raise lost[until]
    return ran


def _run_through(
    wanted: list[Stage], keys: dict[str, str], run: Run, artefacts: Artefacts, ran: list[str], until: str | None
) -> dict[str | None, ReconstructionError] | None:
    """Run what is out of date; the stages without result, and those that need them. None if a stage could not
    read an artefact of another, which is then out of date."""
    lost: dict[str | None, ReconstructionError] = {}
    news = False  # of lost stages: the report then uses the present reasons
    for stage in wanted:
        key, error = keys[stage.name], None
        away = next((n for n in stage.needs if n in lost and n not in stage.spares and not stage.alone), "")
        known = artefacts.lost(stage, key) if stage.name != until else ""
        after = [s for s in wanted if stage.name in s.needs]  # of removed files: the stages that need them again
        back = artefacts.is_let_go(stage) and (not after or any(artefacts.why(s, keys[s.name]) for s in after))
        if away:
            error = ReconstructionError(f"it needs the stage {away}, which has no result")
            if known != str(error):
                artefacts.begin(stage, key)  # results of an earlier run are no results of this one
        elif known:
            error = ReconstructionError(known)
        elif (news and stage.alone) or artefacts.why(stage, key) or back:
            try:
                _tried(stage, key, run, artefacts)
            except Exception as caught:
                if ran.count(stage.name) < 3 and artefacts.damaged_by(caught):
                    ran.append(stage.name)
                    run.reporter.say(f"{stage.name:>9}  {caught}")
                    run.close()  # items under way may still write
                    return None
                if not stage.needs or not isinstance(caught, ReconstructionError):
                    raise
                error = caught
            else:
                ran.append(stage.name)
                run.stamps.record()
        elif stage.name not in ran:
            run.reporter.say(f"{stage.name:>9}  up to date")
            run.reporter.event("skipped", stage=stage.name)
        if error is not None:
            news |= _lose(stage, error, bool(away), run)
            lost[stage.name] = lost.get(away, error)
    return lost


def _tried(stage: Stage, key: str, run: Run, artefacts: Artefacts) -> None:
    """Run a stage, and if one of its processes ends, once more with one process at a time."""
    try:
        _run_one(stage, key, run, artefacts)
    except ChildDied as error:
        run.reporter.say(f"{stage.name:>9}  {str(error).splitlines()[0]}; tried once more, one process at a time")
        with run.one_by_one():
            _run_one(stage, key, run, artefacts)


def _lose(stage: Stage, error: ReconstructionError, follows: bool, run: Run) -> bool:
    """Report why a stage that has begun has no result, perhaps because of another; whether that is news."""
    why, before = str(error).splitlines()[0], run.receipts.read(stage.name)
    more = {LOST: why, DIED: isinstance(error, ChildDied), "contradictions": () if follows else (why,)}
    run.receipts.write(stage.name, {**before, **more})
    run.reporter.say(f"{stage.name:>9}  ! {why}")
    run.reporter.event("lost", stage=stage.name, why=why)
    return before.get(LOST) != why


def let_go(stages: Sequence[Stage], run: Run) -> int:
    """Remove files that no stage needs any more, if all that need them are up to date; the bytes freed."""
    keys, artefacts, freed = run.keys(stages), Artefacts(run.folder, stages), 0
    with working_in(run.folder):
        artefacts.look()
        for stage in stages:
            others = [s for s in stages if stage.name in s.needs]
            done = not any(artefacts.why(s, keys[s.name]) for s in (stage, *others))
            if stage.passing and done and not artefacts.is_let_go(stage):
                freed += artefacts.let_go(stage)
    return freed


def _run_one(stage: Stage, key: str, run: Run, artefacts: Artefacts) -> None:
    run.open()  # before anything is removed: after this no worker still writes for an earlier run
    for text in artefacts.begin(stage, key):
        run.reporter.say(f"{stage.name:>9}  {text}")
        log.warning("stage %s: %s", stage.name, text)
    run.reporter.event("started", stage=stage.name)
    log.info("stage %s started", stage.name)
    parts = run.parts(stage)
    start, meter = time.perf_counter(), Meter(elsewhere=run.elsewhere)
    try:
        with run.reporter.stage(stage.name):
            outcome = stage.run(run)
    except BaseException as error:
        own = isinstance(error, (TiegraphError, KeyboardInterrupt))
        log.error("stage %s%s", stage.name, f": {error or 'stopped'}" if own else "", exc_info=None if own else error)
        with suppress(OSError, TiegraphError):  # on a full disk the journal stays, with the same content
            artefacts.recover()
        if isinstance(error, Exception) and (told := explained(error, run.folder)) is not None:
            raise told from error
        if isinstance(error, OSError):
            said = f"stage {stage.name}: {error}; finished work is kept, run the same command again"
            raise InputError(said) from error
        raise
    finally:
        used, seconds = meter.stop(), round(time.perf_counter() - start, 2)
    tunings = {engine: getattr(run.settings.tuning, engine) for engine in engines(stage, run.settings)}
    changed = {engine: t.model_dump(mode="json", exclude_defaults=True) for engine, t in tunings.items()}
    plugged = [p for n in (stage.name, *stage.uses) for p in packages(getattr(run.settings, n)).values()]
    more = {
        "key_parts": parts,
        "settings": getattr(run.settings, stage.name).model_dump(mode="json"),
        "tuning": {engine: values for engine, values in changed.items() if values},
        "seconds": seconds,
        **used,
        "software": software() | {p: v for one in plugged for p, v in one.items()},
        "finished": datetime.now(timezone.utc).isoformat(timespec="seconds"),
    }
    run.rest()
    _say_done(stage, artefacts.finish(stage, key, outcome, more), run.reporter)


def _say_done(stage: Stage, receipt: dict, reporter: Reporter) -> None:
    counts = counted(receipt["counts"])
    reporter.say(f"{stage.name:>9}  {receipt['seconds']:7.1f} s  {receipt['peak_mib']:6.0f} MiB  {counts}")
    log.info("stage %s done in %s s: %s", stage.name, receipt["seconds"], counts)
    for note in receipt["notes"]:
        reporter.say(f"{'':>9}  . {note}")
        log.info("stage %s: %s", stage.name, note)
    for text in receipt["contradictions"]:
        reporter.say(f"{'':>9}  ! {text}")
        log.warning("stage %s: contradiction: %s", stage.name, text)
    told = ("stage", "seconds", "cpu_s", "peak_mib", "counts", "notes", "contradictions")
    reporter.event("finished", **{k: receipt[k] for k in told})


def status(stages: Sequence[Stage], run: Run) -> list[tuple[str, str, dict]]:
    """(stage, why it is not up to date or "", its receipt), without running anything."""
    keys = run.keys(stages)
    artefacts = Artefacts(run.folder, stages)
    artefacts.look()
    stale: set[str] = set()
    rows, given = [], run.inputs.given()
    for stage in stages:
        why = artefacts.why(stage, keys[stage.name])
        others = next((f"{need} is out of date" for need in sorted(stale & set(stage.needs))), "")
        if why == OTHER_KEY:
            before, now = artefacts.receipts.read(stage.name).get("key_parts", {}), run.parts(stage)
            changed = [name for name in {**now, **before} if before.get(name) != now.get(name)]  # changed, gone, new
            named = ", ".join(f"{n} {given[n]}" if n in given else n for n in changed)
            why = f"changed: {named}" if before and changed else others or why
        why = why or others
        if why:
            stale.add(stage.name)
        rows.append((stage.name, why, artefacts.receipts.read(stage.name)))
    return rows
