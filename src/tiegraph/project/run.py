"""A run folder at work: its lock, its log, its pool, and the loop over the stages."""

from __future__ import annotations

import json
import logging
import platform
import time
from collections.abc import Callable, Iterator, Sequence
from concurrent.futures import Executor
from contextlib import contextmanager
from dataclasses import dataclass
from datetime import datetime, timezone
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path
from typing import Any

from tiegraph import __version__
from tiegraph.errors import InputError, TiegraphError
from tiegraph.limits import explained
from tiegraph.project.pool import map_items, open_pool
from tiegraph.project.progress import LogFormatter, Meter, Reporter
from tiegraph.project.stages import Receipts, Stage, digest, stage_keys, stamp, write_atomic

log = logging.getLogger("tiegraph")

_PACKAGES = ("pycolmap", "numpy", "opencv-python-headless", "scipy", "laspy", "pyproj")


@dataclass(frozen=True)
class Inputs:
    """What a user hands to a run."""

    images: Path
    rig: str | None = None
    gnss: Path | None = None
    trajectory: Path | None = None
    times: Path | None = None

    def key(self) -> str:
        """Hash over names, sizes and times of all inputs."""
        rig = stamp(Path(self.rig)) if self.rig and Path(self.rig).exists() else None
        files = [stamp(p) if p else None for p in (self.images, self.gnss, self.trajectory, self.times)]
        return digest([str(self.images), self.rig, rig, files])

    def check(self) -> None:
        """Raise InputError for an input that is not there."""
        if not self.images.exists():
            raise InputError(f"{self.images}: no such folder; give the folder that holds the survey's images")
        if not self.images.is_dir():
            raise InputError(f"{self.images} is a file; give the folder that holds the survey's images")
        for option, path in (("--gnss", self.gnss), ("--trajectory", self.trajectory), ("--times", self.times)):
            if path is not None and not path.exists():
                raise InputError(f"{option} {path}: no such file or folder")


class Run:
    """What the glue of a stage works with: the folder, the settings, the pool and the progress."""

    def __init__(
        self, folder: Path, inputs: Inputs, settings: Any, pool: str = "local", reporter: Reporter | None = None
    ):
        self.folder = folder
        self.inputs = inputs
        self.settings = settings
        self.reporter = reporter or Reporter("quiet")
        self.receipts = Receipts(folder)
        self._pool_spec = pool
        self._executor: Executor | None = None
        self._workers = 1

    def path(self, *parts: str) -> Path:
        """A path below the run folder."""
        return self.folder.joinpath(*parts)

    @property
    def log(self) -> Path:
        """The run's log file."""
        return self.folder / "log.txt"

    @property
    def workers(self) -> int:
        """How many items run at once."""
        self._open()
        return self._workers

    def _open(self) -> Executor:
        if self._executor is None:
            self._executor, self._workers = open_pool(self._pool_spec)
        return self._executor

    def map(self, function: Callable[..., Any], items: Sequence[Any], *args: Any) -> list[Any]:
        """``[function(item, *args) for item in items]`` over the pool."""
        if not items:
            return []
        return map_items(self._open(), self._workers, function, items, args, self.reporter.advance)

    def make_missing(
        self, function: Callable[..., Any], items: Sequence[str], artefact: Callable[[str], Path], *args: Any
    ) -> list[Any]:
        """``map`` over the items whose artefact is not there yet; results of those only."""
        todo = [item for item in items if not artefact(item).exists()]
        self.reporter.total(len(items), len(items) - len(todo))
        return self.map(function, todo, *args)

    def close(self) -> None:
        """End the workers."""
        if self._executor is not None:
            self._executor.shutdown(cancel_futures=True)
            self._executor = None


def run_stages(stages: Sequence[Stage], run: Run, until: str | None = None) -> list[str]:
    """Run what is out of date, up to and including ``until``; the names of the stages that ran."""
    wanted = needed(stages, until)
    keys = stage_keys(stages, run.settings, run.inputs.key())
    ran = []
    with locked(run.folder), logged(run.log):
        try:
            for stage in wanted:
                if run.receipts.current(stage, keys[stage.name]):
                    run.reporter.say(f"{stage.name:>9}  up to date")
                    run.reporter.event("skipped", stage=stage.name)
                    continue
                _run_one(stage, keys[stage.name], run)
                ran.append(stage.name)
        finally:
            run.close()
    return ran


def needed(stages: Sequence[Stage], until: str | None) -> list[Stage]:
    """The stages a target needs, in order; all of them without a target."""
    if until is None:
        return list(stages)
    table = {s.name: s for s in stages}
    if until not in table:
        raise InputError(f"unknown stage {until!r}: the stages are {', '.join(table)}")
    want, todo = set(), [until]
    while todo:
        name = todo.pop()
        if name not in want:
            want.add(name)
            todo.extend(table[name].needs)
    return [s for s in stages if s.name in want]


def _run_one(stage: Stage, key: str, run: Run) -> None:
    run.receipts.begin(stage, key)
    run.reporter.event("started", stage=stage.name)
    log.info("stage %s started", stage.name)
    start, meter = time.perf_counter(), Meter()
    try:
        with run.reporter.stage(stage.name):
            outcome = stage.run(run)
    except TiegraphError as error:
        log.error("stage %s: %s", stage.name, error)
        if (told := explained(error, run.folder)) is not None:
            raise told from error
        raise
    except Exception as error:
        log.exception("stage %s", stage.name)
        if (told := explained(error, run.folder)) is not None:
            raise told from error
        if not isinstance(error, OSError):
            raise
        raise InputError(f"stage {stage.name}: {error}; finished work is kept, run the same command again") from error
    finally:
        used = meter.stop()
    seconds = round(time.perf_counter() - start, 2)
    section = getattr(run.settings, stage.name).model_dump(mode="json")
    more = {"settings": section, "seconds": seconds, **used, "software": software(), "finished": _now()}
    receipt = run.receipts.finish(stage, key, outcome, more)
    _say_done(stage, receipt, run.reporter)


def _say_done(stage: Stage, receipt: dict, reporter: Reporter) -> None:
    counts = ", ".join(f"{_short(v)} {k.replace('_', ' ')}" for k, v in receipt["counts"].items())
    reporter.say(f"{stage.name:>9}  {receipt['seconds']:7.1f} s  {receipt['peak_mib']:6.0f} MiB  {counts}")
    for note in receipt["notes"]:
        reporter.say(f"{'':>9}  . {note}")
    reporter.event("finished", **{k: receipt[k] for k in ("stage", "seconds", "cpu_s", "peak_mib", "counts", "notes")})
    log.info("stage %s done in %s s: %s", stage.name, receipt["seconds"], counts)
    for note in receipt["notes"]:
        log.info("stage %s: %s", stage.name, note)


def status(stages: Sequence[Stage], run: Run) -> list[tuple[str, str, dict]]:
    """(stage, why it is not up to date or "", its receipt), without running anything."""
    keys = stage_keys(stages, run.settings, run.inputs.key())
    stale: set[str] = set()
    rows = []
    for stage in stages:
        why = run.receipts.why(stage, keys[stage.name])
        if not why and stale & set(stage.needs):
            why = f"{sorted(stale & set(stage.needs))[0]} is out of date"
        if why:
            stale.add(stage.name)
        rows.append((stage.name, why, run.receipts.read(stage.name)))
    return rows


def software() -> dict[str, str]:
    """Versions a result depends on."""
    out = {"tiegraph": __version__, "python": platform.python_version()}
    for package in _PACKAGES:
        try:
            out[package] = version(package)
        except PackageNotFoundError:
            pass
    return out


@contextmanager
def locked(folder: Path) -> Iterator[None]:
    """Only one run works in a folder at a time. Raises InputError when another does."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
        handle = open(folder / ".lock", "w")
    except OSError as error:
        raise InputError(f"cannot write into {folder}: {error.strerror}; choose another -o folder") from error
    try:
        try:
            import fcntl

            fcntl.flock(handle, fcntl.LOCK_EX | fcntl.LOCK_NB)
        except ImportError:  # Windows: no lock
            pass
        except OSError:
            raise InputError(f"{folder}: another tiegraph run is working here; wait for it or stop it") from None
        yield
    finally:
        handle.close()


@contextmanager
def logged(path: Path) -> Iterator[None]:
    """Log records of tiegraph go to a file while a run goes on."""
    handler = logging.FileHandler(path, encoding="utf-8")
    handler.setFormatter(LogFormatter("%(asctime)s %(levelname)s %(name)s: %(message)s"))
    level = log.level
    handler.handleError = lambda record: None  # type: ignore[method-assign]  # a full disk; the stage says so
    log.addHandler(handler)
    log.setLevel(logging.INFO)
    try:
        yield
    finally:
        log.removeHandler(handler)
        log.setLevel(level)
        handler.close()


def _short(value: Any) -> str:
    if isinstance(value, float) and not value.is_integer():
        return f"{value:.3g}"
    return f"{int(value)}" if isinstance(value, (int, float)) else str(value)


def _now() -> str:
    return datetime.now(timezone.utc).isoformat(timespec="seconds")


def save_json(path: Path, data: Any) -> None:
    """Write JSON atomically."""
    write_atomic(path, json.dumps(data, indent=1, default=lambda v: v.tolist() if hasattr(v, "tolist") else str(v)))
