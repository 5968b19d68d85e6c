"""Children of a run as functions: each costs half a second of imports, and whole surveys start real ones."""

from __future__ import annotations

import pickle
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import pytest

from tiegraph.features import matchblocks
from tiegraph.pipeline import georef
from tiegraph.sfm import mapper, mapping


def patch(monkeypatch: pytest.MonkeyPatch) -> None:
    """Let the stages match, sparse and georef call what they would run in children."""
    for module in (matchblocks, mapper, mapping, georef):
        monkeypatch.setattr(module, "run_in_child", here)
    monkeypatch.setattr(matchblocks, "run_in_children", _all_here)


def here(
    function: Callable[..., Any],
    *args: Any,
    log: Path,
    on_message: Callable[[Any], None] | None = None,
    task: str = "",
) -> Any:
    """``run_in_child`` in this process; all that goes there and back must go through a pipe, as it does there."""
    function, args = _sent((function, args))
    return _sent(function(*args, send=lambda message: on_message(_sent(message)) if on_message else None))


def _all_here(function: Callable[..., Any], calls: Sequence[tuple], **how: Any) -> list[Any]:
    return [here(function, *args, **how) for args in calls]


def _sent(value: Any) -> Any:
    return pickle.loads(pickle.dumps(value))
