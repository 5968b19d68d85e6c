"""Every image of a survey, whether it is used, and if not why."""

from dataclasses import dataclass

import numpy as np

from tiegraph.report.charts import ties
from tiegraph.report.runfolder import RunFolder
from tiegraph.report.texts import said, t
from tiegraph.report.warnings import dropped_images
from tiegraph.scene.registered import BY_RIG

REGISTERED, ABSENT, LEFT_OUT = "registered", "not in the model", "left out by the scan"
HANGING = "hangs on the rig"  # no part of structure from motion (``scene.hanging``)
STATES = (REGISTERED, BY_RIG, HANGING, ABSENT, LEFT_OUT)


@dataclass(frozen=True)
class ImageRow:
    """One image: ``state`` is one of ``STATES``; ``reason``: why it is not used, or gives no depth map, "" if it is;
    points it sees, verified pairs (None = not known), size of a pixel on the surface in units of the world, NaN."""

    name: str
    state: str
    reason: str = ""
    points: int | None = None
    ties: int | None = None
    gsd: float = float("nan")


def image_rows(run: RunFolder) -> list[ImageRow]:
    """Those that are not used first, each group by name; [] where no model was made."""
    out = [ImageRow(name, LEFT_OUT, reason) for name, reason in dropped_images(run)]
    if run.scene is None or run.model is None:
        return []
    reasons = {stage: _reasons(run, stage) for stage in ("sparse", "georef", "dense")}
    count = ties(run.pairs, len(run.scene)) if run.pairs is not None else None
    m = run.model
    for k, name in enumerate(run.scene.names):
        state = REGISTERED if m.registered[k] else BY_RIG if m.by_rig[k] else ABSENT
        known = [reasons[s][name] for s in ("sparse", "georef") if name in reasons[s]]
        if state == BY_RIG and not known:
            known = [f"sees {int(m.images.points[k])} points that agree, fewer than {m.images.min_points}"]
        if state == ABSENT and not known:
            known = ["no reason was recorded"]
        if name in reasons["dense"]:
            known.append(f"no depth map: {reasons['dense'][name]}")
        pairs = None if count is None else int(count[k])
        gsd = float(m.observed.gsd[k])
        points = int(m.images.points[k])
        out.append(ImageRow(name=name, state=state, reason="; ".join(known), points=points, ties=pairs, gsd=gsd))
    out += [_hanging_row(run, name, posed, reasons["dense"]) for name, posed in run.hung]
    order = {state: k for k, state in enumerate((LEFT_OUT, ABSENT, BY_RIG, HANGING, REGISTERED))}
    return sorted(out, key=lambda row: order[row.state])


def _hanging_row(run: RunFolder, name: str, posed: bool, no_depth: dict[str, str]) -> ImageRow:
    """An image that hangs on its rig: it stands where the rig places it, or why it has no place."""
    if posed:
        return ImageRow(name, HANGING, f"no depth map: {no_depth[name]}" if name in no_depth else "")
    if run.hanging[1]:
        return ImageRow(name, ABSENT, "hangs on the rig, but no wide image of its frame has a place")
    return ImageRow(name, ABSENT, "hangs on the rig, but nothing tells the scale")


def counts(rows: list[ImageRow]) -> list[tuple[str, int]]:
    """(state in words, images) of each state that occurs."""
    states = np.array([row.state for row in rows])
    return [(said(state), int(np.sum(states == state))) for state in STATES if np.any(states == state)]


def reason_text(row: ImageRow) -> str:
    """The reason in the language of the page, as far as its parts are known."""
    return t("; ").join(said(part) for part in row.reason.split("; ")) if row.reason else ""


def _reasons(run: RunFolder, stage: str) -> dict[str, str]:
    found = run.receipts.get(stage, {}).get("dropped")
    rows = found if isinstance(found, list) else []
    return {str(r[0]): str(r[1]) for r in rows if isinstance(r, (list, tuple)) and len(r) >= 2}
