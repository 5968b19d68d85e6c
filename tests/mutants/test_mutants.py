"""The mistakes of ``tests.mutants`` can still be made, and the tests that notice them exist; they run apart."""

from pathlib import Path

import pytest

from .table import MUTANTS, Mutant

ROOT = Path(__file__).resolve().parents[2]


@pytest.mark.parametrize("mutant", MUTANTS, ids=lambda m: f"{m.paper} {m.what}")
def test_each_mistake_can_be_made(mutant: Mutant) -> None:
    text = (ROOT / mutant.file).read_text()
    assert text.count(mutant.original) == 1 and mutant.original != mutant.replaced
    for test in mutant.test.split():
        file, _, name = test.partition("::")
        assert f"def {name.partition('[')[0]}(" in (ROOT / file).read_text() if name else (ROOT / file).exists()


def test_every_paper_has_some() -> None:
    assert {m.paper for m in MUTANTS} == {"000", "001", "002", "003", "004"}
