"""What a run says of itself: its sigmas, what it holds as given, and its sentences, from receipts and world.json."""

from __future__ import annotations

import json
import re
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

CONTRADICTS = re.compile(
    r"contradict|disagree|do(es)? not (agree|fit|belong)|not synchronised|not rigid|do not trust|want a scale|"
    r"stands? in doubt|doubtful|only \d+ of \d+ positions agree|mistaken|exchanged|swapped|mirrored|upside down|"
    r"principal point (lies|is)|turned round|other way round|wrong order|out of order|not noise|bends towards",
    re.IGNORECASE,
)
"""Words of a contradiction in a note. What a stage lists under ``contradictions`` is one whatever its words."""
HEDGES = re.compile(
    r"cannot be (told|seen|tested|checked|separated|determined|detected)|could not be (told|computed|checked)|"
    r"do(es)? not (determine|show)|is unknown|comes from the|not computed|known (to|only)|rests on|"
    r"not georeferenced|hardly|good to|nothing (else )?(\w+ )?(tells|tests|checks|fixes|confirms)",
    re.IGNORECASE,
)
"""Words that say how badly something is known; such a sentence must name the quantity itself."""
_NOT_MEANT = re.compile(
    r"neither prove nor contradict|coarse model|pairs? (that )?contradict|no loops decide|no rig given"
)
_STAGES = ("scan", "network", "match", "sparse", "georef", "evaluate")

NAMES = {
    "camera": r"position|camera|frame|image|sigma|model|shape|trajectory",
    "scale": r"scale|baseline|length|metric|metre",
    "yaw": r"heading|yaw|direction|orient",
    "tilt": r"tilt|roll|upward|level|heights?\b",
    "plan": r"position|GNSS|placement|receiver",
    "height": r"height|vertical|up\b|GNSS|place",
    "place": r"rig|baseline|lever|mount|place|extrinsic|synchron",
    "turn": r"rig|turn|rotation|mount|angle|extrinsic|rigid|orient",
    "focal": r"focal|calibration|lens|intrinsic|principal",
    "images": r"image|photograph|frame|picture",
}
"""Quantity -> the words that name it."""
_HEDGED = {
    "images": r"place of \d+ frames? rests on|only the rig places them",
    "plan": r"exchanged|has the same effect",
    "scale": r"scale|baseline",
    "yaw": r"heading|yaw|exchanged",
    "tilt": r"tilt|roll|upward|exchanged",
    "height": r"height",
    "place": r"lever|place|mount",
    "turn": r"turn|mount|rotation",
    "focal": r"focal|lens",
}
CULPRITS = {
    "positions": r"position|GNSS|receiver|clock|antenna|axes",
    "clock": r"position|GNSS|receiver|clock|antenna|\blag",
    "rig": r"\brig|baseline|extrinsic|mount|lever",
    "camera": r"focal|calibration|lens|intrinsic|principal point",
    "time": r"synchron|clock|time|fire|\brig\b",
    "order": r"order|sequence|number|pass|frame",
    "images": r"image|photograph|blur|sharp",
    "": r"(?!)",
}
"""Wrong input -> the words that name it."""


@dataclass(frozen=True)
class Said:
    """What a run says. ``sigma``: quantity -> stated sigma (camera, plan, height m; scale, focal:NAME shares; yaw,
    tilt, turn:NAME deg; place:NAME m); what is not there is held as given or not stated. ``metric``: it gives lengths
    in metres; ``placed``: it is on the Earth."""

    contradictions: tuple[str, ...] = ()
    hedges: tuple[str, ...] = ()
    sigma: Mapping[str, float] = field(default_factory=dict)
    metric: bool = False
    placed: bool = False
    dropped: tuple[tuple[str, str], ...] = ()
    error: str = ""

    def names(self, quantity: str, wrong_input: str) -> str:
        """How the wrong quantity is said: "contradiction", "hedge", or "" for not at all."""
        kind, _, camera = quantity.partition(":")
        named = re.compile(f"{NAMES[kind]}|{CULPRITS[wrong_input]}", re.IGNORECASE)
        if any(named.search(s) for s in self.contradictions):
            return "contradiction"
        hedged = r"clock" if wrong_input == "clock" else _HEDGED.get(kind, r"(?!)")
        told = (s for s in self.hedges if re.search(hedged, s, re.IGNORECASE))
        return "hedge" if any(not camera or camera in s for s in told) else ""


def read(out: Path, error: str = "") -> Said:
    """What the run in a folder says; ``error``: how it ended if not well."""
    receipts = {s: _json(out / "receipts" / f"{s}.json") for s in _STAGES}
    world = _json(out / "world.json")
    notes = [(s, n) for s, r in receipts.items() for n in r.get("notes", [])]
    hard = [n for r in receipts.values() for n in r.get("contradictions", [])]
    soft = [n for _, n in notes if _contradicts(n) and n not in hard]
    hedges = [n for _, n in notes if HEDGES.search(n) and n not in soft and not _NOT_MEANT.search(n)]
    dropped = [tuple(d[:2]) for r in receipts.values() for d in r.get("dropped", [])]
    return Said(
        contradictions=tuple(dict.fromkeys([*hard, *soft])),
        hedges=tuple(dict.fromkeys(hedges)),
        sigma=sigmas(receipts, world),
        metric=world.get("scale_source", "none") != "none",
        placed=bool(world.get("placed")) and world.get("origin") is not None,
        dropped=tuple(dropped),
        error=error,
    )


def _contradicts(note: str) -> bool:
    """Whether a note's words are those of a contradiction; what "cannot be told" contradicts nothing."""
    return bool(CONTRADICTS.search(note)) and not _NOT_MEANT.search(note) and "cannot be told" not in note


def sigmas(receipts: Mapping[str, dict], world: dict) -> dict[str, float]:
    """The stated sigmas of a run by quantity, lengths in metres."""
    own = world.get("sigma") or {}
    names = {"scale": "scale", "yaw": "yaw_deg", "tilt": "tilt_deg", "plan": "position_m", "height": "height_m"}
    out = {q: own[n] for q, n in names.items() if _is(own.get(n))}
    inner = (world.get("model_sigma") or {}).get("median")
    if _is(inner):
        out["camera"] = inner
    scale = world.get("scale")
    sparse = receipts.get("sparse", {})
    for row in _rows(sparse, "mounting in the rig, model units", ("camera", "sigma", "sigma of the rotation deg")):
        if _is(scale):
            out[f"place:{row[0]}"] = scale * row[1]
        out[f"turn:{row[0]}"] = row[2]
    for row in _rows(receipts.get("georef", {}), "lever arms of the cameras, in the frame of the first",
                     ("camera", "sigma m", "sigma of the rotation deg")):  # fmt: skip
        out |= {f"place:{row[0]}": row[1], f"turn:{row[0]}": row[2]}
    for camera, name, value, sigma in _rows(sparse, "interior orientation", ("camera", "parameter", "value", "sigma")):
        if name in ("f", "fx") and value:
            out[f"focal:{camera}"] = sigma / value
    if "scale" not in out:
        out |= _scale_by_rig(receipts.get("georef", {}).get("notes", []))
    return {q: float(v) for q, v in out.items() if _is(v)}


def _scale_by_rig(notes: Iterable[str]) -> dict[str, float]:
    """Of a model that only the rig makes metric, from the sentence that says so."""
    for note in notes:
        found = re.search(r"scale good to ([\d.]+(?:e-?\d+)?) ?%", note)
        if found:
            return {"scale": float(found.group(1)) / 100}
    return {}


def _rows(receipt: dict, name: str, columns: tuple[str, ...]) -> list[list[Any]]:
    table = (receipt.get("tables") or {}).get(name)
    if not table or any(c not in table["columns"] for c in columns):
        return []
    at = [table["columns"].index(c) for c in columns]
    return [[row[k] for k in at] for row in table["rows"]]


def _is(value: Any) -> bool:
    return isinstance(value, (int, float)) and not isinstance(value, bool) and bool(np.isfinite(value))


def _json(path: Path) -> dict:
    try:
        return json.loads(path.read_text())
    except (OSError, ValueError):
        return {}
