"""A run folder is ours alone: nothing of the user's is removed, overwritten or read as ours, whatever -o is."""

import json
import os
import shutil
from dataclasses import replace
from pathlib import Path

import pytest

from said import refused
from tiegraph.cli.main import main
from tiegraph.errors import EngineMissing, InputError, SettingsError, UnreadableArtefact
from tiegraph.pipeline import STAGES as REAL
from tiegraph.project.artefacts import Artefacts
from tiegraph.project.folder import check_folder, check_inputs, working_in, write_settings
from tiegraph.project.inputs import Inputs
from tiegraph.project.run import Run, run_stages, status
from tiegraph.project.settings import Settings as RealSettings
from tiegraph.project.stages import Outcome, Stage, write_atomic
from tiegraph.scene.atomic import JOURNAL, MARK, claim, replacing
from tiegraph.settings import Section


def contents(folder: Path) -> dict[str, bytes]:
    return {p.relative_to(folder).as_posix(): p.read_bytes() for p in sorted(folder.rglob("*")) if p.is_file()}


# --- what is given as -o ----------------------------------------------------------------------------------------------


@pytest.fixture
def proj(tmp_path):
    for k in range(3):
        path = tmp_path / "proj" / "images" / "day1" / f"{k}.jpg"
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(b"a photograph %d" % k)
    return tmp_path / "proj"


@pytest.mark.slow
@pytest.mark.parametrize(
    ("images", "out"),
    [
        ("images", "."), (".", "."), ("images/day1", "."), ("images", "images"), ("images", "images/out"),
        (".", "images/day1"), ("images/day1", "images"),
    ],
)  # fmt: skip
def test_photographs_survive_whatever_is_given_as_out(proj, images, out, capsys):
    before = contents(proj)
    assert main(["run", str(proj / images), "-o", str(proj / out), "--quiet"]) == 2
    assert contents(proj) == before
    assert "-o" in (said := capsys.readouterr().err) and str(proj) in said and "Traceback" not in said


@pytest.mark.parametrize("made", sorted({m.split("/")[0] for s in REAL for m in (*s.makes, *s.scratch)}))
def test_the_users_own_files_that_are_named_like_artefacts_survive(proj, tmp_path, made):
    out = tmp_path / "out"
    own = out / made if "." in made else out / made / "mine.txt"
    own.parent.mkdir(parents=True)
    own.write_text("mine")
    with refused(f"did not make .*{made}"):
        run_stages(REAL, Run(out, Inputs(proj / "images"), RealSettings(), pool="serial"))
    assert contents(out) == {own.relative_to(out).as_posix(): b"mine"}


def test_a_new_an_empty_and_a_made_folder_will_do(tmp_path):
    check_folder(tmp_path / "new")
    (tmp_path / "empty").mkdir()
    (tmp_path / "empty" / "tiegraph.toml").write_text("")
    check_folder(tmp_path / "empty")
    with working_in(tmp_path / "made"):
        (tmp_path / "made" / "notes.txt").write_text("mine")
    check_folder(tmp_path / "made")
    (tmp_path / "file").write_text("")
    with refused("is not a folder"):
        check_folder(tmp_path / "file")


@pytest.mark.slow
@pytest.mark.parametrize(("made", "which"), [(1, "an earlier"), (9, "a later"), ("odd", "an earlier"), (None, None)])
def test_the_run_folder_of_another_version_is_refused_and_not_touched(proj, tmp_path, made, which, capsys):
    """Names of files, and of what stands in them, change with the format; a mark without one was damaged."""
    out = tmp_path / "out"
    with working_in(out):
        (out / "tiegraph.toml").write_text(f"[run]\nimages = '{proj / 'images'}'\n")
    mark = json.loads((out / MARK).read_text())
    (out / MARK).write_text(json.dumps({k: v for k, v in ({**mark, "format": made}).items() if v is not None}))
    before = contents(out)
    run, given = ["run", str(proj / "images"), "-o", str(out), "--quiet"], str(out)
    if which is None:
        check_folder(out)
        return
    for command in (run, ["status", given], ["network", given], ["compare", given, given], ["export", given, "x"]):
        assert main(command) == 2
        said = capsys.readouterr().err
        assert f"{out} is the run folder of {which} version" in said and "give another folder" in said
    assert contents(out) == before
    with refused(f"{which} version"):
        check_folder(out)


@pytest.mark.parametrize(
    ("given", "says"),
    [
        ("out/masks", "place of the results"), ("out/masks/own", "place of the results"),
        ("out/pairs.txt", "place of the results"), ("link", "place of the results"), (".", "lies in"),
        ("out/own.csv", ""), ("out/masks_of_mine", ""), ("elsewhere", ""),
    ],
)  # fmt: skip
def test_inputs_never_lie_where_outputs_go(tmp_path, given, says):
    out = tmp_path / "out"
    (out / "masks" / "own").mkdir(parents=True)
    (tmp_path / "link").symlink_to(out / "masks")
    made = ["masks", "pairs.txt"]
    if not says:
        check_inputs(out, {"--masks.folder": tmp_path / given}, made)
        return
    with pytest.raises(InputError, match=says) as error:
        check_inputs(out, {"--masks.folder": tmp_path / given}, made)
    assert "--masks.folder" in str(error.value) and str(out) in str(error.value)


@pytest.mark.parametrize("name", [".lock", "log.txt"])
def test_our_own_files_never_follow_links_and_are_no_folders(tmp_path, name):
    (tmp_path / "precious").write_text("mine")
    (tmp_path / "out").mkdir()
    (tmp_path / "out" / name).symlink_to(tmp_path / "precious")
    with refused(f"{name} is a link"), working_in(tmp_path / "out"):
        pass
    assert (tmp_path / "precious").read_text() == "mine"
    (tmp_path / "other" / "log.txt").mkdir(parents=True)
    with refused("log.txt is a folder"), working_in(tmp_path / "other"):
        pass


def test_settings_edited_by_hand_are_kept_and_refused_ones_taken_back(tmp_path):
    path = tmp_path / "tiegraph.toml"
    path.write_text("# my remarks\n")
    write_settings(tmp_path, "a = 1\n")
    assert path.read_text() == "a = 1\n"
    assert (tmp_path / "tiegraph.before-1.toml").read_text() == "# my remarks\n"
    take_back = write_settings(tmp_path, "a = 2\n")
    assert not (tmp_path / "tiegraph.before-2.toml").exists(), "what we wrote ourselves needs no copy"
    take_back()
    assert path.read_text() == "a = 1\n"


@pytest.mark.slow
@pytest.mark.parametrize("error", [InputError, SettingsError, EngineMissing])
def test_what_is_refused_is_not_stored(proj, make, tmp_path, error):
    """An option on the command line, and what the first stage refuses."""
    arguments = ["run", str(proj / "images"), "-o", str(tmp_path / "run"), "--quiet", "--pool", "serial"]
    assert main([*arguments, "--scan.crs", "foo"]) == 2
    assert not (tmp_path / "run" / "tiegraph.toml").exists()
    kept, stages = [], (Stage("last", lambda run: _raise(error("not to be had")), (), ("last.txt",)),)
    with pytest.raises(error):
        run_stages(stages, make(), remember=lambda: lambda: kept.append("taken back"))
    assert kept == ["taken back"]


def _raise(error):
    raise error


# --- what a stage made ------------------------------------------------------------------------------------------------


class Numbers(Section):
    value: int = 1


class Settings(Section):
    many: Numbers = Numbers()
    whole: Numbers = Numbers()
    last: Numbers = Numbers()


WORKED: list[str] = []


def many(run):
    if run.settings.many.value < 0:
        raise InputError("no such value")
    for k in range(4):
        if not run.path("many", f"{k}.txt").exists():
            WORKED.append(str(k))
            write_atomic(run.path("many", f"{k}.txt"), f"{run.settings.many.value} {k}")
        if k == 2 and run.settings.last.value == 13:
            raise KeyboardInterrupt
    return Outcome()


def whole(run):
    WORKED.append("whole")
    claim(run.path("many", "whole"))  # as a library would write: a folder below that of another stage
    run.path("many", "whole").mkdir(exist_ok=True)
    for name in ("a", "b"):
        run.path("many", "whole", name).write_text(f"{run.settings.whole.value}")
    return Outcome()


def last(run):
    WORKED.append("last")
    if (text := run.path("many", "0.txt").read_text()) not in ("1 0", "2 0"):
        raise UnreadableArtefact(run.path("many", "0.txt"), f"{text!r} is no number")
    write_atomic(run.path("last.txt"), text)
    return Outcome()


STAGES = (
    Stage("many", many, (), ("many",), "file"),
    Stage("whole", whole, ("many",), ("many/whole",)),
    Stage("last", last, ("whole",), ("last.txt",)),
)
ALL = ["many", "whole", "last"]


@pytest.fixture
def make(tmp_path):
    (tmp_path / "images").mkdir()
    (tmp_path / "images" / "a.jpg").write_bytes(b"x")
    WORKED.clear()

    def run(**values):
        sections = {name: Numbers(value=value) for name, value in values.items()}
        return Run(tmp_path / "out", Inputs(tmp_path / "images"), Settings(**sections), pool="serial")

    return run


def ran(run) -> list[str]:
    """The stages that ran, and in WORKED what they did."""
    WORKED.clear()
    return run_stages(STAGES, run)


def aside(run) -> dict[str, bytes]:
    found = contents(run.path("set_aside")) if run.path("set_aside").exists() else {}
    return {name.split("/", 1)[1]: data for name, data in found.items()}


@pytest.mark.slow
def test_a_lost_item_is_made_again_and_only_that(make):
    assert ran(make()) == ALL
    make().path("many", "2.txt").unlink()
    assert status(STAGES, make())[0][1] == "many/2.txt is missing"
    assert ran(make()) == ["many"] and WORKED == ["2"]
    make().path("many", "whole", "a").unlink()
    assert ran(make()) == ["whole"]
    assert ran(make()) == []


@pytest.mark.slow
def test_an_item_of_two_files_is_made_again_whole(make):
    def pairs(run):
        for k in range(3):
            if not run.path("many", f"{k}.txt").exists():
                WORKED.append(str(k))
                for folder in ("many", "beside"):
                    write_atomic(run.path(folder, f"{k}.txt"), folder)
        return Outcome()

    stages = (Stage("many", pairs, (), ("many", "beside"), "file"),)
    run_stages(stages, make())
    for damage in (Path.unlink, lambda path: path.write_text("drawn by hand")):
        WORKED.clear()
        damage(make().path("beside", "1.txt"))
        assert run_stages(stages, make()) == ["many"] and WORKED == ["1"]
        assert make().path("beside", "1.txt").read_text() == "beside"


@pytest.mark.slow
def test_what_was_changed_is_kept_aside_and_made_again(make):
    ran(make())
    make().path("many", "1.txt").write_text("drawn by hand")
    assert ran(make()) == ["many"] and WORKED == ["1"]
    assert make().path("many", "1.txt").read_text() == "1 1"
    assert aside(make()) == {"many/1.txt": b"drawn by hand"}


@pytest.mark.slow
def test_what_depends_on_a_file_that_came_out_otherwise_is_made_again(make, monkeypatch):
    ran(make())
    make().path("many", "whole", "a").unlink()
    monkeypatch.setattr(Path, "write_text", lambda self, text: self.write_bytes(b"otherwise"))
    assert ran(make()) == ["whole", "last"]


def base(run):
    claim(run.path("base.db"))
    run.path("base.db").write_text(f"{run.settings.many.value}")
    return Outcome()


def grown(run):
    """Writes into the file of another stage, as match does into the database of features."""
    with open(run.path("base.db"), "a") as file:
        file.write(" grown")
    return Outcome()


SHARED = (
    Stage("many", base, (), ("base.db",)),
    Stage("whole", grown, ("many",), (), changes=("base.db",)),
)


@pytest.mark.slow
def test_a_file_that_a_stage_changed_is_not_missed_when_its_maker_made_it_anew(make):
    """Twice with other settings, before the stage that changes it has run again: its list is of a file long gone."""
    assert run_stages(SHARED, make()) == ["many", "whole"]
    assert run_stages(SHARED, make()) == []
    for value in (2, 3):
        assert run_stages(SHARED, make(many=value), until="many") == ["many"]
        assert not make().path("set_aside").exists() and "was changed" not in make().log.read_text()
    make().path("base.db").write_text("drawn by hand")
    assert run_stages(SHARED, make(many=3), until="many") == ["many"] and aside(make()) == {"base.db": b"drawn by hand"}
    assert run_stages(SHARED, make(many=3)) == ["whole"] and make().path("base.db").read_text() == "3 grown"
    make().path("base.db").write_text("drawn again")
    assert run_stages(SHARED, make(many=3)) == ["many", "whole"]
    assert len(list(make().path("set_aside").iterdir())) == 2


@pytest.mark.slow
@pytest.mark.parametrize("begins_again", [False, True], ids=["at once", "by the next run"])
def test_what_a_stage_broke_that_was_stopped_is_nobodys_and_what_a_person_broke_is_kept(make, begins_again):
    """As a full disk leaves a database: it is made anew, and set aside is only what a person may have changed."""
    full = [True]

    def grown_or_broken(run):
        path = run.path("base.db")
        if full:
            full.clear()
            path.write_text("half a page")
            raise InputError("no room") if begins_again else UnreadableArtefact(path, "malformed")
        if path.read_text() != "1":
            raise UnreadableArtefact(path, "malformed")
        return grown(run)

    stages = (SHARED[0], replace(SHARED[1], run=grown_or_broken))
    if begins_again:
        with refused("no room"):
            run_stages(stages, make())
    run_stages(stages, make())
    assert make().path("base.db").read_text() == "1 grown" and not aside(make())
    make().path("base.db").write_text("by a person")
    run_stages(stages, make())
    assert make().path("base.db").read_text() == "1 grown" and aside(make()) == {"base.db": b"by a person"}


@pytest.mark.slow
def test_a_touched_or_copied_folder_is_still_up_to_date(make, tmp_path):
    ran(make())
    for path in make().path("many").glob("*.txt"):
        os.utime(path)
    assert ran(make()) == []
    shutil.copytree(tmp_path / "out", tmp_path / "other")
    shutil.rmtree(tmp_path / "out")
    (tmp_path / "other").rename(tmp_path / "out")
    assert ran(make()) == []


@pytest.mark.slow
def test_files_of_others_are_refused_by_name_and_left_alone(make):
    ran(make())
    own = make().path("many", "mine.txt")
    own.write_text("mine")
    assert ran(make()) == [], "nothing has to be written there"
    with refused(r"many/mine.txt lie where stage many"):
        ran(make(many=2))
    assert own.read_text() == "mine" and make().path("many", "1.txt").read_text() == "1 1"
    own.rename(make().path("mine.txt"))
    assert ran(make(many=2)) == ALL
    assert make().path("mine.txt").read_text() == "mine" and make().path("many", "1.txt").read_text() == "2 1"


@pytest.mark.slow
def test_files_put_in_after_an_interruption_are_not_ours(make):
    with pytest.raises(KeyboardInterrupt):
        ran(make(last=13))
    own = make().path("many", "3.txt")  # would be taken for a finished item
    own.write_text("mine")
    with refused("many/3.txt"):
        ran(make())
    assert own.read_text() == "mine"
    own.unlink()
    assert ran(make()) == ALL and WORKED[0] == "3"


@pytest.mark.slow
def test_a_kill_leaves_a_journal_by_which_ours_is_known(make):
    run = make()
    ran(run)
    receipt = json.loads(run.receipts.path("many").read_text())
    run.receipts.write("many", {"stage": "many", "began": receipt["key"], "from": {}})
    run.receipts.write_files("many", {})
    run.path(JOURNAL).write_text('"many/0.txt"\n"many/1.txt"\n"many/2.txt"\n"many/3.t')  # and a power cut
    run.path("many", ".0badcafe.77.part.txt").write_text("half")
    with refused("many/3.txt"):
        ran(make())
    run.path("many", "3.txt").unlink()
    assert ran(make()) == ["many"] and WORKED == ["3"]
    assert not run.path("many", ".0badcafe.77.part.txt").exists()


@pytest.mark.slow
@pytest.mark.parametrize("value", [1, 2])
def test_what_a_worker_finishes_after_the_run_was_stopped_is_ours(make, value):
    with pytest.raises(KeyboardInterrupt):
        ran(make(last=13))
    claim(make().path("many", "3.txt"))  # noted in time, and then
    artefacts = Artefacts(make().folder, STAGES)
    artefacts.recover()
    make().path("many", "3.txt").write_text("1 3")
    assert ran(make(many=value)) == ALL
    assert make().path("many", "3.txt").read_text() == f"{value} 3"
    assert not make().path(JOURNAL).exists()


@pytest.mark.slow
def test_stages_within_stages_keep_to_their_own(make):
    ran(make())
    assert ran(make(whole=5)) == ["whole", "last"]
    assert make().path("many", "3.txt").read_text() == "1 3"
    assert ran(make(many=2, whole=5)) == ALL
    assert make().path("many", "whole", "a").read_text() == "5"


@pytest.mark.slow
@pytest.mark.parametrize("damage", ["{", "[]"])
@pytest.mark.parametrize("which", ["receipts/many.json", "receipts/files/many.json", "receipts/folder.json"])
def test_a_damaged_receipt_costs_its_stage_and_nothing_else(make, which, damage):
    ran(make())
    before = {p.name: p.read_bytes() for p in make().path("many").glob("*.txt")}
    make().path(which).write_text(damage)
    assert ran(make()) == ([] if "folder" in which else ["many"])
    assert {p.name: p.read_bytes() for p in make().path("many").glob("*.txt")} == before


@pytest.mark.slow
def test_an_artefact_that_cannot_be_read_is_made_again_although_it_looks_untouched(make, capsys):
    ran(make())
    path = make().path("many", "0.txt")
    times = path.stat()
    path.write_text("?!?")
    os.utime(path, ns=(times.st_atime_ns, times.st_mtime_ns))
    assert ran(make(last=2)) == ["last", "many", "last"]
    assert WORKED == ["last", "0", "last"] and aside(make()) == {"many/0.txt": b"?!?"}


@pytest.mark.slow
def test_a_stage_that_always_fails_to_read_ends_the_run(make):
    def unreadable(run):
        raise UnreadableArtefact(run.path("many", "0.txt"), "always")

    stages = (*STAGES[:2], replace(STAGES[2], run=unreadable))
    with pytest.raises(UnreadableArtefact, match="0.txt"):
        run_stages(stages, make())


@pytest.mark.slow
def test_refused_settings_leave_what_was_computed(make):
    ran(make())
    with refused("no such value"):
        ran(make(many=-1))
    assert ran(make()) == ["many"], "only the stage that was begun with them"


# --- the journal ------------------------------------------------------------------------------------------------------


def test_files_are_claimed_before_they_appear_and_only_in_run_folders(tmp_path):
    with replacing(tmp_path / "plain" / "a.txt") as temporary:
        temporary.write_text("1")
    assert not (tmp_path / "plain" / "receipts").exists()
    write_atomic(tmp_path / "out" / MARK, "{}")
    with replacing(tmp_path / "out" / "b" / "ü.txt") as temporary:
        assert json.loads((tmp_path / "out" / JOURNAL).read_text().splitlines()[-1]) == "b/ü.txt"
        temporary.write_text("1")


def test_names_as_long_as_the_file_system_takes_can_be_written(tmp_path):
    write_atomic(tmp_path / ("x" * 251 + ".txt"), "1")
    assert len(list(tmp_path.iterdir())) == 1


@pytest.mark.slow
@pytest.mark.parametrize(
    "option", ["--gnss", "--times", "--trajectory", "--rig", "--gcp", "--evaluate.reference-cloud"]
)
def test_odd_paths_of_inputs_are_refused_in_words(proj, tmp_path, option, capsys):
    (tmp_path / "ring").symlink_to(tmp_path / "ring")
    for path in (tmp_path / "ring", "/", tmp_path / ("x" * 300)):
        assert main(["run", str(proj / "images"), "-o", str(tmp_path / "out"), "--quiet", option, str(path)]) in (1, 2)
        said = capsys.readouterr().err
        assert "unexpected" not in said and said.count("\n") == 1
