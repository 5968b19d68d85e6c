"""Children of the mapping are functions here."""

import pytest


@pytest.fixture(autouse=True)
def _children_are_functions(children_are_functions: None) -> None:
    pass
