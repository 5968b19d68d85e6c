"""What of tiegraph's own acted in a run, by its receipts: nothing of it may in a paper's recipe.

A receipt says what a stage was asked for (``settings``), what it did in words (``notes``), in numbers (``counts``) and
in tables; a setting that is off and a step that acted all the same would both show.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from typing import Any

Receipts = Mapping[str, Mapping[str, Any]]

LEVELLED = "models levelled by their cameras"


def _asked(stage: str, name: str, off: str) -> Callable[[Receipts], bool]:
    return lambda receipts: receipts[stage]["settings"][name] != off


def _said(stage: str, *words: str) -> Callable[[Receipts], bool]:
    return lambda receipts: any(word in note for note in receipts[stage].get("notes", ()) for word in words)


def _tables(stage: str, *names: str) -> Callable[[Receipts], bool]:
    return lambda receipts: bool(set(names) & set(receipts[stage].get("tables", {})))


def _joined(receipts: Receipts) -> bool:
    table = receipts["georef"].get("tables", {}).get("models in one world", {"rows": []})
    return any(row[2] == "matches" for row in table["rows"])


def _mapped(receipts: Receipts) -> bool:
    rows = receipts["sparse"]["tables"]["runs"]["rows"]
    return len(rows) != 1 or rows[0][:3] != ["incremental", "absent", "none"]


STEPS: dict[str, Callable[[Receipts], bool]] = {
    "rig check": _said("candidates", "rig "),
    "coarse model": _asked("coarse", "method", "off"),
    "choice of pairs": _asked("design", "method", "all"),
    "rig, positions or a second try of the mapper": _mapped,
    "final adjustment": _said("sparse", "adjustment", "principal points"),
    "checks of frames, rig and lenses": _tables(
        "sparse", "placement", "matches that the model explains: frames with the fewest", "rig diagnostics",
        "matches between cameras", "given values and images compared",
    ),
    "sigmas of the model": lambda receipts: "position_sigma_median" in receipts["sparse"]["counts"],
    "models joined by matches": _joined,
    LEVELLED: _said("georef", "levelled", "upward direction"),
    "lever arm": _asked("georef", "antenna", "ignored"),
    "adjustment with positions": _asked("georef", "adjust", "no"),
}  # fmt: skip


def ours(receipts: Receipts) -> list[str]:
    """The steps of ``STEPS`` that acted in a run that came to its world."""
    return [name for name, acted in STEPS.items() if acted(receipts)]
