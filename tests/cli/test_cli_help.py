"""The help pages: what is on the short ones, and that the long ones have every option."""

import re
from dataclasses import fields

import pytest

from tiegraph.cli.main import main
from tiegraph.cli.run import RunOptions
from tiegraph.cli.verbs import RUN_PAGE, VERBS, Verb
from tiegraph.project.settings import PRESETS, sections
from tiegraph.settings import Section

SCREEN = (24, 80)


@pytest.fixture
def said(capsys):
    """What a command line that must succeed prints."""

    def run(*arguments: str) -> str:
        assert main(list(arguments)) == 0
        return capsys.readouterr().out

    return run


def options(text: str) -> set[str]:
    """Every option that a text names."""
    return set(re.findall(r"--[a-z][a-z0-9.-]*[a-z0-9]", text))


def settings(*only: str) -> set[str]:
    """The options of the settings of some stages, or of all."""
    chosen = [(s, f, field.default) for s, named in sections() if not only or s in only for f, field in named.items()]
    tables = {(s, f"{f}.{n}") for s, f, table in chosen if isinstance(table, Section) for n in type(table).model_fields}
    names = {(s, f) for s, f, value in chosen if not isinstance(value, Section)} | tables
    return {f"--{section}.{name.replace('_', '-')}" for section, name in names}


def own() -> set[str]:
    return {f"--{f.name}" for f in fields(RunOptions)}


def test_help_of_run_is_one_screen(said):
    text = said("run", "--help")
    assert text == RUN_PAGE + "\n" == said("run", "-h") == said("run", "nowhere", "--help")
    assert len(text.splitlines()) < SCREEN[0] and max(map(len, text.splitlines())) <= SCREEN[1]
    assert "--help-all" in text and "IMAGES" in text


def test_help_of_run_names_every_input_and_option_and_no_other():
    examples = {"--scan.crs", "--masks.folder"}
    assert options(RUN_PAGE) == own() | examples | {"--help", "--help-all"}
    assert examples <= settings() and not own() & settings()
    for name in set(PRESETS) - {"default"}:
        assert name in RUN_PAGE


@pytest.mark.slow
def test_help_all_of_run_has_every_option(said):
    text = said("run", "--help-all")
    assert own() | settings() <= options(text)
    assert len(text.splitlines()) > 4 * SCREEN[0] and text == said("run", "--help-all", "--help")


def test_help_of_a_stage_has_its_own_settings_and_help_all_those_of_all(said):
    text = said("dense", "--help")
    assert settings("dense") <= options(text) and "tiegraph dense --help-all" in text
    assert not (settings() - settings("dense")) & options(text)
    assert {"--pool", "--json", "--quiet"} <= options(text)
    assert settings() <= options(said("dense", "--help-all"))


@pytest.mark.parametrize(
    ("verb", "option", "more", "given", "other"),
    [
        ("network", "--coverage", {"--coverage"}, (), "design"),
        ("masks", "--compare", {"--beside", "--classes", "--keep-labels"}, ("x",), "refine"),
    ],
)
def test_help_shows_the_other_form_of_a_verb(said, verb, option, more, given, other):
    for argument in ("--help", "--help-all"):
        assert option in options(said(verb, argument))
    assert more <= options(said(verb, option, *given, "--help"))
    assert option not in options(said(other, "--help"))


def test_help_of_evaluate_shows_both_forms(said):
    assert "tiegraph evaluate CLOUD REFERENCE" in said("evaluate", "--help")
    assert "--distances-m" in options(said("evaluate", "a.laz", "b.laz", "--help"))


@pytest.mark.parametrize("name", [name for name, verb in VERBS.items() if verb.of != Verb.of])
def test_verbs_of_one_page_take_help_all_too(name, said):
    first = said(name, "--help-all")
    assert first.startswith(f"usage: tiegraph {name} ")


def test_help_keeps_square_brackets(said):
    """Libraries that colour text take [words] for orders of theirs."""
    for arguments in (("masks", "--help"), ("run", "--help-all")):
        text = " ".join(said(*arguments).replace("│", " ").replace("|", " ").split())
        assert "'tiegraph[onnx]'" in text and "[width, height]" in text and "[classes]" in text


def test_wrong_options_name_the_page_that_lists_all(capsys, tmp_path):
    for verb, page in (("run", "--help-all"), ("dense", "--help-all"), ("compare", "--help")):
        assert main([verb, "--nonsense", "5"]) == 2
        assert f"(`tiegraph {verb} {page}` lists all options)" in capsys.readouterr().err
    assert main(["dense", "--scan.crs", "auto", "--help"]) == 0  # of another stage, but help is asked for
