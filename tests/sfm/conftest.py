"""Children of the mapping are functions here: each costs a second of imports, and whole surveys start real ones."""

from __future__ import annotations

import pickle
from collections.abc import Callable
from pathlib import Path
from typing import Any

import pytest

from tiegraph.sfm import blockwise, mapper, mapping


def _here(
    function: Callable[..., Any],
    *args: Any,
    log: Path,
    on_message: Callable[[Any], None] | None = None,
    task: str = "",
) -> Any:
    """``run_in_child`` in this process; all that goes there and back must go through a pipe, as it does there."""
    function, args = _sent((function, args))
    return _sent(function(*args, send=lambda message: on_message(_sent(message)) if on_message else None))


def _sent(value: Any) -> Any:
    return pickle.loads(pickle.dumps(value))


@pytest.fixture(autouse=True)
def children_are_functions(monkeypatch: pytest.MonkeyPatch) -> None:
    for module in (blockwise, mapper, mapping):
        monkeypatch.setattr(module, "run_in_child", _here)
