"""The rules of the house that a machine can check."""

import ast
import inspect
import subprocess
import sys
import textwrap
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FILES = sorted((ROOT / "src").rglob("*.py"))
MAX_FILE_LINES = 400
MAX_FUNCTION_LINES = 60
MAX_PARAMETERS = 7


def ids(path):
    return path.relative_to(ROOT).as_posix()


@pytest.mark.parametrize("path", FILES, ids=ids)
def test_rooms_are_small_and_documented(path):
    text = path.read_text()
    assert len(text.splitlines()) <= MAX_FILE_LINES
    tree = ast.parse(text)
    assert ast.get_docstring(tree), "a module says what it is for"
    for node in ast.walk(tree):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            where = f"{path.name}:{node.lineno} {node.name}"
            assert node.end_lineno - node.lineno < MAX_FUNCTION_LINES, f"{where} is too long"
            arguments = [a for a in (*node.args.posonlyargs, *node.args.args) if a.arg not in ("self", "cls")]
            count = len(arguments) + len(node.args.kwonlyargs)
            assert count <= MAX_PARAMETERS, f"{where} has {count} parameters"


@pytest.mark.parametrize("path", FILES, ids=ids)
def test_public_functions_have_docstrings(path):
    tree = ast.parse(path.read_text())
    for node in tree.body:
        public = not getattr(node, "name", "_").startswith("_")
        if public and isinstance(node, (ast.FunctionDef, ast.ClassDef)):
            assert ast.get_docstring(node), f"{path.name}:{node.lineno} {node.name} has no docstring"


def documented(section):
    """Names of the fields of a settings class and its bases that have a docstring below them."""
    out = set()
    for base in section.__mro__[:-1]:
        if base.__module__.startswith("tiegraph"):
            body = ast.parse(textwrap.dedent(inspect.getsource(base))).body[0].body
            for field, below in zip(body, body[1:]):
                text = isinstance(below, ast.Expr) and isinstance(below.value, ast.Constant)
                if isinstance(field, ast.AnnAssign) and text and isinstance(below.value.value, str):
                    out.add(field.target.id)
    return out


def test_every_setting_is_documented():
    from tiegraph.project.settings import STAGED, Settings, Tunings
    from tiegraph.settings import Section

    def check(where: str, section: Section) -> None:
        told = documented(type(section))
        for name in type(section).model_fields:
            value = getattr(section, name)
            if isinstance(value, Section):
                check(f"{where}.{name}", value)
            else:
                assert name in told, f"{where}.{name} has no docstring"

    for stage in STAGED:
        check(stage, getattr(Settings(), stage))
    check("tuning", Tunings())


def test_stages_settings_and_verbs_have_one_name():
    from tiegraph.cli.verbs import VERBS
    from tiegraph.pipeline import SHOTS, STAGES
    from tiegraph.project.settings import STAGED, Settings, Tunings
    from tiegraph.project.stages import engines

    stages = (*STAGES, SHOTS)
    names = [s.name for s in stages]
    assert names == list(STAGED)
    assert {engine for stage in stages for engine in engines(stage, Settings())} == set(Tunings.model_fields)
    assert set(names) <= set(VERBS)
    for k, stage in enumerate(stages):
        assert set(stage.needs) <= set(names[:k]), f"{stage.name} needs something later"


def test_engines_do_not_know_the_house():
    done = subprocess.run(
        [Path(sys.executable).with_name("lint-imports")], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("module", ["concurrent.futures", "multiprocessing", "distributed"])
def test_executors_live_in_one_place(module):
    allowed = {
        "project/pool.py",
        "project/ledger.py",
        "project/run.py",
        "project/daskpool.py",
        "project/daskworker.py",
        "child.py",
        "cli/doctor.py",
    }
    for path in FILES:
        text = path.read_text()
        if f"import {module}" in text or f"from {module}" in text:
            assert path.relative_to(ROOT / "src" / "tiegraph").as_posix() in allowed


@pytest.mark.parametrize(
    "command", [["ruff", "check", "."], ["ruff", "format", "--check", "."], ["mypy"]], ids=" ".join
)
def test_linters_are_content(command):
    tool = Path(sys.executable).with_name(command[0])
    done = subprocess.run([tool, *command[1:]], cwd=ROOT, capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-4000:]


def test_ci_runs_exactly_the_readme_command():
    readme = (ROOT / "README.md").read_text()
    *_, tests, documentation = (ROOT / ".ci" / "run").read_text().strip().splitlines()
    assert f"\n{tests}\n" in readme
    assert "pytest" in tests
    assert "mkdocs build --strict" in documentation
