"""What a user should look at before using the products, in sentences."""

from collections.abc import Iterator

import numpy as np
from markupsafe import Markup

from tiegraph.report.accuracy import placement_part
from tiegraph.report.charts import ties
from tiegraph.report.formatting import count, is_number
from tiegraph.report.runfolder import RunFolder
from tiegraph.report.texts import many, t

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
    untied = _untied_borders(run)
    if untied:
        one = "{} border between sections is not tied by two independent pairs: the model may bend or part there."
        several = "{} borders between sections are not tied by two independent pairs: the model may bend or part there."
        yield 2, many(untied, one, several, count(untied))
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


def _untied_borders(run: RunFolder) -> int:
    """Rows of the table of section links that say "not tied"."""
    found = run.receipts.get("network", {}).get("tables")
    table = next((t for n, t in found.items() if "section" in n), None) if isinstance(found, dict) else None
    if not isinstance(table, dict) or "tied" not in (table.get("columns") or []):
        return 0
    place = table["columns"].index("tied")
    return sum(row[place] is False for row in table.get("rows") or [] if len(row) > place)


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
