"""What a user should look at before using the products, in sentences; and every image, whether it is used, and if not
why.
"""

from collections.abc import Iterator
from dataclasses import dataclass

import numpy as np
from markupsafe import Markup

from tiegraph.report.accuracy import placement_part
from tiegraph.report.charts import ties
from tiegraph.report.formatting import count, is_number
from tiegraph.report.runfolder import RunFolder
from tiegraph.report.texts import many, said, t
from tiegraph.scene.registered import BY_RIG

_WEAK = {"yaw_deg": 1.0, "tilt_deg": 1.0, "scale": 0.01}
FEW_TIES = 3  # an image with fewer ties hangs loosely
_HELDOUT_FACTOR = 2.0  # held-out positions this much worse than those used: the model bends to its control


def warnings(run: RunFolder) -> list[str]:
    """What a user should look at before using the products, the worst first."""
    return [text for _, text in sorted(_ranked(run), key=lambda row: row[0])]


def _ranked(run: RunFolder) -> Iterator[tuple[int, str]]:
    """(rank, sentence): 0 the products are not whole, 1 they may be wrong as a whole, 2 in parts, 3 something lacks."""
    for stage, receipt in run.receipts.items():
        if not {"key", "lost"} & set(receipt) and stage != "report":
            yield 0, t("The stage {} was interrupted; run the same command again to finish it.", stage)
    dropped = len(dropped_images(run))
    if dropped:
        one = "{} image file could not be used; the reasons are listed below."
        yield 3, many(dropped, one, "{} image files could not be used; the reasons are listed below.", count(dropped))
    if run.scene is not None and run.model is not None:
        yield from _coverage_warnings(run)
    if run.pairs is not None and run.scene is not None and np.any(run.pairs.inliers >= 0):
        few = int(np.sum(ties(run.pairs, len(run.scene)) < FEW_TIES))
        if few:
            one = "{} image has fewer than {} verified ties to other images."
            yield 3, many(few, one, "{} images have fewer than {} verified ties to other images.", count(few), FEW_TIES)
    world = run.world or {}
    if run.done("georef") and not run.georeferenced and not world.get("placed"):
        text = "The model is not georeferenced: positions of the images (GNSS) give coordinates on the Earth."
        yield 1, t(text)
    weak = weak_placement(run)
    if weak:
        yield 1, t("The placement in the world is weak: {}. More or better positions along the way help.", weak)
    if run.accuracy is not None:
        held, fit = (run.accuracy.figure(f"world.{name}").measured for name in ("held_out", "positions"))
        if held > _HELDOUT_FACTOR * fit:
            text = "Positions held back from the fit are met far worse than those used: the model bends to its control."
            yield 1, t(text)


def _coverage_warnings(run: RunFolder) -> Iterator[tuple[int, str]]:
    assert run.scene is not None and run.model is not None
    if run.model.others:
        text = "The images fell into {} separate models: the parts do not share enough ties."
        yield 0, t(text, len(run.model.others) + 1)
    few = run.counts("sparse").get("on_few_points")
    if is_number(few) and few:
        one = (
            "The place of {} frame rests on few points (named in the remarks of sparse): these images may be off by "
            "more than is stated."
        )
        several = (
            "The places of {} frames rest on few points (named in the remarks of sparse): these images may be off by "
            "more than is stated."
        )
        yield 2, many(few, one, several, count(few))
    registered = run.model.registered
    several_passes = len(run.scene.sequences) > 1
    labels = np.array([" ".join(x).strip() if several_passes else x[1] for x in run.scene.image_label()])
    for label in dict.fromkeys(labels):
        of = labels == label
        if label and np.mean(registered[of]) < 0.5:
            by_rig = int(run.model.by_rig[of].sum())
            more = t("; {} more stand where their rig places them.", by_rig) if by_rig else t(".")
            text = "Of {} only {} of {} images are registered{}"
            yield 2, t(text, str(label), int(registered[of].sum()), int(of.sum()), more)


def weak_placement(run: RunFolder) -> str:
    """What of the placement in the world is poorly known, in words; "" if nothing."""
    if run.accuracy is None:
        return ""
    weak = [name for name, limit in _WEAK.items() if run.accuracy.placement.get(name, 0.0) > limit]
    return Markup(t(", ")).join(placement_part(run.accuracy, name) for name in weak)


def dropped_images(run: RunFolder) -> list[tuple[str, str]]:
    """Files left out by the scan, with reasons."""
    if run.scene is not None and run.scene.dropped:
        return [(d.name, d.reason) for d in run.scene.dropped]
    return [(str(d[0]), str(d[1])) for d in run.receipts.get("scan", {}).get("dropped") or [] if len(d) >= 2]


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
