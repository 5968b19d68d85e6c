"""The statements of a georeference: the table of evidence, and each contradiction in one sentence."""

from dataclasses import replace
from itertools import combinations

import numpy as np

from tiegraph.geometry.align import rms_length
from tiegraph.geometry.gravity import Up
from tiegraph.scene.evidence import LIMIT, Contradiction, Statement, contradictions, trend
from tiegraph.scene.scene import Scene
from tiegraph.sfm.shape import Shape
from tiegraph.sfm.world.georef import Findings, Georeference
from tiegraph.sfm.world.marks import Target
from tiegraph.sfm.world.scale import RIG
from tiegraph.sfm.world.similarityfit import time_order
from tiegraph.sfm.world.sources import (
    CONTROL,
    ORIENTATIONS,
    SCALE,
    orientation_statements,
    rig_statement,
    up_statements,
)  # fmt: skip
from tiegraph.sfm.world.weighing import TWO_ENDS

_AXES = ("east", "north", "up")
_ALONG = "along the motion"


def with_statements(found: Georeference, scene: Scene, targets: list[Target]) -> Georeference:
    """The georeference with its statements and contradictions; sigmas are increased where a contradiction requires
    it.

    ``targets``: the control points in its world.
    """
    if found.placing is None:
        return found
    model_sigma_m = 0.0 if found.uncertainty.shape is None else found.uncertainty.shape.sizes()["median"]
    said = statements(found)
    worst = _of_quantities(contradictions(said))
    if found.placing.weighed.why and not any(c.first.quantity == SCALE for c in worst):
        worst = [*worst, *_decided(said)]
    sentences = [c.text(_culprit(c, said, found)) for c in worst]
    sentences += [found.placing.weighed.doubt] if found.placing.weighed.doubt else []
    known = found.uncertainty
    sigma = dict(known.sigma)
    wide = found.placing.weighed.scale_sigma
    if wide:
        sigma["scale"] = round(max(sigma["scale"], wide), 6)
        sentences = [f"{t}; the scale is stated to {wide:.1%}" if t.startswith(SCALE) else t for t in sentences]
    scale_said = any(c.first.quantity == SCALE for c in worst)
    forms = _trends(found, scene, model_sigma_m, scale_said)
    for axis, size, text in forms:
        key = "height_m" if axis == "up" else "position_m"
        sigma[key] = round(max(sigma[key], size / 2), 6)
        if axis == _ALONG:
            sigma["scale"] = round(max(sigma["scale"], size / _length(found)), 6)
        sentences.append(text)
    sentences += _levels(found, bool(forms))
    sentences += _control(found, targets)
    error = known.error.widened_to(sigma) if known.error is not None else None
    if known.shape is not None:  # heading and tilt are stated for the images, not for their positions alone
        yaw, tilt = np.degrees(np.sqrt(_turned(known.shape, found.placing.up)))
        sigma["yaw_deg"] = round(float(np.hypot(sigma["yaw_deg"], yaw)), 6)
        sigma["tilt_deg"] = round(float(np.hypot(sigma["tilt_deg"], tilt)), 6)
    found = _with_predicted(
        replace(found, uncertainty=replace(known, sigma=sigma, error=error)), model_sigma_m, targets
    )
    sentences += _check_points(found, model_sigma_m, targets)
    bars = found.placing.model.bars if found.placing is not None else None
    sentences += bars.told(found.control.bars, sigma["scale"]) if bars is not None else ()
    findings = Findings(
        notes=(*found.findings.notes, *_rests_on(found, scene)),
        statements=tuple(said),
        contradictions=tuple(sentences),
    )
    return replace(found, findings=findings)


def _turned(shape: Shape, up: Up | None) -> tuple[float, float]:
    """Variances, rad squared, of heading and tilt of the images relative to their positions, if these determine them:
    an upward direction is that of the images, and determines the tilt or, for cameras on one side, the roll about the
    track."""
    track = np.linalg.svd(shape.place - shape.place.mean(axis=0), full_matrices=False)[2][0]
    across = np.array([-track[1], track[0], 0.0]) / max(float(np.hypot(*track[:2])), 1e-12)
    tilt = across @ shape.turn @ across if up is not None else shape.turn[0, 0] + shape.turn[1, 1]
    return float(shape.turn[2, 2]), 0.0 if up is not None and up.tilt else float(tilt)


def statements(found: Georeference) -> list[Statement]:
    """The statements of each source, relative to the result."""
    placing = found.placing
    assert placing is not None
    weighed, result = placing.weighed, found.world_from_model
    out = []
    for source in weighed.sources:
        used = [SCALE] if source.name in weighed.scale_used else []
        if source.name in weighed.places_used:
            used += ["heading", "tilt towards north", "tilt towards east", "place east", "place north", "height"]
        said = source.statements(result, weighed.at, used, placing.tuning.sources)
        out += [s for s in said if placing.up is None or source.name == CONTROL or not s.quantity.startswith("tilt")]
    out += rig_statement(placing.model.scale, result, weighed.lengths_used and placing.evidence.log_scale is not None)
    out += rig_statement(placing.model.rig, result, False)
    out += up_statements(placing.model.up, result, placing.up is not None)
    out += orientation_statements(placing.evidence, result, placing.tuning.sources)
    if np.isfinite(placing.fit.clock.sigma_s):
        out.append(
            Statement(
                quantity="clock",
                source="images and positions",
                value=placing.fit.clock.offset_s,
                sigma=placing.fit.clock.sigma_s,
                unit="s",
                used=bool(found.receiver.offset_s),
            )
        )
    return out


def _of_quantities(found: list[Contradiction]) -> list[Contradiction]:
    """The worst contradiction of each quantity."""
    out: dict[str, Contradiction] = {}
    for c in found:
        out.setdefault(c.first.quantity, c)
    return list(out.values())


def _decided(said: list[Statement]) -> list[Contradiction]:
    """The contradiction of the scale, if it was decided between sources although the result reduces their difference
    a little."""
    rows = [s for s in said if s.quantity == SCALE]
    pairs = [(abs(a.value - b.value) / np.hypot(a.sigma, b.sigma), a, b) for a, b in combinations(rows, 2)]
    return [Contradiction(a, b, float(s)) for s, a, b in sorted(pairs, key=lambda p: -p[0])[:1]]


def _culprit(c: Contradiction, said: list[Statement], found: Georeference) -> str:
    """The likely cause, in words."""
    assert found.placing is not None
    names = {c.first.source, c.second.source}
    if c.first.quantity == SCALE:
        why = found.placing.weighed.why
        hint = (
            ("do its cameras fire at different times, or is a baseline wrong")
            if RIG in names
            else "another unit or projection"
        )
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
    if CONTROL in names and not names & {ORIENTATIONS}:
        return f"another datum, or points of another survey? the {CONTROL} are used"
    if ORIENTATIONS in names:
        return "are the axes of the given orientations those of the rig?"
    return "the table of evidence shows which is used"


def _trends(found: Georeference, scene: Scene, model_sigma_m: float, scale_said: bool) -> list[tuple[str, float, str]]:
    """(axis, size, sentence) of systematic residuals that exceed the errors of two positions and of the model."""
    placing = found.placing
    assert placing is not None
    fixes = placing.fixes
    if not len(fixes):
        return []
    order = np.argsort(time_order(scene, fixes), kind="stable")
    sigma = np.hypot(fixes.sigma[order], model_sigma_m)
    residual = found.residuals.fixes_m[order]
    way = _directions(fixes.position[order] + residual)
    series = [(a, residual[:, k], sigma[:, k]) for k, a in enumerate(_AXES)]
    series.append((_ALONG, np.sum(residual * way, axis=1), sigma[:, :2].max(axis=1)))
    anywhere = placing.weighed.free_antenna and not placing.fit.arm.place.any()  # on the vehicle
    out = []
    for axis, values, each in series:
        form = trend(values, placing.tuning.trend, len(series), offset=axis == _ALONG, sigma=each)
        if form is None or (scale_said and form.form == "line"):
            continue
        stated = form.size / 2 / form.sigmas
        known_to = np.hypot(stated, placing.tuning.fit.antenna_sigma_m if form.form == "offset" and anywhere else 0.0)
        if form.size / 2 > TWO_ENDS * known_to:
            out.append((axis, form.size, _trend_text(axis, form.text(), form.form, stated, found)))
    return sorted(out, key=lambda t: -t[1])[:1]  # one cause appears on several axes


def _directions(place: np.ndarray) -> np.ndarray:
    """(K, 3) unit vectors of the motion in plan at places (K, 3) in order."""
    if len(place) < 3:
        return np.zeros_like(place)
    way = np.gradient(place, axis=0)
    way[:, 2] = 0
    return way / np.maximum(np.linalg.norm(way, axis=1, keepdims=True), 1e-9)


def _length(found: Georeference) -> float:
    """Length of the path of the positions, end to end, metres."""
    assert found.placing is not None
    own = found.placing.fixes.position
    return max(float(np.linalg.norm(np.ptp(own, axis=0))), 1e-9)


def _rests_on(found: Georeference, scene: Scene) -> list[str]:
    """What determines the scale where the rig does, and what checks it: the images themselves cannot."""
    placing = found.placing
    assert placing is not None
    rig = placing.model.scale
    if rig is None or not placing.weighed.lengths_used:
        return []
    most = placing.tuning.sources.told_scale
    told = [s for s in placing.weighed.sources if np.isfinite(s.scale_sigma) and s.scale_sigma < most]
    checked = " and ".join(f"the {s.name} determine it to {s.scale_sigma:.1%}" for s in told)
    levers = ", ".join(s.name for r in scene.rigs if not r.nominal for s in r.sensors[1:])
    on = f"lever arms of the rig as given ({levers})" if rig.source == RIG else rig.source
    return [f"the scale comes from the {on}, with a sigma of {rig.sigma:.1%}; {checked or 'nothing else checks it'}"]


def _trend_text(axis: str, text: str, form: str, sigma: float, found: Georeference) -> str:
    where = axis if axis == _ALONG else f"towards {axis}" if axis != "up" else "in height"
    assert found.placing is not None
    lengths = found.placing.model.scale if found.placing.weighed.lengths_used else None
    holds = "something else" if lengths is None else f"the {lengths.source}"
    causes = {
        "line": f"positions that drift, or a scale that is determined by {holds}",
        "curve": "a model that bends, or positions that drift",
        "offset": "wrong times of the positions, or an antenna ahead of or behind the cameras",
        "step": "positions that jump (a receiver that lost and found its fix, another base), or a torn model",
    }
    kept = "" if found.adjusted else "; the model was not bent to them"
    return (
        f"positions and model: the residuals {text} {where}, which is not noise for a stated sigma of {sigma:.2g} m. "
        f"Possible causes: {causes[form]}{kept}"
    )


def _levels(found: Georeference, explained: bool) -> list[str]:
    """Positions whose scatter far exceeds their stated sigma."""
    placing = found.placing
    assert placing is not None
    tuning, out = placing.tuning, []
    for sigma_m, factor, count in placing.fit.levels:
        name = placing.weighed.name
        if factor > tuning.statements.scatter and count >= tuning.noise.min_rows and not explained:
            out.append(
                f"{name} of stated sigma {sigma_m:.2f} m scatter {factor:.1f} times as much ({count} of them); their "
                "sigma was increased accordingly. Possible causes: a receiver with optimistic sigmas, or an unknown "
                "lever arm or clock offset"
            )
    used = int(found.residuals.inlier.sum())
    total = int(np.isfinite(found.residuals.frames_m).all(axis=1).sum())
    if total >= tuning.statements.least_positions and used < tuning.statements.agreeing * total:
        out.append(
            f"only {used} of {total} positions agree with the model within three sigmas: the model is bent or torn, or "
            "the positions are of another survey"
        )
    return out


def _control(found: Georeference, targets: list[Target]) -> list[str]:
    """Control points that contradict the others, and those that contradict each other without a single wrong one."""
    placing, given = found.placing, found.control.given
    assert placing is not None
    out = [f"control point {r['name']!r} is not used: {r['why_not']}" for r in found.control.rows if r["blunder"]]
    if given is None or not len(placing.points):
        return out
    spread = np.array([np.trace(targets[k].covariance) / 3 for k in placing.points])
    stated = np.sqrt(given.sigma_m[placing.points] ** 2 + spread[:, None])
    factor = float(np.median(placing.evidence.sigma[len(placing.fixes) :] / stated))
    if factor > placing.tuning.statements.scatter:
        out.append(
            f"{len(stated)} control points contradict each other: they scatter {factor:.1f} times their sigma of "
            f"{np.median(given.sigma_m[placing.points]):.2g} m, and no single one of them is the cause"
        )
    return out


def _check_points(found: Georeference, model_sigma_m: float, targets: list[Target]) -> list[str]:
    """Check points whose error far exceeds the predicted one."""
    given, placing = found.control.given, found.placing
    assert placing is not None
    rows, predicted = _points_known(found, "check", model_sigma_m, targets)
    if not len(predicted) or given is None:
        return []
    off = np.array([found.control.rows[k]["off_m"] for k in rows], float)
    actual, expected = rms_length(off), rms_length(predicted)
    if actual <= placing.tuning.statements.scatter * expected:
        return []
    far = given.names[rows[int(np.argmax(np.linalg.norm(off / predicted, axis=1)))]]
    return [
        f"{len(rows)} check points and the model differ by {actual:.3g} m (RMSE), predicted {expected:.2g} m, most at "
        f"{far!r}: their coordinates or the georeference are wrong by this amount"
    ]


def _with_predicted(found: Georeference, model_sigma_m: float, targets: list[Target]) -> Georeference:
    """The accuracies of control and check points with the predicted size of their differences (``predicted_m``)."""
    accuracy = {}
    for role, values in found.control.accuracy.items():
        known = _points_known(found, role, model_sigma_m, targets)[1]
        more = {"predicted_m": round(rms_length(known), 4)} if len(known) else {}
        accuracy[role] = {**values, **more}
    return replace(found, control=replace(found.control, accuracy=accuracy))


def _points_known(
    found: Georeference, role: str, model_sigma_m: float, targets: list[Target]
) -> tuple[list[int], np.ndarray]:
    """Rows of the used points of a role, and sigmas (P, 3) of model minus survey; none if the model is not placed."""
    rows = [k for k, r in enumerate(found.control.rows) if r["role"] == role and r["off_m"] and not r["why_not"]]
    given, error = found.control.given, found.uncertainty.error
    if not rows or given is None or error is None:
        return rows, np.zeros((0, 3))
    spread = np.array([np.diag(targets[k].covariance) for k in rows])
    known = error.sigma(given.world_m[rows])
    return rows, np.sqrt(given.sigma_m[rows] ** 2 + spread + known**2 + model_sigma_m**2)
