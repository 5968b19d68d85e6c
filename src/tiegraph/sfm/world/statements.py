"""The statements of a georeference: the table of evidence, and each contradiction in one sentence."""

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations

import numpy as np

from tiegraph.geometry.gravity import Up
from tiegraph.geometry.transforms import rms_length
from tiegraph.scene.evidence import LIMIT, Contradiction, Statement, Trend, contradictions, trend
from tiegraph.sfm.shape import Shape
from tiegraph.sfm.world.georef import AXES, Findings, Georeference
from tiegraph.sfm.world.marks import Target
from tiegraph.sfm.world.scale import RIG
from tiegraph.sfm.world.similarityfit import SimilarityFit
from tiegraph.sfm.world.weighing import (
    CONTROL,
    HEADING,
    ORIENTATIONS,
    PLACES,
    SCALE,
    TILTS,
    TWO_ENDS,
    length_statement,
    orientation_statements,
    up_statements,
)

_ALONG = "along the motion"
_CAUSES = {
    "line": "positions that drift, or a scale that is determined by {}",
    "curve": "a model that bends, or positions that drift",
    "offset": "wrong times of the positions, or an antenna ahead of or behind the cameras",
    "step": "positions that jump (a receiver that lost and found its fix, another base), or a torn model",
}


def with_statements(found: Georeference, targets: list[Target]) -> Georeference:
    """The georeference with its statements and contradictions; sigmas are increased where a contradiction requires
    it.

    ``targets``: the control points in its world.
    """
    placing, known = found.placing, found.uncertainty
    if placing is None or known.error is None:
        return found
    weighed, bars = placing.weighed, placing.measured.bars
    said = statements(found, placing)
    of_quantity: dict[str, Contradiction] = {}
    for c in contradictions(said):  # the worst first
        of_quantity.setdefault(c.first.quantity, c)
    worst = list(of_quantity.values())
    if weighed.why and not any(c.first.quantity == SCALE for c in worst):
        worst += _decided(said)
    sentences = [c.text(_culprit(c, said, weighed.why)) for c in worst]
    sentences += [placing.doubt] if placing.doubt else []
    sigma = dict(known.sigma)
    if weighed.scale_sigma:
        sigma["scale"] = round(max(sigma["scale"], weighed.scale_sigma), 6)
        wide = f"; the scale is stated to {weighed.scale_sigma:.1%}"
        sentences = [t + wide if t.startswith(SCALE) else t for t in sentences]
    inside_m = 0.0 if known.shape is None else known.shape.sizes()["median"]
    form = _trend(found, placing, inside_m, scale_said=any(c.first.quantity == SCALE for c in worst))
    if form is not None:
        axis, size, text = form
        key = "height_m" if axis == "up" else "position_m"
        sigma[key] = round(max(sigma[key], size / 2), 6)
        if axis == _ALONG:
            length_m = float(np.linalg.norm(np.ptp(placing.fixes.position, axis=0)))
            sigma["scale"] = round(max(sigma["scale"], size / max(length_m, 1e-9)), 6)
        sentences.append(text)
    sentences += [*_scatter(found, placing, explained=form is not None), *_control(found, placing, targets)]
    error = known.error.widened_to(sigma)
    if known.shape is not None:  # heading and tilt are stated for the images, not for their positions alone
        yaw, tilt = np.degrees(np.sqrt(_turned(known.shape, placing.up)))
        sigma["yaw_deg"] = round(float(np.hypot(sigma["yaw_deg"], yaw)), 6)
        sigma["tilt_deg"] = round(float(np.hypot(sigma["tilt_deg"], tilt)), 6)
    found = replace(found, uncertainty=replace(known, sigma=sigma, error=error))
    found, more = _with_predicted(found, placing, inside_m, targets)
    sentences += more
    sentences += bars.told(found.control.bars, sigma["scale"]) if bars is not None else ()
    notes = (*found.findings.notes, *_rests_on(placing))
    return replace(found, findings=Findings(notes, tuple(said), tuple(sentences)))


def _turned(shape: Shape, up: Up | None) -> tuple[float, float]:
    """Variances, rad squared, of heading and tilt of the images relative to their positions, if these determine them:
    an upward direction is that of the images, and determines the tilt or, for cameras on one side, the roll about the
    track."""
    track = np.linalg.svd(shape.place - shape.place.mean(axis=0), full_matrices=False)[2][0]
    across = np.array([-track[1], track[0], 0.0]) / max(float(np.hypot(*track[:2])), 1e-12)
    tilt = across @ shape.turn @ across if up is not None else shape.turn[0, 0] + shape.turn[1, 1]
    return float(shape.turn[2, 2]), 0.0 if up is not None and up.tilt else float(tilt)


def statements(found: Georeference, placing: SimilarityFit) -> list[Statement]:
    """The statements of each source, relative to the result."""
    weighed, measured, result = placing.weighed, placing.measured, found.world_from_model
    out = []
    for source in weighed.sources:
        used = (SCALE,) * (source.name in weighed.scale_used)
        used += (HEADING, *TILTS, *PLACES) * (source.name in weighed.places_used)
        said = source.statements(result, weighed.at, used, placing.tuning.statements)
        out += [s for s in said if placing.up is None or source.name == CONTROL or s.quantity not in TILTS]
    for k, scale in enumerate(measured.lengths):
        out += length_statement(scale, result, k == 0 and placing.evidence.log_scale is not None)
    out += up_statements(measured.up, result, placing.up is not None)
    out += orientation_statements(placing.evidence, result, placing.tuning.fit)
    offset, sigma = placing.fit.offset_s, placing.fit.offset_sigma_s
    if np.isfinite(sigma):
        used = bool(found.clock_offset_s)
        out.append(Statement("clock", "images and positions", value=offset, sigma=sigma, unit="s", used=used))
    return out


def _decided(said: list[Statement]) -> list[Contradiction]:
    """The contradiction of the scale, if it was decided between sources although the result reduces their difference
    a little."""
    pairs = list(combinations([s for s in said if s.quantity == SCALE], 2))
    found = [Contradiction(a, b, float(abs(a.value - b.value) / np.hypot(a.sigma, b.sigma))) for a, b in pairs]
    return sorted(found, key=lambda c: -c.sigmas)[:1]


def _culprit(c: Contradiction, said: list[Statement], why: str) -> str:
    """The likely cause, in words; ``why``: how the scale was decided."""
    names = {c.first.source, c.second.source}
    if c.first.quantity == SCALE:
        hint = "another unit or projection"
        if RIG in names:
            hint = "do its cameras fire at different times, or is a baseline wrong"
        return f"{why} ({hint}?)" if why else hint + "?"
    others = [s for s in said if s.quantity == c.first.quantity and s.source not in names]
    for one, other in ((c.first, c.second), (c.second, c.first)):
        bad = [s for s in others if abs(s.value - one.value) > LIMIT * np.hypot(s.sigma, one.sigma)]
        good = [s for s in others if abs(s.value - other.value) <= LIMIT * np.hypot(s.sigma, other.sigma)]
        if others and len(bad) == len(good) == len(others):
            return f"{one.source} contradicts {' and '.join([other.source, *(s.source for s in others)])}"
    if c.first.quantity == "height" and CONTROL in names:
        return (
            f"the difference is the same everywhere ({c.first.value - c.second.value:+.1f} m); are heights above the "
            f"start or above sea level, or missing, in one of them? those of the {CONTROL} are used"
        )
    if ORIENTATIONS in names:
        return "are the axes of the given orientations those of the rig?"
    if CONTROL in names:
        return f"another datum, or points of another survey? the {CONTROL} are used"
    return "the table of evidence shows which is used"


def _trend(
    found: Georeference, placing: SimilarityFit, inside_m: float, scale_said: bool
) -> tuple[str, float, str] | None:
    """Axis, size and sentence of the largest systematic residual that exceeds the errors of two positions and of the
    model (one cause appears on several axes)."""
    fixes, tuning = placing.fixes, placing.tuning
    if not len(fixes):
        return None
    order = placing.measured.time_order(fixes)
    sigma, residual = np.hypot(fixes.sigma[order], inside_m), found.residuals.fixes_m[order]
    series = [(a, residual[:, k], sigma[:, k]) for k, a in enumerate(AXES)]
    along = np.sum(residual * _directions(fixes.position[order] + residual), axis=1)
    series.append((_ALONG, along, sigma[:, :2].max(axis=1)))
    anywhere = placing.weighed.free_antenna and not placing.fit.antenna.any()  # on the vehicle
    out = []
    for axis, values, each in series:
        form = trend(values, len(series), offset=axis == _ALONG, sigma=each)
        if form is None or (scale_said and form.form == "line"):
            continue
        stated = form.size / 2 / form.sigmas
        known_to = np.hypot(stated, tuning.fit.antenna_sigma_m if form.form == "offset" and anywhere else 0.0)
        if form.size / 2 > TWO_ENDS * known_to:
            out.append((axis, form.size, _trend_text(axis, form, stated, found, placing)))
    return max(out, key=lambda t: t[1], default=None)


def _trend_text(axis: str, form: Trend, sigma: float, found: Georeference, placing: SimilarityFit) -> str:
    where = axis if axis == _ALONG else f"towards {axis}" if axis != "up" else "in height"
    lengths = placing.measured.lengths if placing.weighed.lengths_used else ()
    causes = _CAUSES[form.form].format(f"the {lengths[0].source}" if lengths else "something else")
    kept = "" if found.adjusted else "; the model was not bent to them"
    return (
        f"positions and model: the residuals {form.text()} {where}, which is not noise for a stated sigma of "
        f"{sigma:.2g} m. Possible causes: {causes}{kept}"
    )


def _directions(place: np.ndarray) -> np.ndarray:
    """(K, 3) unit vectors of the motion in plan at places (K, 3) in order."""
    if len(place) < 3:
        return np.zeros_like(place)
    way = np.gradient(place, axis=0)
    way[:, 2] = 0
    return way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)


def _rests_on(placing: SimilarityFit) -> list[str]:
    """What determines the scale where the rig does, and what checks it: the images themselves cannot."""
    measured = placing.measured
    if not measured.lengths or not placing.weighed.lengths_used:
        return []
    scale, most = measured.lengths[0], placing.tuning.statements.told
    told = [s for s in placing.weighed.sources if s.scale_sigma < most]
    checked = " and ".join(f"the {s.name} determine it to {s.scale_sigma:.1%}" for s in told)
    levers = ", ".join(s.name for r in measured.scene.rigs if not r.nominal for s in r.sensors[1:])
    on = f"lever arms of the rig as given ({levers})" if scale.source == RIG else scale.source
    return [f"the scale comes from the {on}, with a sigma of {scale.sigma:.1%}; {checked or 'nothing else checks it'}"]


def _scatter(found: Georeference, placing: SimilarityFit, explained: bool) -> Iterator[str]:
    """Positions whose scatter far exceeds their stated sigma."""
    tuning = placing.tuning
    for sigma_m, factor, count in placing.fit.levels:
        if factor > tuning.statements.scatter and count >= tuning.noise.min_rows and not explained:
            yield (
                f"{placing.weighed.name} of stated sigma {sigma_m:.2f} m scatter {factor:.1f} times as much ({count} "
                "of them); their sigma was increased accordingly. Possible causes: a receiver with optimistic sigmas, "
                "or an unknown lever arm or clock offset"
            )
    used, total = int(found.residuals.inlier.sum()), int(found.residuals.known.sum())
    if total >= tuning.noise.min_rows and used < tuning.statements.agreeing * total:
        yield (
            f"only {used} of {total} positions agree with the model within three sigmas: the model is bent or torn, or "
            "the positions are of another survey"
        )


def _control(found: Georeference, placing: SimilarityFit, targets: list[Target]) -> Iterator[str]:
    """Control points that contradict the others, and those that contradict each other without a single wrong one."""
    control, points = placing.measured.given.control, placing.measured.points
    yield from (f"control point {r['name']!r} is not used: {r['why_not']}" for r in found.control.rows if r["blunder"])
    if control is None or not len(points):
        return
    spread = np.array([np.trace(targets[k].covariance) / 3 for k in points])
    stated = np.sqrt(control.sigma_m[points] ** 2 + spread[:, None])
    factor = float(np.median(placing.evidence.sigma[len(placing.fixes) :] / stated))
    if factor > placing.tuning.statements.scatter:
        yield (
            f"{len(stated)} control points contradict each other: they scatter {factor:.1f} times their sigma of "
            f"{np.median(control.sigma_m[points]):.2g} m, and no single one of them is the cause"
        )


def _with_predicted(
    found: Georeference, placing: SimilarityFit, inside_m: float, targets: list[Target]
) -> tuple[Georeference, list[str]]:
    """The accuracies of control and check points with the predicted size of their differences (``predicted_m``), and
    check points whose error far exceeds it."""
    control, error, accuracy, said = placing.measured.given.control, found.uncertainty.error, {}, []
    for role, values in found.control.accuracy.items():
        assert control is not None and error is not None
        accuracy[role] = values
        rows = [k for k, r in enumerate(found.control.rows) if r["role"] == role and r["off_m"] and not r["why_not"]]
        if not rows:
            continue
        spread = np.array([np.diag(targets[k].covariance) for k in rows])
        known = error.sigma(control.world_m[rows])
        sigma = np.sqrt(control.sigma_m[rows] ** 2 + spread + known**2 + inside_m**2)
        off = np.array([found.control.rows[k]["off_m"] for k in rows], float)
        actual, expected = rms_length(off), rms_length(sigma)
        accuracy[role] = {**values, "predicted_m": round(expected, 4)}
        if role == "check" and actual > placing.tuning.statements.scatter * expected:
            far = control.names[rows[int(np.argmax(np.linalg.norm(off / sigma, axis=1)))]]
            said.append(
                f"{len(rows)} check points and the model differ by {actual:.3g} m (RMSE), predicted {expected:.2g} m, "
                f"most at {far!r}: their coordinates or the georeference are wrong by this amount"
            )
    return replace(found, control=replace(found.control, accuracy=accuracy)), said
