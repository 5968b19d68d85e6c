"""A process that is killed (SIGKILL) at any of the steps by which a writer reaches the disk leaves nothing behind: what
is written next, or the run that goes on, ends with the files of an undisturbed one and no others."""

from __future__ import annotations

import os
import signal
import sys
from collections.abc import Callable
from pathlib import Path

import numpy as np
import pytest
from test_stages import All, first

from features_world import scene
from tiegraph.geometry.geodesy import ENU, Origin
from tiegraph.pipeline.clouds import new_folder
from tiegraph.pipeline.files import save_npz, save_png
from tiegraph.project.inputs import Inputs
from tiegraph.project.run import Run, run_stages
from tiegraph.project.stages import Outcome, Stage, write_atomic
from tiegraph.scene import colmapdatabase
from tiegraph.scene.atomic import JOURNAL, MARK, replacing, scratch_folder, sweep
from tiegraph.scene.cloudfile import write_ply
from tiegraph.scene.colmaprows import create_database
from tiegraph.scene.copc import write_copc
from tiegraph.scene.results import Cloud

STEPS = ("open", "os.rename", "os.remove", "os.rmdir", "os.mkdir", "os.link", "shutil.rmtree", "sqlite3.connect")


def killed_at(step: int, work: Callable[[], object], folder: Path) -> bool:
    """Do the work in a child that is killed before its ``step``-th step below a folder; whether it came so far."""
    child = os.fork()
    if not child:
        left = step

        def hook(event: str, args: tuple) -> None:
            nonlocal left
            reads = event == "open" and not args[2] & (os.O_WRONLY | os.O_RDWR)
            if event in STEPS and not reads and str(folder) in str(args[0]):
                left -= 1
                if not left:
                    os.kill(os.getpid(), signal.SIGKILL)

        sys.addaudithook(hook)
        try:
            work()
        except BaseException as error:
            sys.stderr.write(f"{error!r}\n")
            os._exit(1)
        os._exit(0)
    status = os.waitpid(child, 0)[1]
    assert status in (0, signal.SIGKILL)
    return status == signal.SIGKILL


def there(folder: Path) -> dict[str, bytes]:
    """What lies below a folder, without what tells of times."""
    files = {p.relative_to(folder).as_posix(): p.read_bytes() for p in folder.rglob("*") if p.is_file()}
    told = {n: b"" for n in files if n.startswith("receipts/") or n == "log.txt"}
    return files | told | {f"{p.relative_to(folder)}/": b"" for p in folder.rglob("*") if p.is_dir()}


def second(run: Run) -> Outcome:
    """With a scratch folder, and what its first run left in a database."""
    write_atomic(run.path("second", ".run", "kept.txt"), "1")
    save_npz(run.path("second", "table.npz"), values=np.arange(9))
    return Outcome()


STAGES = (
    Stage("first", first, (), ("first",), "file"),
    Stage("second", second, ("first",), ("second",), scratch=("second/.run",)),
)


@pytest.mark.slow
def test_a_run_that_is_killed_at_any_step(tmp_path: Path) -> None:
    """At every seventh of its steps: the suite takes no minute for it."""
    images = tmp_path / "images"
    images.mkdir()
    (images / "a.jpg").write_bytes(b"x")

    def work(out: Path) -> Callable[[], object]:
        return lambda: run_stages(STAGES, Run(out, Inputs(images), All(), pool="serial"))

    work(tmp_path / "clean")()
    clean, step = there(tmp_path / "clean"), 1
    assert {"first/2.txt", "second/table.npz", "receipts/files/second.json"} <= clean.keys() and JOURNAL not in clean
    while killed_at(step, work(out := tmp_path / str(step)), out):
        work(out)()
        assert there(out) == clean, f"killed at step {step}"
        step += 7
    assert step > 50


def cloud() -> Cloud:
    xyz = np.random.default_rng(1).uniform(0, 9, (500, 3))
    rgb, normal, one = np.zeros((500, 3), np.uint8), np.zeros((500, 3), np.float32), np.ones(500, np.float32)
    return Cloud(xyz, rgb, normal, sigma_m=one, views=one.astype(np.uint8), origin=Origin(0.0, 0.0, 0.0, ENU))


def in_folder(path: Path) -> None:
    with new_folder(path) as folder:
        for name in "ab":
            (folder / name).write_text(name)


def rewritten(path: Path) -> None:
    create_database(path, scene())
    colmapdatabase.write_anew(path)


WRITERS = {
    "text": lambda path: write_atomic(path, "words"),
    "table": lambda path: save_npz(path, values=np.arange(99)),
    "mask": lambda path: save_png(path, np.eye(9, dtype=bool)),
    "folder": in_folder,
    "database": rewritten,
    "PLY": lambda path: write_ply([cloud()], path),
    "COPC": lambda path: write_copc(lambda: iter([cloud()]), path, 0.1, path.parent),
}


@pytest.mark.slow
@pytest.mark.parametrize(
    "name, marked", [*((n, True) for n in WRITERS), *((n, False) for n in ("text", "folder", "database"))]
)
def test_a_writer_that_is_killed_at_any_step(tmp_path: Path, name: str, marked: bool) -> None:
    """In a run folder what is left goes when that is opened, elsewhere when the same is written again."""
    step = 1
    while True:
        out = tmp_path / str(step)
        if marked:
            write_atomic(out / MARK, "{}")
        if not killed_at(step, lambda out=out: WRITERS[name](out / "made.bin"), out):
            break
        if marked:
            sweep(out.rglob(".*.part*"))
        if not (out / "made.bin").exists() or name != "folder":
            WRITERS[name](out / "made.bin")
        assert set(there(out)) - {JOURNAL} == set(there(tmp_path / "1")) - {JOURNAL}, f"killed at step {step}"
        assert name == "folder" or (out / "made.bin").read_bytes() == (tmp_path / "1" / "made.bin").read_bytes()
        step += 1
    assert step > 4


def test_what_a_living_process_writes_stays(tmp_path: Path) -> None:
    with replacing(tmp_path / "a.txt") as temporary:
        temporary.touch()
        other = temporary.with_name(temporary.name.replace(str(os.getpid()), str(os.getppid())))
    names = [other.name, f".0123abcd.{2**22 + 1}.part.txt", f".0123abcd.{os.getpid()}.part", ".0123abcd.part", "a.part"]
    for name in names:
        (tmp_path / name).write_text("")
    old = temporary.with_name(f".0123abcd.{os.getpid()}.part.old")
    old.touch()
    os.utime(old, (0, 0))  # of a process that had our number
    sweep(tmp_path.iterdir())
    assert {p.name for p in tmp_path.iterdir()} == {"a.txt", *names} - {names[1]}
    with scratch_folder(tmp_path) as outer, scratch_folder(tmp_path) as inner:
        assert outer.is_dir() and inner.is_dir() and outer != inner
    assert not outer.exists()
