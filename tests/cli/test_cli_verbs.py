"""The door: what `tiegraph --help` loads, the table of verbs, `python -m tiegraph`, and the names of the package."""

import signal
import subprocess
import sys

import pytest

import tiegraph
from tiegraph.cli.main import main
from tiegraph.cli.verbs import VERBS, wants_page
from tiegraph.pipeline import SHOTS, STAGES

# Libraries that take a tenth of a second or more to load, and what of ours brings them.
HEAVY = {"pycolmap", "cv2", "scipy", "numpy", "matplotlib", "pyproj", "laspy", "pydantic", "tyro", "rich", "PIL"}
HEAVY |= {"tiegraph.api", "tiegraph.pipeline", "tiegraph.project.settings"}


def python(*arguments: str) -> subprocess.CompletedProcess:
    """A fresh interpreter."""
    return subprocess.run([sys.executable, *arguments], capture_output=True, text=True, check=False, timeout=120)


def loaded(*arguments: str) -> set[str]:
    """The modules that are loaded when the command line has answered."""
    code = "import sys\nfrom tiegraph.cli.main import main\ncode = main(sys.argv[1:])\n"
    code += "print(*sorted(sys.modules), file=sys.stderr)\nsys.exit(code)"
    done = python("-c", code, *arguments)
    assert done.returncode in (0, 2), done.stderr
    return set(done.stderr.split())


@pytest.mark.parametrize("arguments", ["--help", "--version", "rum", "run --help"])
def test_what_needs_no_engine_loads_none(arguments):
    assert not loaded(*arguments.split()) & HEAVY


@pytest.mark.slow
def test_a_verb_that_computes_loads_engines():
    """The other side: the test above would see them."""
    assert {"pycolmap", "numpy", "tyro"} <= loaded("compare", "--help")


def test_help_names_every_verb(capsys):
    assert main(["--help"]) == 0
    said = capsys.readouterr().out
    for name, verb in VERBS.items():
        assert f"  {name:<15} {verb.about}\n" in said


def test_the_table_knows_the_stages():
    """The table repeats what stages make, for loading them takes seconds."""
    stages = {s.name: s for s in STAGES}
    assert [name for name in VERBS if name in stages] == list(stages)
    for name, stage in stages.items():
        files = VERBS[name].about.removeprefix("stage: makes ").split(";")[0].split(", ")
        assert files == list(stage.makes), name
    assert SHOTS.name in VERBS


@pytest.mark.parametrize("name", VERBS)
def test_every_verb_can_be_loaded(name):
    assert callable(VERBS[name].load())
    assert VERBS[name].stage in ("", name)


@pytest.mark.slow
@pytest.mark.skipif(not hasattr(signal, "SIGTERM"), reason="no such signal")
@pytest.mark.parametrize("caught", ["ZeroDivisionError", "BaseException"])
def test_a_verb_is_stopped_in_one_line_after_pycolmap_is_loaded(caught):
    """pycolmap has handlers of its own that print stack traces: the signals are taken back after a verb is loaded. A
    library (pydantic) may make an error of its own of the KeyboardInterrupt."""
    code = f"""
import os, signal, sys, time
from tiegraph.cli import main, verbs
load = verbs.Verb.load
def loaded(verb):
    load(verb)
    return stopped
def stopped(arguments):
    try:
        os.kill(os.getpid(), signal.SIGTERM)
        time.sleep(20)
    except {caught} as error:
        raise ValueError("KeyboardInterrupt: ")
verbs.Verb.load = loaded
sys.argv = ["tiegraph", "doctor"]
sys.exit(main.main())
"""
    done = python("-c", code)
    said = "tiegraph: stopped; finished work is kept: run the same command again to go on\n"
    assert (done.returncode, done.stdout, done.stderr) == (1, "", said)


def test_which_arguments_ask_for_the_page():
    assert wants_page(["--help"]) and wants_page(["images", "-h"])
    assert not wants_page([]) and not wants_page(["images"]) and not wants_page(["--help-all"])
    assert not wants_page(["--help", "--help-all"])


def test_the_package_can_be_run():
    done = python("-m", "tiegraph", "--version")
    assert (done.returncode, done.stdout, done.stderr) == (0, f"tiegraph {tiegraph.__version__}\n", "")
    wrong = python("-m", "tiegraph", "rum")
    assert wrong.returncode == 2 and "Perhaps you meant 'run'" in wrong.stderr


def test_the_package_shows_its_names():
    """Before any was used: in a fresh interpreter, without loading what is behind them."""
    done = python("-c", "import sys, tiegraph; print(*dir(tiegraph)); print('tiegraph.api' in sys.modules)")
    names, used = done.stdout.splitlines()
    assert {"open", "Project", "Scene", "Pairs", "Cloud", "__version__"} <= set(names.split()) and used == "False"
    assert set(tiegraph.__all__) <= set(dir(tiegraph))
    for name in tiegraph.__all__:
        assert getattr(tiegraph, name) is not None
    assert tiegraph.open is tiegraph.api.open_project
    with pytest.raises(AttributeError, match="no attribute 'nothing'"):
        _ = tiegraph.nothing
