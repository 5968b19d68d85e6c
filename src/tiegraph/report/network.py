"""The ties between images: matrices of tested and of verified pairs, the funnel, the ties of an image; pictures, tables
and remarks of the stages, in the order of a reader's questions.
"""

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

import numpy as np
from markupsafe import Markup

from tiegraph.report import formatting
from tiegraph.report.drawing import LIGHT, USED, bars, file_uri, histogram, matrix, png, rgb_of
from tiegraph.report.runfolder import RunFolder
from tiegraph.report.texts import capital, said, t
from tiegraph.scene.pairs import REASON_LOOKS, REASONS, Pairs
from tiegraph.scene.scene import Scene

_MATCHES = ((1, "#c7e0ea"), (30, "#7fb8d0"), (100, "#2b7a9b"), (300, "#0a3d55"))  # verified matches from, colour
FEW_TIES = 3  # an image with fewer ties is weakly connected


def looked_at(pairs: Pairs, scene: Scene) -> Markup:
    """Every tested pair, by image and image, in the colour of the reason why it was dropped."""
    looks = [REASON_LOOKS[reason] for reason in REASONS]
    key = [(said(looks[k][0]), looks[k][1]) for k in np.unique(pairs.dropped)]
    label = t("Tested: {} pairs", formatting.count(len(pairs)))
    return _matrix(pairs, -pairs.dropped.astype(int), scene, [colour for _, colour in looks], key, label)


def holding(pairs: Pairs, scene: Scene) -> Markup:
    """The pairs that hold, by their verified matches; before the matching, those to be matched."""
    kept, colours = tied(pairs), [colour for _, colour in _MATCHES]
    if not is_matched(pairs):
        label = t("To be matched: {} pairs", formatting.count(len(kept)))
        return _matrix(kept, np.full(len(kept), len(_MATCHES) - 1), scene, colours, [], label)
    step = np.searchsorted([low for low, _ in _MATCHES], kept.inliers, side="right") - 1
    key = [(t("from {} matches", low), colour) for low, colour in _MATCHES]
    return _matrix(kept, step, scene, colours, key, t("Verified: {} pairs", formatting.count(len(kept))))


def is_matched(pairs: Pairs) -> bool:
    """Whether the pairs were matched at full resolution."""
    return bool(np.any(pairs.inliers >= 0))


def tied(pairs: Pairs) -> Pairs:
    """The verified pairs; before the matching, those to be matched."""
    kept = pairs.kept()
    return kept.where(kept.inliers > 0) if is_matched(pairs) else kept


def _matrix(
    pairs: Pairs, rank: np.ndarray, scene: Scene, colours: Sequence[str], key: Sequence[tuple[str, str]], label: str
) -> Markup:
    """The matrix of the images by pass, camera and step, pairs of rank k or -k in colour k, the highest on top."""
    n = max(len(scene), 1)
    order = np.lexsort((scene.sequence_index[scene.frame], scene.sensor_key, scene.sequence[scene.frame]))
    labels = scene.image_label()
    names = [" ".join(labels[k]).strip() for k in order]
    starts = [k for k in range(len(names)) if k == 0 or names[k] != names[k - 1]]
    blocks = [((a + b) / 2 / n, names[a]) for a, b in zip(starts, [*starts[1:], len(names)])]
    size, rising = min(len(scene), 700), np.argsort(rank, kind="stable")
    place = np.argsort(order)
    row, column = (place[ends[rising]] * size // n for ends in (pairs.i, pairs.j))
    rgba = np.zeros((size, size, 4), np.uint8)
    rgba[row, column] = rgba[column, row] = np.array([[*rgb_of(c), 255] for c in colours])[np.abs(rank[rising])]
    named = blocks[:: -(-len(blocks) // 16) or 1]
    return matrix(png(rgba), named, [k / n for k in starts[1:]], key, label)


def funnel_rows(pairs: Pairs, network: Pairs | None) -> list[tuple[str, int, str]]:
    """(what, pairs, colour) from all candidates to the verified ones, in the order of the filters."""
    funnel = pairs.funnel()
    before = len(network) - len(pairs) if network is not None else 0
    rows = [("candidates", max(before, 0) + len(pairs), "#8b949e")]
    rows += [("dropped: in the network", before, "#c9ced6")] if before > 0 else []
    lost = {k: (f"dropped: {REASON_LOOKS[k][0]}", v, REASON_LOOKS[k][1]) for k, v in funnel.items() if k in REASONS}
    after = [lost.pop("match")] if "match" in lost else []
    rows += lost.values()
    if not is_matched(pairs):
        return [*rows, ("pairs to match", funnel["used"], USED)]
    rows.append(("matched at full resolution", funnel["used"] + sum(n for _, n, _ in after), USED))
    return [*rows, *after, ("verified", len(tied(pairs)), "#0b4f6c")]


def funnel(rows: Sequence[tuple[str, int, str]]) -> Markup:
    """The remaining pairs after every filter, with the dropped ones in their colour of the matrix."""
    drawn: list[tuple[str, Sequence[tuple[float, str]], str]] = []
    left = 0
    for name, value, colour in rows:
        name, _, reason = name.partition(": ")  # of what was dropped
        left = left - value if reason else value
        words, parts, end = said(name), [(left, colour)], formatting.count(left)
        if reason:
            words, parts = f"{t(name)}: {said(reason)}", [(left, LIGHT), (value, colour)]
            end = f"\N{MINUS SIGN}{formatting.count(value)} \N{RIGHTWARDS ARROW} {end}"
        drawn.append((words, parts, end))
    return bars(drawn, t("From candidates to ties"))


def ties(pairs: Pairs, images: int) -> np.ndarray:
    """(N,) verified, or else planned, pairs of each image."""
    return tied(pairs).degree(images)


_NETWORK_STAGES = ("preview", "candidates", "coarse", "network", "design", "features", "match")
_TITLES = {
    "candidates": "Candidates", "coarse": "Coarse model", "network": "Network", "design": "Design",
    "match": "Matching",
}  # fmt: skip
# Pictures of the network folder in order of display; the first word found in the file's name decides.
_CAPTIONS = {
    "map": "The tie graph on the map, by kind of tie, before the design: every pair that is expected to share surface.",
    "design": "The ties that the design chose to match: thick bundles hold the survey together, a red line is a place "
    "with only one link.",
    "covered": "How well the surface is covered, seen from above: cells by what is weak about them; the numbers are "
    "rows of the table of places to revisit.",
    "section": "View of the upward camera along the path, and the bridge and open sections derived from it.",
}
_WEAK_LINKS = "Weak links: places where the survey is disconnected, or weakly connected, if one tie or frame is lost."
_SOUND = "No weak links: no place depends on a single tie or frame."


def network_part(run: RunFolder) -> dict[str, Any]:
    """Pictures, funnel, tables and remarks of the stages from preview to matching."""
    out: dict[str, Any] = {"matrices": None, "funnel": None, "degrees": None, "sound": None}
    pairs = run.pairs if run.pairs is not None else run.network
    if pairs is not None and run.scene is not None and len(pairs):
        before = run.network if run.network is not None else pairs
        out["matrices"] = [looked_at(before, run.scene), holding(pairs, run.scene)]
        out["funnel"] = funnel(funnel_rows(pairs, run.network))
        label = t("ties of an image (red: fewer than {})", FEW_TIES)
        out["degrees"] = histogram(ties(pairs, len(run.scene)), FEW_TIES, label, t("images"))
    notes = {_title(s): lines for s in _NETWORK_STAGES if s != "coarse" and (lines := run.notes(s))}
    sentences = [note if note.endswith((".", "!", "?")) else f"{note}." for note in map(capital, run.notes("coarse"))]
    out |= {"model": sentences, "notes": list(notes.items()), "links": [], "tables": []}
    out["pictures"] = _pictures(run)
    for stage in _NETWORK_STAGES:
        for name, data in run.tables(stage).items():
            plain = str(name).replace("_", " ")
            table = formatting.table(data, f"{_title(stage)}: {said(plain)}", f"receipts.{stage}.{name}")
            if plain == "weak links" and isinstance(data, dict) and not data.get("rows"):
                out["sound"] = t(_SOUND)
            elif table is not None and plain == "weak links":
                out["links"].append(replace(table, title=t(_WEAK_LINKS)))
            elif table is not None:
                out["tables"].append(table)
    return {**out, "there": any(out[name] for name in ("matrices", "pictures", "tables", "links", "notes"))}


def _title(stage: str) -> str:
    return t(_TITLES.get(stage, stage.capitalize()))


def _pictures(run: RunFolder) -> list[tuple[str, str]]:
    found, order = [], list(_CAPTIONS)
    for path in sorted(p for folder in ("network", "design") for p in (run.path / folder).glob("*.png")):
        title = {"surface": "covered"}.get(path.stem, "design") if path.parent.name == "design" else path.stem
        kind = next((k for k in order if k in title), "")
        if uri := file_uri(path):
            caption = t(_CAPTIONS.get(kind, path.stem.replace("_", " ")))
            found.append((order.index(kind) if kind else len(order), uri, caption))
    return [(uri, caption) for _, uri, caption in sorted(found, key=lambda f: f[0])]
