"""What a user should look at before using the products, in sentences."""

from __future__ import annotations

from collections.abc import Iterable

import numpy as np
from markupsafe import Markup

from tiegraph.report import formatting
from tiegraph.report.accuracy import placement_part
from tiegraph.report.formatting import is_number
from tiegraph.report.runfolder import RunFolder

_WEAK = {"yaw_deg": 1.0, "tilt_deg": 1.0, "scale": 0.01}
_FEW_TIES = 3  # an image with fewer ties hangs loosely
_HELDOUT_FACTOR = 2.0  # held-out positions this much worse than those used: the model bends to its control


def warnings(run: RunFolder) -> Iterable[str]:
    """What a user should look at before using the products."""
    for stage, receipt in run.receipts.items():
        if "key" not in receipt and stage != "report":
            yield f"The stage {stage} was interrupted; run the same command again to finish it."
    dropped = dropped_images(run)
    if dropped:
        yield f"{formatting.plural(len(dropped), 'image file')} could not be used; the reasons are listed below."
    if run.scene is not None and run.model is not None:
        yield from _coverage_warnings(run)
    untied = _untied_borders(run)
    if untied:
        borders = formatting.plural(untied, "border") + " between sections " + ("is" if untied == 1 else "are")
        yield f"{borders} not tied by two independent pairs: the model may bend or part there."
    if run.pairs is not None and run.scene is not None and np.any(run.pairs.inliers >= 0):
        kept = run.pairs.kept()
        ties = kept.where(kept.inliers > 0).degree(len(run.scene))
        few = int(np.sum(ties < _FEW_TIES))
        if few:
            verb = "has" if few == 1 else "have"
            yield f"{formatting.plural(few, 'image')} {verb} fewer than {_FEW_TIES} verified ties to other images."
    world = run.world or {}
    if run.done("georef") and not run.georeferenced and not world.get("placed"):
        yield "The model is not georeferenced: give --gnss (or images with GPS) for coordinates on the Earth."
    weak = weak_placement(run)
    if weak:
        text = "The placement in the world is weak: {}. More or better positions along the way help."
        yield Markup(text).format(weak)
    if run.accuracy is not None:
        held, fit = (run.accuracy.figure(f"world.{name}").measured for name in ("held_out", "positions"))
        if held > _HELDOUT_FACTOR * fit:
            yield "Positions held back from the fit are met far worse than those used: the model bends to its control."


def _untied_borders(run: RunFolder) -> int:
    """Rows of the table of section links that say "not tied"."""
    found = run.receipts.get("network", {}).get("tables")
    table = next((t for n, t in found.items() if "section" in n), None) if isinstance(found, dict) else None
    if not isinstance(table, dict) or "tied" not in (table.get("columns") or []):
        return 0
    place = table["columns"].index("tied")
    return sum(row[place] is False for row in table.get("rows") or [] if len(row) > place)


def _coverage_warnings(run: RunFolder) -> Iterable[str]:
    assert run.scene is not None and run.model is not None
    if run.model.others:
        parts = len(run.model.others) + 1
        yield f"The images fell into {parts} separate models: the parts do not share enough ties."
    few = run.counts("sparse").get("on_few_points")
    if is_number(few) and few:
        verb = "rests" if few == 1 else "rest"
        yield (
            f"The place of {formatting.plural(few, 'frame')} {verb} on few points (named in the remarks of sparse): "
            "these images may be off by more than is stated."
        )
    registered = run.model.registered
    labels = np.array([" ".join(x).strip() for x in run.scene.image_label()])
    for label in dict.fromkeys(labels):
        of = labels == label
        if label and np.mean(registered[of]) < 0.5:
            more = int(run.model.by_rig[of].sum())
            yield f"Of {label} only {int(registered[of].sum())} of {int(of.sum())} images are registered" + (
                f"; {more} more stand where their rig places them." if more else "."
            )


def weak_placement(run: RunFolder) -> Markup:
    """What of the placement in the world is poorly known, in words; "" if nothing."""
    if run.accuracy is None:
        return Markup()
    weak = [name for name, limit in _WEAK.items() if run.accuracy.placement.get(name, 0.0) > limit]
    return Markup(", ").join(placement_part(run.accuracy, name) for name in weak)


def dropped_images(run: RunFolder) -> list[tuple[str, str]]:
    """Files left out by the scan, with reasons."""
    if run.scene is not None and run.scene.dropped:
        return [(d.name, d.reason) for d in run.scene.dropped]
    return [(str(d[0]), str(d[1])) for d in run.receipts.get("scan", {}).get("dropped") or [] if len(d) >= 2]
