"""Receipts and resume on a table of small stages that write files; what libraries print meanwhile is in the log."""

from __future__ import annotations

import json
import os
import shutil
import sys
from contextlib import nullcontext
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from PIL.TiffImagePlugin import ImageFileDirectory_v2
from pydantic import Field, create_model

from campaign.process import Server
from said import refused
from tiegraph.errors import ChildDied, InputError, ProcessLost, ReconstructionError
from tiegraph.project.folder import LOG, working_in
from tiegraph.project.inputs import Inputs
from tiegraph.project.pool import map_items, open_pool
from tiegraph.project.progress import Reporter
from tiegraph.project.run import Run, let_go, run_stages, status, without_inputs
from tiegraph.project.stages import Outcome, Stage, write_atomic
from tiegraph.scene.atomic import replacing
from tiegraph.settings import Section


class One(Section):
    value: int = Field(default=1, ge=0)


class Two(Section):
    file: Path | None = None


class Constants(Section):
    least: int = 3
    most: int = 5


class Tunings(Section):
    first: Constants = Constants()
    other: Constants = Constants()


class All(Section):
    first: One = One()
    second: Two = Two()
    third: One = One()
    tuning: Tunings = Tunings()


def fail(text):
    raise RuntimeError(text)


def first(run):
    for k in range(3):
        path = run.path("first", f"{k}.txt")
        if not path.exists():
            if k == 2 and (run.folder.parent / "trip").exists():
                fail("power cut")
            write_atomic(path, str(run.settings.first.value))
            with (run.folder.parent / "work.log").open("a") as log:
                log.write(f"{k} ")
    return Outcome({"items": 3})


def second(run):
    write_atomic(run.path("second.txt"), "2")
    return Outcome(notes=("a note",))


def third(run):
    write_atomic(run.path("third.txt"), run.path("first", "0.txt").read_text())
    return Outcome()


STAGES = (
    Stage("first", first, (), ("first",), "file"),
    Stage("second", second, (), ("second.txt",)),
    Stage("third", third, ("first",), ("third.txt",)),
)


@pytest.fixture
def make(tmp_path):
    images = tmp_path / "images"
    images.mkdir()
    (images / "a.jpg").write_bytes(b"x")

    def run(**sections):
        return Run(tmp_path / "out", Inputs(images), All(**sections), pool="serial")

    return run


def worked(run):
    log = run.folder.parent / "work.log"
    text = log.read_text() if log.exists() else ""
    log.unlink(missing_ok=True)
    return text.split()


def whys(run, stages=STAGES):
    """Why each stage would run."""
    return [why for _, why, _ in status(stages, run)]


@pytest.mark.slow
def test_second_run_does_nothing_and_changes_reach_only_what_depends_on_them(make):
    assert run_stages(STAGES, make()) == ["first", "second", "third"]
    assert run_stages(STAGES, make()) == []
    assert run_stages(STAGES, make(first=One(value=5))) == ["first", "third"]
    assert make().path("third.txt").read_text() == "5"
    assert run_stages(STAGES, make(first=One(value=5), third=One(value=9))) == ["third"]
    make().path("third.txt").unlink()
    assert run_stages(STAGES, make(first=One(value=5), third=One(value=9))) == ["third"]
    (make().inputs.images / "b.jpg").write_bytes(b"y")
    assert run_stages(STAGES, make(first=One(value=5), third=One(value=9))) == ["first", "second", "third"]


@pytest.mark.slow
def test_status_names_the_input_and_the_setting_that_changed(make, tmp_path):
    listed, track = tmp_path / "pairs.txt", tmp_path / "track.csv"
    listed.write_text("a b")
    track.write_text("1")
    images = make().inputs.images

    def said(gnss=track, rig=None, run=False, **sections):
        asked = Inputs(images, rig=rig, gnss=gnss)
        made = Run(tmp_path / "out", asked, All(second=Two(file=listed), **sections), pool="serial")
        return run_stages(STAGES, made) if run else whys(made)

    said(run=True)
    assert said() == ["", "", ""]
    assert said(first=One(value=5)) == ["changed: first.value", "", "first is out of date"]
    assert said(gnss=None, rig="ring:3")[0] == "changed: --rig, --gnss"
    listed.write_text("a b c")
    assert said() == ["", "changed: second.file", ""] and said(run=True) == ["second"]
    track.write_text("12")
    assert said()[0] == f"changed: --gnss {track}" and said()[2] == "first is out of date"
    track.write_text("1")
    (images / "b.jpg").write_bytes(b"y")
    assert f"the image folder {images}" in said()[0]


def later(*paths):
    for path in paths:
        os.utime(path, ns=(path.stat().st_atime_ns, path.stat().st_mtime_ns + 5_000_000_000))


@pytest.mark.slow
def test_a_new_time_alone_is_no_change_of_an_input_and_other_bytes_of_the_same_size_are(make, tmp_path):
    listed = tmp_path / "pairs.txt"
    listed.write_text("a b")
    image, two = make().inputs.images / "a.jpg", Two(file=listed)
    run_stages(STAGES, make(second=two))
    later(image, listed)
    assert whys(make(second=two)) == ["", "", ""]
    assert run_stages(STAGES, make(second=two)) == []
    listed.write_text("a c")
    later(listed)
    assert run_stages(STAGES, make(second=two)) == ["second"]
    image.write_bytes(b"z")
    later(image)
    assert run_stages(STAGES, make(second=two)) == ["first", "second", "third"]
    later(image, listed)
    assert run_stages(STAGES, make(second=two)) == []


def linked(run):
    with replacing(run.path("first", "a.jpg")) as temporary:
        temporary.symlink_to(run.inputs.images / "a.jpg")
    write_atomic(run.path("first", "0.txt"), "1")
    return Outcome()


@pytest.mark.slow
@pytest.mark.parametrize("how", ["moved", "copied", "copied and changed"])
def test_a_survey_that_was_moved_or_copied_is_looked_at_again_and_not_computed_again(tmp_path, how):
    stages = (replace(STAGES[0], run=linked, item=""), *STAGES[1:])

    def run(place):
        two = Two(file=place / "pairs.txt")
        return Run(place / "out", Inputs(place / "images", gnss=place / "track.csv"), All(second=two), pool="serial")

    old, new = tmp_path / "old", tmp_path / "new"
    (old / "images").mkdir(parents=True)
    for name in ("images/a.jpg", "track.csv", "pairs.txt"):
        (old / name).write_text("x")
    run_stages(stages, run(old))
    if how == "moved":
        old.rename(new)
    else:
        shutil.copytree(old, new, symlinks=True, copy_function=shutil.copyfile)  # with new times
    if how == "copied and changed":
        (new / "images" / "a.jpg").write_text("z")
        assert run_stages(stages, run(new)) == ["first", "second", "third"]
    else:
        assert status(stages, run(new))[0][1] == "changed: the place of the images"
        assert run_stages(stages, run(new)) == ["first", "second"]  # they need no other stage
    assert os.readlink(new / "out" / "first" / "a.jpg") == str(new / "images" / "a.jpg")
    assert run_stages(stages, run(new)) == []


@pytest.mark.slow
def test_one_file_that_is_gone_is_a_change_and_a_folder_that_is_gone_counts_as_it_was(make, tmp_path):
    images = make().inputs.images
    (images / "b.jpg").write_bytes(b"y")
    run_stages(STAGES, make())
    images.rename(tmp_path / "elsewhere")
    assert whys(make()) == ["", "", ""]
    assert run_stages(STAGES, make(third=One(value=9))) == ["third"]
    alone = (*STAGES[:2], replace(STAGES[2], alone=True))
    assert without_inputs(alone, make(third=One(value=4)), None)
    assert not without_inputs(STAGES, make(third=One(value=4)), None)
    assert not without_inputs(STAGES, make(third=One(value=9), second=Two(file=tmp_path / "nowhere")), "third")
    (tmp_path / "elsewhere").rename(images)
    later(images / "a.jpg", images / "b.jpg")
    assert run_stages(STAGES, make(third=One(value=9))) == []
    assert not without_inputs(alone, make(third=One(value=4)), None)  # they are there: they are looked at
    (images / "b.jpg").unlink()
    assert run_stages(STAGES, make(third=One(value=9))) == ["first", "second", "third"]


@pytest.mark.slow
def test_inputs_whose_list_is_damaged_count_by_their_times_again(make):
    run_stages(STAGES, make())
    make().path("receipts", "inputs.json").write_text("{")
    assert run_stages(STAGES, make()) == []
    later(make().inputs.images / "a.jpg")
    assert run_stages(STAGES, make()) == ["first", "second", "third"]
    later(make().inputs.images / "a.jpg")
    assert run_stages(STAGES, make()) == []


@pytest.mark.slow
@pytest.mark.parametrize("value, redone", [(1, ["2"]), (7, ["0", "1", "2"])])
def test_interrupted_work_goes_on_where_it_stopped_and_that_of_other_settings_is_not_reused(make, value, redone):
    run = make()
    (run.folder.parent / "trip").touch()
    with pytest.raises(RuntimeError, match="power cut"):
        run_stages(STAGES, run)
    assert worked(run) == ["0", "1"] and whys(run)[0] == "was interrupted"
    (run.folder.parent / "trip").unlink()
    run_stages(STAGES, make(first=One(value=value)))
    assert worked(run) == redone and run.path("first", "0.txt").read_text() == str(value)


@pytest.mark.slow
def test_until_runs_only_what_the_target_needs(make):
    assert run_stages(STAGES, make(), until="third") == ["first", "third"]
    with refused("unknown stage 'nope'"):
        run_stages(STAGES, make(), until="nope")


@pytest.mark.slow
def test_receipt_says_what_happened(make):
    run = make()
    run_stages(STAGES, run)
    receipt = json.loads(run.path("receipts", "second.json").read_text())
    assert receipt["notes"] == ["a note"] and receipt["software"]["tiegraph"]
    assert 0 <= receipt["seconds"] < 60 and receipt["peak_mib"] > 5
    assert receipt["key"] == run.keys(STAGES)["second"]


@pytest.mark.slow
def test_constants_of_an_engine_run_again_the_stages_that_follow_it_and_stand_in_their_receipts(make):
    stages = (STAGES[0], Stage("second", second, (), ("second.txt",), tuned=("other",)), STAGES[2])
    run_stages(stages, make())
    changed = make(tuning=Tunings(other=Constants(most=9)))
    assert run_stages(stages, changed) == ["second"]
    receipt = json.loads(changed.path("receipts", "second.json").read_text())
    assert receipt["tuning"] == {"other": {"most": 9}}
    own = make(tuning=Tunings(first=Constants(least=1)))  # an engine of the stage's own name, without a word
    assert run_stages(stages, own) == ["first", "second", "third"]
    assert json.loads(own.path("receipts", "first.json").read_text())["tuning"] == {"first": {"least": 1}}
    assert json.loads(own.path("receipts", "third.json").read_text())["tuning"] == {}


def test_two_runs_in_one_folder_are_refused(make):
    run = make()
    with working_in(run.folder), pytest.raises(InputError, match="another tiegraph run"):
        run_stages(STAGES, run)


def test_full_disk_leaves_no_half_file(tmp_path, monkeypatch):
    target = tmp_path / "a.txt"
    target.write_text("old")

    def full(self, data):
        raise OSError(28, "No space left on device")

    monkeypatch.setattr(Path, "write_bytes", full)
    with refused(r"a\.txt.*No space left on device"):
        write_atomic(target, b"new")
    monkeypatch.undo()
    assert target.read_text() == "old" and [p.name for p in tmp_path.iterdir()] == ["a.txt"]


def square(x, power):
    if x == 13:
        raise InputError("13 is unlucky")
    return x**power


@pytest.mark.slow
@pytest.mark.parametrize("spec", ["serial", "local:2"])
def test_pools_give_the_same_results_in_order(spec):
    executor, workers = open_pool(spec)
    with executor:
        assert map_items(executor, workers, square, list(range(12)), (2,)) == [x * x for x in range(12)]
        with refused("unlucky"):
            map_items(executor, workers, square, list(range(20)), (2,))


PASSING = (Stage("first", first, (), ("first",), "file", passing=True), *STAGES[1:])


@pytest.mark.slow
def test_files_that_were_let_go_are_missed_by_nobody_until_a_stage_needs_them(make):
    run_stages(PASSING, make())
    before = make().receipts.read("first")["made"]
    assert let_go(PASSING, make()) == 3 and not list(make().path("first").glob("*"))
    assert make().path("third.txt").exists() and whys(make(), PASSING) == ["", "", ""]
    assert run_stages(PASSING, make()) == [] and let_go(PASSING, make()) == 0
    make().path("third.txt").unlink()
    assert run_stages(PASSING, make()) == ["first", "third"]
    assert make().receipts.read("first")["made"] == before and make().path("first", "2.txt").exists()
    assert let_go(PASSING, make()) == 3
    assert run_stages(PASSING, make(), until="first") == ["first"]  # asked for


@pytest.mark.slow
def test_nothing_is_let_go_that_a_stage_still_needs_or_that_is_the_users(make):
    run_stages(PASSING, make(), until="first")
    assert let_go(PASSING, make()) == 0
    run_stages(PASSING, make())
    make().path("third.txt").unlink()
    assert let_go(PASSING, make()) == 0 and make().path("first", "0.txt").exists()
    run_stages(PASSING, make())
    make().path("first", "mine.txt").write_text("notes")
    let_go(PASSING, make())
    assert [p.name for p in make().path("first").iterdir()] == ["mine.txt"]


def told(run):
    write_atomic(run.path("told.txt"), json.dumps(run.receipts.read("third").get("lost")))
    return Outcome()


@pytest.mark.slow
@pytest.mark.parametrize("error", [ReconstructionError, ChildDied, ProcessLost])
def test_a_stage_of_which_nothing_comes_ends_no_run(error, tmp_path):
    """What needs it is left out, what can do without it and the report are made. A process that ends is tried once
    more at once and at the next run; what the images did not give when something changed, or when asked for by name."""
    tries: list[str] = []

    def nothing(run):
        tries.append(run._pool_spec)
        if (tmp_path / "worse").exists():
            raise error("no pair verified\nlog: /home/of/somebody")
        return third(run)

    stages = (
        STAGES[0],
        Stage("third", nothing, ("first",), ("third.txt",)),
        Stage("second", lambda run: Outcome(), ("third",), ()),
        Stage("without", second, ("first", "third"), ("second.txt",), spares=("third",)),
        Stage("report", told, ("second",), ("told.txt",), alone=True),
    )
    more = {name: (One, One()) for name in ("without", "report")}
    settings = create_model("Settings", __base__=All, **more)
    died, images = issubclass(error, ChildDied), tmp_path / "images"

    def again(until=None):
        tries.clear()
        run = Run(tmp_path / "out", Inputs(images), settings(), pool="local:2")
        return run_stages(stages, run, until), list(tries)

    images.mkdir()
    assert again() == (["first", "third", "second", "without", "report"], ["local:2"])
    (tmp_path / "worse").touch()
    run = Run(tmp_path / "out", Inputs(images), settings(), pool="serial")
    run.path("third.txt").unlink()
    twice = ["local:2", "local:1"] if died else ["local:2"]
    assert again() == (["without", "report"], twice)
    for until, tried in ((None, died), ("third", True), ("report", died), (None, died)):
        with pytest.raises(error, match="no pair verified") if until == "third" else nullcontext():
            assert again(until)[0] == (["report"] if died else [])
        assert tries == (twice if tried else [])
    assert json.loads(run.path("told.txt").read_text()) == "no pair verified" and run.path("second.txt").exists()
    assert run.receipts.read("third")["contradictions"] == ["no pair verified"] and not run.path("third.txt").exists()
    why = {name: text for name, text, _ in status(stages, run)}
    assert why["third"] == "no pair verified" and why["second"] == "it needs the stage third, which has no result"
    (tmp_path / "worse").unlink()
    assert again() == ((["third", "second", "without", "report"], ["local:2"]) if died else ([], []))
    if not died:
        run.path("first", "1.txt").unlink()  # made anew it is the same, and nothing changed
        assert again() == (["first"], [])
        assert again("third") == (["third"], ["local:2"]) and again()[0] == ["second", "without", "report"]
    assert json.loads(run.path("told.txt").read_text()) is None


def test_a_process_that_ends_once_costs_a_second_try(make, capsys):
    ends = [ProcessLost("a worker process was ended from outside (signal SIGKILL)")]

    def once(run):
        if ends:
            raise ends.pop()
        return third(run)

    stages = (STAGES[0], Stage("third", once, ("first",), ("third.txt",)))
    run = make()
    run.reporter = Reporter()
    assert run_stages(stages, run) == ["first", "third"] and run.path("third.txt").exists()
    said = capsys.readouterr()
    assert "signal SIGKILL); tried once more, one process at a time" in said.out + said.err
    assert not run.receipts.read("third").get("contradictions")


def test_nothing_of_the_first_stage_is_an_error(make):
    stages = (Stage("first", lambda run: raises(ReconstructionError("no pose")), (), ("first",)), STAGES[2])
    with pytest.raises(ReconstructionError, match="no pose"):
        run_stages(stages, make())


def raises(error):
    raise error


WARNING = "TIFFReadDirectory: Warning, Unknown field with tag 50000 (0xc350) encountered."


def test_a_library_writes_to_the_log_and_we_to_the_terminal(tmp_path: Path, capfd: pytest.CaptureFixture) -> None:
    before = sys.stderr
    with working_in(tmp_path / "run"):
        os.write(2, f"{WARNING}\n".encode())
        sys.stderr.write("ours\n")
    os.write(2, b"later\n")
    said = capfd.readouterr().err
    assert "TIFF" not in said and said.count("ours") == 1 and "later" in said
    assert (tmp_path / "run" / LOG).read_text().count(WARNING) == 1
    with pytest.raises(KeyboardInterrupt), working_in(tmp_path / "run"):  # an error within gives it back
        raise KeyboardInterrupt
    os.write(2, b"back\n")
    assert sys.stderr is before and "back" in capfd.readouterr().err


@pytest.mark.slow
def test_images_with_odd_tags_do_not_fill_the_terminal(server: Server, tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    rng = np.random.default_rng(0)
    for k in range(3):
        tags = ImageFileDirectory_v2()
        tags[50000], tags.tagtype[50000] = "hello", 2
        pixels = rng.integers(0, 4000, (48, 64)).astype(np.uint16)
        Image.fromarray(pixels).save(tmp_path / "in" / f"IMG_{k:04d}.tif", tiffinfo=tags)
    asked = ["run", tmp_path / "in", "-o", tmp_path / "out", "--until", "scan", "--pool", "serial"]
    ended = server.run(asked, tmp_path / "said", 300)
    assert ended.good and "TIFF" not in ended.text and "3 images" in ended.text, ended
    assert (tmp_path / "out" / LOG).read_text().count("Unknown field with tag 50000") >= 3
