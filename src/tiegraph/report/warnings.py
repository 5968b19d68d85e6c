"""Points to check before using the products, in sentences; and every image, whether it is used, and if not
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
from tiegraph.scene.colmapmodel import BY_RIG

_WEAK = {"yaw_deg": 1.0, "tilt_deg": 1.0, "scale": 0.01}
FEW_TIES = 3  # an image with fewer ties is weakly connected
_HELDOUT_FACTOR = 2.0  # held-out positions this much worse than those used: the model bends to its control


def warnings(run: RunFolder) -> list[str]:
    """Points to check before using the products, the worst first."""
    return [text for _, text in sorted(_ranked(run), key=lambda row: row[0])]


def _ranked(run: RunFolder) -> Iterator[tuple[int, str]]:
    """(rank, sentence): 0 the products are not whole, 1 they may be wrong as a whole, 2 in parts, 3 something lacks."""
    for stage, receipt in run.receipts.items():
        if not {"key", "lost"} & set(receipt) and stage != "report":
            yield 0, t("The stage {} was interrupted; run the same command again to finish it.", stage)
    if dropped := len(dropped_images(run)):
        one = "{} image file could not be used; the reasons are listed below."
        yield 3, many(dropped, one, "{} image files could not be used; the reasons are listed below.", count(dropped))
    if run.scene is not None and run.model is not None:
        yield from _coverage_warnings(run)
    if run.pairs is not None and run.scene is not None and np.any(run.pairs.inliers >= 0):
        if few := int(np.sum(ties(run.pairs, len(run.scene)) < FEW_TIES)):
            one = "{} image has fewer than {} verified ties to other images."
            yield 3, many(few, one, "{} images have fewer than {} verified ties to other images.", count(few), FEW_TIES)
    if run.done("georef") and not run.georeferenced and not (run.world or {}).get("placed"):
        text = "The model is not georeferenced: positions of the images (GNSS) give coordinates on the Earth."
        yield 1, t(text)
    if weak := weak_placement(run):
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
        rest = "on few points (named in the remarks of sparse): these images may be off by more than is stated."
        yield (
            2,
            many(few, f"The place of {{}} frame rests {rest}", f"The places of {{}} frames rest {rest}", count(few)),
        )
    registered = run.model.registered
    several_passes = len(run.scene.sequences) > 1
    labels = np.array([" ".join(x).strip() if several_passes else x[1] for x in run.scene.image_label()])
    for label in dict.fromkeys(labels):
        of = labels == label
        if label and np.mean(registered[of]) < 0.5:
            by_rig = int(run.model.by_rig[of].sum())
            more = t("; {} more have poses by their rig.", by_rig) if by_rig else t(".")
            text = "Of {} only {} of {} images are registered{}"
            yield 2, t(text, str(label), int(registered[of].sum()), int(of.sum()), more)


def weak_placement(run: RunFolder) -> str:
    """Poorly known components of the placement in the world, in words; "" if none."""
    if run.accuracy is None:
        return ""
    weak = [name for name, limit in _WEAK.items() if run.accuracy.placement.get(name, 0.0) > limit]
    return Markup(t(", ")).join(placement_part(run.accuracy, name) for name in weak)


def dropped_images(run: RunFolder) -> list[tuple[str, str]]:
    """Files left out by the scan, with reasons."""
    own = [] if run.scene is None else [(d.name, d.reason) for d in run.scene.dropped]
    return own or run.dropped("scan")


REGISTERED, ABSENT, LEFT_OUT = "registered", "not in the model", "left out by the scan"
HANGING = "hangs on the rig"  # no part of structure from motion (``scene.composed``)
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
    m = run.model
    if run.scene is None or m is None:
        return []
    out = [ImageRow(name, LEFT_OUT, reason) for name, reason in dropped_images(run)]
    sparse, georef, dense = (dict(run.dropped(stage)) for stage in ("sparse", "georef", "dense"))
    pairs = ties(run.pairs, len(run.scene)).tolist() if run.pairs is not None else [None] * len(run.scene)
    for k, name in enumerate(run.scene.names):
        state = REGISTERED if m.registered[k] else BY_RIG if m.by_rig[k] else ABSENT
        points, known = int(m.images.points[k]), [found[name] for found in (sparse, georef) if name in found]
        if state == BY_RIG:
            known = known or [f"sees {points} points that agree, fewer than {m.images.min_points}"]
        if state == ABSENT:
            known = known or ["no reason was recorded"]
        known += [f"no depth map: {dense[name]}"] if name in dense else []
        gsd = float(m.observed.gsd[k])
        out.append(ImageRow(name=name, state=state, reason="; ".join(known), points=points, ties=pairs[k], gsd=gsd))
    nowhere = "no wide image of its frame has a place" if run.hanging[1] else "nothing tells the scale"
    for name, posed in run.hung:  # it stands where the rig places it, or has no place
        state, reason = (HANGING, "") if posed else (ABSENT, f"hangs on the rig, but {nowhere}")
        out.append(ImageRow(name, state, f"no depth map: {dense[name]}" if posed and name in dense else reason))
    order = (LEFT_OUT, ABSENT, BY_RIG, HANGING, REGISTERED)
    return sorted(out, key=lambda row: order.index(row.state))


def counts(rows: list[ImageRow]) -> list[tuple[str, int]]:
    """(state in words, images) of each state that occurs."""
    found = [(said(state), sum(row.state == state for row in rows)) for state in STATES]
    return [row for row in found if row[1]]


def reason_text(row: ImageRow) -> str:
    """The reason in the language of the page, as far as its parts are known."""
    return t("; ").join(said(part) for part in row.reason.split("; ")) if row.reason else ""
