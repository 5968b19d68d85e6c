"""What is shipped beside the package: versions, container, workflows. As the tools read them."""

import importlib.util
import re
import subprocess
import sys
from pathlib import Path

import pytest
import yaml
from packaging.requirements import Requirement
from packaging.specifiers import SpecifierSet
from packaging.version import Version

from tiegraph.cli import begin
from tiegraph.errors import InputError

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

ROOT = Path(__file__).parents[1]
PROJECT = tomllib.loads((ROOT / "pyproject.toml").read_text())
_ALL = [Requirement(r) for r in PROJECT["project"]["dependencies"]]
NEEDED = [r for r in _ALL if not r.marker or r.marker.evaluate({"python_version": "3.12"})]


def test_every_dependency_has_a_tested_version_within_its_bounds():
    lines = (ROOT / "packaging" / "constraints.txt").read_text().splitlines()[1:]
    tested = {re.sub("[_.]", "-", n.lower()): Version(v) for n, v in (line.split("==") for line in lines)}
    for needed in NEEDED:
        assert needed.specifier.contains(tested[needed.name]), needed


def test_the_lowest_versions_are_those_of_the_project():
    spoken = subprocess.run([sys.executable, ROOT / "packaging" / "lowest.py"], capture_output=True, text=True)
    lowest = dict(line.split("==") for line in spoken.stdout.split())
    assert set(lowest) == {Requirement(r).name for r in PROJECT["project"]["dependencies"]}
    for needed in NEEDED:
        version = lowest[needed.name].removesuffix(".*")
        assert f">={version}" in str(needed.specifier) and needed.specifier.contains(version)


def test_the_conda_recipe_is_that_of_the_project():
    recipe = yaml.safe_load((ROOT / "packaging" / "conda" / "recipe.yaml").read_text())
    project, about = PROJECT["project"], recipe["about"]
    assert recipe["package"]["name"] == project["name"] and recipe["context"]["version"] == project["version"]
    assert (about["summary"], about["license"]) == (project["description"], project["license"])
    names = {"opencv-python-headless": "py-opencv", "matplotlib": "matplotlib-base"}
    asked = {names.get(r.name, r.name): (r.specifier, r.marker) for r in _ALL}
    asked |= {f"{extra}-python": ("", None) for r in _ALL for extra in r.extras}
    asked["python"] = (project["requires-python"], None)
    there = {}
    for line in recipe["requirements"]["run"]:
        text, only = (line["then"], line["if"]) if isinstance(line, dict) else (line, None)
        name, _, bounds = text.partition(" ")
        there[name] = SpecifierSet(bounds), only
    assert {n: s for n, (s, _) in there.items()} == {n: SpecifierSet(str(s)) for n, (s, _) in asked.items()}
    assert [n for n, (_, only) in there.items() if only] == [n for n, (_, marker) in asked.items() if marker]
    built = {(r := Requirement(line)).name: r.specifier for line in PROJECT["build-system"]["requires"]}
    host = dict(line.split(" ") for line in recipe["requirements"]["host"] if " " in line)
    assert {n: SpecifierSet(b) for n, b in host.items()} == built


def test_rattler_build_renders_the_conda_recipe():
    """For two versions of Python; without channels nothing is solved or built. The tool is installed by hand."""
    rattler = pytest.importorskip("rattler_build")
    pythons = {"3.10.* *_cpython": True, "3.13.* *_cp313": False}
    chosen = {"python": list(pythons), "cxx_compiler": ["gxx"], "c_stdlib": ["sysroot"]}
    recipe = rattler.Stage0Recipe.from_file(str(ROOT / "packaging" / "conda" / "recipe.yaml"))
    rendered = [v.recipe.to_dict()["requirements"]["run"] for v in recipe.render(rattler.VariantConfig(chosen))]
    assert ["tomli >=2" in run for run in rendered] == list(pythons.values())


@pytest.mark.parametrize("path", [".github/workflows/ci.yml", ".github/workflows/wheels.yml", ".gitlab-ci.yml"])
def test_workflows_can_be_read_and_call_what_is_there(path):
    text = (ROOT / path).read_text()
    assert yaml.safe_load(text)
    for named in re.findall(r"(?:sh |python |- |cp )(\.?[\w/]+\.(?:sh|py|txt)|\.ci/run)", text):
        assert (ROOT / named).exists() or named in ("lowest.txt", "newest.txt"), named


def test_continuous_integration_calls_the_first_command_of_the_readme():
    readme = (ROOT / "README.md").read_text()
    assert (first := "sh setup.sh && .venv/bin/tiegraph demo") in readme
    assert first in (ROOT / ".github" / "workflows" / "ci.yml").read_text()


def test_the_container_is_given_all_that_its_build_reads():
    let_in = [line[1:] for line in (ROOT / ".dockerignore").read_text().splitlines() if line.startswith("!")]
    assert all((ROOT / name).exists() for name in let_in)
    sources = [PROJECT["project"]["readme"], *PROJECT["project"]["license-files"], "pyproject.toml"]
    sources.append(PROJECT["tool"]["scikit-build"]["cmake"]["source-dir"])
    assert set(sources) <= set(let_in) and {"src", "packaging", "examples/canal"} <= set(let_in)


def test_without_its_package_the_demo_says_what_to_install(monkeypatch):
    assert (begin.example() / "rig.toml").exists()
    monkeypatch.setattr(begin, "__file__", "/nowhere/site-packages/tiegraph/cli/begin.py")
    monkeypatch.setattr(begin, "find_spec", lambda name: None)
    with pytest.raises(InputError, match="pip install tiegraph-canal"):
        begin.example()
    example = ROOT / "examples" / "canal"
    places = [str(example)]
    found = importlib.util.spec_from_file_location("tiegraph_canal", example / "__init__.py",
                                                   submodule_search_locations=places)  # fmt: skip
    monkeypatch.setattr(begin, "find_spec", lambda name: found)
    assert begin.example() == example
