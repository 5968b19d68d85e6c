"""The rules of the house that a machine can check."""

import ast
import gc
import inspect
import subprocess
import sys
import textwrap
from collections.abc import Iterator
from functools import cache
from pathlib import Path

import pytest

ROOT = Path(__file__).parents[1]
FILES = sorted((ROOT / "src").rglob("*.py"))
MAX_FILE_LINES = 400
MAX_FUNCTION_LINES = 60
MAX_PARAMETERS = 7
MAX_FIELDS = 10
MAX_POSITIONAL = 3
MAX_RETURNED = 3
MAX_UNPACKED = 2  # a pair is a thing; three things are arguments

# Options of the command line are settings.
OPTIONS = ("tiegraph.cli.run", "tiegraph.cli.options", "tiegraph.cli.surveys")
# Tables, whose fields are their columns, and records of a file.
BAGS = {"Scene", "Pairs", "Stage", "Exif", "SensorSpec"}


@pytest.fixture(scope="module", autouse=True)
def no_garbage():
    """The trees of all files stay to the end: to look for garbage among them takes longer than to parse them."""
    gc.disable()
    yield
    for known_of_all in (tree_of, trees, records, known, imported):
        known_of_all.cache_clear()
    gc.enable()


def ids(path):
    return path.relative_to(ROOT).as_posix()


@cache
def tree_of(path: Path) -> ast.Module:
    return ast.parse(path.read_text())


def faults(path: Path) -> Iterator[str]:
    """What a file breaks of the rules of size and of docstrings."""
    lines, tree = len(path.read_text().splitlines()), tree_of(path)
    if lines > MAX_FILE_LINES:
        yield f"{ids(path)} has {lines} lines"
    if not ast.get_docstring(tree):
        yield f"{ids(path)}: a module says what it is for"
    for node in tree.body:
        public = not getattr(node, "name", "_").startswith("_")
        if public and isinstance(node, (ast.FunctionDef, ast.ClassDef)) and not ast.get_docstring(node):
            yield f"{ids(path)}:{node.lineno} {node.name} has no docstring"
    for node in ast.walk(tree):
        if isinstance(node, (ast.FunctionDef, ast.AsyncFunctionDef)):
            where = f"{ids(path)}:{node.lineno} {node.name}"
            if node.end_lineno - node.lineno >= MAX_FUNCTION_LINES:
                yield f"{where} is too long"
            arguments = [a for a in (*node.args.posonlyargs, *node.args.args) if a.arg not in ("self", "cls")]
            count = len(arguments) + len(node.args.kwonlyargs)
            if count > MAX_PARAMETERS:
                yield f"{where} has {count} parameters"


@pytest.mark.slow
def test_rooms_are_small_and_documented():
    """One test for all files: a thousand small ones took longer to be handed out than to be run."""
    assert [fault for path in FILES for fault in faults(path)] == []


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


@pytest.mark.slow
def test_every_setting_is_documented():
    from tiegraph.calibrate.settings import CalibrateSettings
    from tiegraph.lidar.settings import LidarSettings
    from tiegraph.lidar.tuning import Tuning as LidarTuning
    from tiegraph.odometry.tuning import Tuning as OdometryTuning
    from tiegraph.project.settings import STAGED, Settings, Tunings
    from tiegraph.settings import Section
    from tiegraph.stations.tuning import Tuning as StationsTuning
    from tiegraph.watch.tuning import Tuning as WatchTuning

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
    check("calibrate", CalibrateSettings())  # it has no run folder, so these stand beside the settings of the stages
    check("lidar", LidarSettings())
    check("tuning.lidar", LidarTuning())
    check("tuning.odometry", OdometryTuning())
    check("tuning.watch", WatchTuning())
    check("tuning.stations", StationsTuning())


def test_stages_settings_and_verbs_have_one_name():
    from tiegraph.cli.verbs import VERBS
    from tiegraph.pipeline import MESH, SHOTS, STAGES
    from tiegraph.project.settings import STAGED, Settings, Tunings
    from tiegraph.project.stages import engines

    stages = (*STAGES, SHOTS, MESH)
    names = [s.name for s in stages]
    assert names == list(STAGED)
    assert {engine for stage in stages for engine in engines(stage, Settings())} == set(Tunings.model_fields)
    assert set(names) <= set(VERBS)
    for k, stage in enumerate(stages):
        assert set(stage.needs) <= set(names[:k]), f"{stage.name} needs something later"


@pytest.mark.slow
def test_engines_do_not_know_the_house():
    done = subprocess.run(
        [Path(sys.executable).with_name("lint-imports")], cwd=ROOT, capture_output=True, text=True, check=False
    )
    assert done.returncode == 0, done.stdout


@pytest.mark.parametrize("module", ["concurrent.futures", "multiprocessing", "distributed"])
def test_executors_live_in_one_place(module):
    allowed = {
        "project/pool.py",
        "project/stages.py",
        "project/run.py",
        "project/daskpool.py",
        "project/daskworker.py",
        "project/stores.py",
        "child.py",
        "forking.py",
        "cli/doctor.py",
    }
    for path in FILES:
        text = path.read_text()
        if f"import {module}" in text or f"from {module}" in text:
            assert path.relative_to(ROOT / "src" / "tiegraph").as_posix() in allowed


@pytest.mark.slow
@pytest.mark.parametrize("command", [["ruff", "check", "."], ["ruff", "format", "--check", "."]], ids=" ".join)
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


# --- values have names ----------------------------------------------------------------------------------------------


def name_of(path: Path) -> str:
    return ".".join(path.relative_to(ROOT / "src").with_suffix("").parts).removesuffix(".__init__")


@cache
def trees() -> dict[str, ast.Module]:
    """Not at import: every process of the suite imports this file, one runs it."""
    return {name_of(p): tree_of(p) for p in FILES}


def is_record(node: ast.ClassDef) -> bool:
    """A dataclass or a named tuple."""
    decorators = [d.func if isinstance(d, ast.Call) else d for d in node.decorator_list]
    return any(getattr(n, "id", "") in ("dataclass", "NamedTuple") for n in (*decorators, *node.bases))


@cache
def records() -> dict[tuple[str, str], ast.ClassDef]:
    nodes = [(m, n) for m, tree in trees().items() for n in ast.walk(tree) if isinstance(n, ast.ClassDef)]
    return {(m, n.name): n for m, n in nodes if is_record(n)}


@cache
def known(module: str) -> dict[str, tuple[str, str]]:
    """Names of a module that are records: where each is defined. One that is handed on is looked up further."""
    out = {name: (m, name) for m, name in records() if m == module}
    for node in ast.walk(trees()[module]):
        if isinstance(node, ast.ImportFrom) and node.module in trees() and node.module != module:
            for alias in node.names:
                found = (node.module, alias.name)
                if found not in records() and alias.name in imported(node.module):
                    found = (imported(node.module)[alias.name], alias.name)
                if found in records():
                    out[alias.asname or alias.name] = found
    return out


@cache
def imported(module: str) -> dict[str, str]:
    nodes = [n for n in ast.walk(trees()[module]) if isinstance(n, ast.ImportFrom) and n.module]
    return {alias.asname or alias.name: str(n.module) for n in nodes for alias in n.names}


def fields(module: str, node: ast.ClassDef) -> list[str]:
    """Own and inherited."""
    bases = [known(module).get(getattr(b, "id", "")) for b in node.bases]
    out = [f for b in bases if b for f in fields(b[0], records()[b])]
    return out + [n.target.id for n in node.body if isinstance(n, ast.AnnAssign) and isinstance(n.target, ast.Name)]


def calls(node: ast.AST, inside: str = "") -> Iterator[tuple[ast.Call, str]]:
    """Calls, and the name of the class made: that of a ``cls`` is the class around it."""
    for child in ast.iter_child_nodes(node):
        if isinstance(child, ast.Call):
            called = getattr(child.func, "id", "")
            yield child, inside if called == "cls" else called
        yield from calls(child, child.name if isinstance(child, ast.ClassDef) else inside)


def parts(annotation: ast.AST | None) -> int:
    """The number of things in the largest tuple of fixed length that an annotation is, or is one of."""
    if isinstance(annotation, ast.BinOp):
        return max(parts(annotation.left), parts(annotation.right))
    if isinstance(annotation, ast.Subscript) and getattr(annotation.value, "id", "") == "tuple":
        inner = annotation.slice.elts if isinstance(annotation.slice, ast.Tuple) else [annotation.slice]
        return 0 if any(isinstance(e, ast.Constant) and e.value is ... for e in inner) else len(inner)
    return 0


@pytest.mark.slow
def test_no_dataclass_is_a_bag():
    large = {
        n: len(fields(m, c)) for (m, n), c in records().items() if m not in OPTIONS and len(fields(m, c)) > MAX_FIELDS
    }
    assert {n: count for n, count in large.items() if n not in BAGS} == {}
    assert set(large) >= BAGS, "an exception that is none goes"


@pytest.mark.slow
def test_dataclasses_are_built_by_name():
    found = []
    for module, tree in trees().items():
        records = known(module)
        made = [(c, name) for c, name in calls(tree) if name in records and len(c.args) > MAX_POSITIONAL]
        found += [f"{module}:{c.lineno} {name}" for c, name in made]
    assert found == []


@pytest.mark.slow
def test_no_tuple_stands_for_arguments_or_results():
    found = []
    for module, tree in trees().items():
        for f in (n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef)):
            if parts(f.returns) > MAX_RETURNED:
                found.append(f"{module}:{f.lineno} {f.name} returns {parts(f.returns)} things")
            bags = {a.arg for a in (*f.args.args, *f.args.kwonlyargs) if parts(a.annotation) > MAX_UNPACKED}
            for n in (n for n in ast.walk(f) if isinstance(n, ast.Assign) and isinstance(n.targets[0], ast.Tuple)):
                if getattr(n.value, "id", "") in bags:
                    found.append(f"{module}:{f.lineno} {f.name} unpacks {ast.unparse(n.value)}")
    assert found == []
