"""Which sources a georeference uses if they contradict each other: decided by tests before the fit."""

from dataclasses import dataclass

import numpy as np

from tiegraph.geometry.align import Similarity, rms_length
from tiegraph.scene.evidence import LIMIT, Trend, trend
from tiegraph.sfm.tuning.world import SourceTuning, WorldTuning
from tiegraph.sfm.world.fit import Evidence
from tiegraph.sfm.world.positionerrors import Stated
from tiegraph.sfm.world.scale import BARS, RIG, RigScale
from tiegraph.sfm.world.sources import CONTROL, Source, alone

TWO_ENDS = LIMIT / np.sqrt(2)  # half a trend's size in sigmas of a position, from which its ends contradict each other


@dataclass(frozen=True)
class EvidenceWeights:
    """The sources, which are used and why. ``scale_used``: sources of the scale; ``extra_m`` (3,): added to the
    positions' sigmas because another source contradicts them; ``scale_sigma``: the sigma to which that of the scale
    is increased, 0 = not at all; ``at`` (3,): the model point at which places are compared; ``why``: how the scale
    was decided, in words; ``free_antenna``: no lever arm was given; ``name`` of the positions; ``doubt``: a possible
    error that remains, "" = none."""

    sources: tuple[Source, ...]
    scale_used: tuple[str, ...]
    places_used: tuple[str, ...]
    extra_m: np.ndarray
    scale_sigma: float
    at: np.ndarray
    why: str = ""
    free_antenna: bool = False
    name: str = "positions"
    doubt: str = ""

    @property
    def lengths_used(self) -> bool:
        """Whether the rig's baselines, or scale bars, may determine the scale."""
        return RIG in self.scale_used or BARS in self.scale_used


@dataclass(frozen=True)
class Question:
    """The question to decide: ``count`` fixes before the control points in the evidence, their times (K,) or order,
    the positions' name, their ``stated`` errors, the scale from known lengths, and whether the lever arm is unknown."""

    evidence: Evidence
    count: int
    times: np.ndarray
    name: str
    stated: Stated
    scale: RigScale | None
    tuning: WorldTuning
    free_antenna: bool = False


def weigh(asked: Question) -> EvidenceWeights:
    """Compute each source alone, compare them, and decide which are used for scale and places.

    If positions (or control points) contradict a rig's baseline, it is not used if they fit without a trend of their
    own, because a wrong scale leaves a trend (scale bars are not overruled by one source alone). If nothing else
    decides, the sigma of the scale covers both. If positions and control points contradict each other, the control
    points are used.
    """
    evidence, tuning = asked.evidence, asked.tuning
    rows = np.arange(len(evidence.frame)) < asked.count
    sources = []
    if asked.count:
        sources.append(alone(evidence, rows, asked.name, asked.stated, tuning, asked.free_antenna))
    points = int((~rows).sum())
    if points:
        own = alone(evidence, ~rows, CONTROL, None, tuning)
        sources.append(own or _few(evidence, rows, sources[0] if sources else None))
    found = {s.name: s for s in sources if s is not None}
    at = evidence.pose[~rows if points else rows, :3, 3].mean(axis=0)
    scale = _scale(asked, found)
    places, more = _places(found, at, asked.name, tuning.sources)
    return EvidenceWeights(
        sources=tuple(found.values()),
        scale_used=scale.used,
        places_used=places,
        extra_m=np.hypot(scale.extra_m, more),
        scale_sigma=scale.sigma,
        at=at,
        why=scale.why,
        free_antenna=asked.free_antenna,
        name=asked.name,
    )


def _few(evidence: Evidence, rows: np.ndarray, positions: Source | None) -> Source | None:
    """One or two control points: they give the position of the positions' world, but no rotation or scale."""
    if positions is None:
        return None
    own = evidence.where(~rows)
    world = positions.similarity(own.pose[:, :3, 3])
    moved = own.position.mean(axis=0) - world.mean(axis=0)
    shift = positions.similarity
    shift = Similarity(shift.scale, shift.rotation, shift.translation + moved)
    variance = np.mean(own.sigma**2, axis=0) / len(own.sigma)
    covariance = np.diag([10.0, 10.0, 10.0, *variance, 100.0])
    return Source(
        name=CONTROL,
        similarity=shift,
        covariance=covariance,
        middle=own.position.mean(axis=0),
        residual=np.zeros_like(own.position),
    )


@dataclass(frozen=True)
class _Scale:
    """Sources of the scale that are used, the sigma to which it is increased, the addition to positions (3,) m, and
    why."""

    used: tuple[str, ...]
    sigma: float
    extra_m: np.ndarray
    why: str


def _scale(asked: Question, found: dict[str, Source]) -> _Scale:
    """Which sources determine the scale: the majority against one; of two, the one whose residuals have no trend."""
    most = asked.tuning.sources.any_scale
    told = {n: s for n, s in found.items() if np.isfinite(s.scale_sigma) and s.scale_sigma < most}
    lengths = asked.scale if asked.scale is not None and asked.scale.trusted else None
    if lengths is None:
        return _without_contradiction(asked, told, tuple(told))
    against = _against(lengths, told)
    if not against:
        return _without_contradiction(asked, told, (*told, lengths.source))
    agreeing = tuple(n for n in told if n not in against)
    if agreeing and asked.name in against:
        # The positions contradict the lengths, and another source agrees with the positions
        why = f"{asked.name} contradict the others and are not used for it"
        return _Scale((lengths.source, *agreeing), 0.0, _at_the_ends(asked, against[asked.name]), why=why)
    if agreeing or len(against) > 1:
        return _lengths_alone(lengths, tuple(told))
    ((name, apart),) = against.items()
    return _one_against_one(asked, lengths, told[name], apart)


def _against(lengths: RigScale, told: dict[str, Source]) -> dict[str, float]:
    """Sources whose scale contradicts that of known lengths: name -> difference of logarithms."""
    apart = {n: abs(np.log(s.similarity.scale / lengths.metres_per_unit)) for n, s in told.items()}
    return {n: float(a) for n, a in apart.items() if a > LIMIT * np.hypot(told[n].scale_sigma, lengths.sigma)}


def _without_contradiction(asked: Question, told: dict[str, Source], names: tuple[str, ...]) -> _Scale:
    """Without contradiction to known lengths, or without known lengths: positions against control points."""
    if asked.name in told and CONTROL in told:
        a, b = told[asked.name], told[CONTROL]
        apart = abs(float(np.log(a.similarity.scale / b.similarity.scale)))
        if apart > LIMIT * np.hypot(a.scale_sigma, b.scale_sigma):
            names = tuple(n for n in names if n != asked.name)
            return _Scale(names, 0.0, _at_the_ends(asked, apart), why=f"that of the {CONTROL} is used")
    return _Scale(names, 0.0, np.zeros(3), why="")


def _lengths_alone(lengths: RigScale, told: tuple[str, ...]) -> _Scale:
    """Sources other than the positions contradict the lengths, or all do."""
    verbs = ("contradicts", "is") if lengths.source == RIG else ("contradict", "are")
    why = f"the {lengths.source} {verbs[0]} the others and {verbs[1]} not used for it"
    return _Scale(told, 0.0, np.zeros(3), why=why)


def _one_against_one(asked: Question, lengths: RigScale, other: Source, apart: float) -> _Scale:
    """Nothing else decides: the sigma of the scale covers both."""
    if lengths.source == BARS:  # they were measured for the scale alone
        return _Scale((BARS,), apart, _at_the_ends(asked, apart), why=f"that of the {BARS} is used")
    own = _own_trend(asked, other) if other.name == asked.name else None
    if own is not None:
        why = f"the residuals of the {other.name} {own.text()} even in a fit of their own, so that of the rig is used"
        return _Scale((RIG,), apart, _at_the_ends(asked, apart), why=why)
    fits = float(np.median(np.linalg.norm(other.residual, axis=1)))
    why = f"without the rig's scale they fit to {fits:.2g} m (median), so that of the {other.name} is used"
    return _Scale((other.name,), apart, np.zeros(3), why=why)


def _places(
    found: dict[str, Source], at: np.ndarray, name: str, tuning: SourceTuning
) -> tuple[tuple[str, ...], np.ndarray]:
    """The sources whose places are used, and the addition to the positions' sigmas (3,)."""
    if name not in found or CONTROL not in found:
        return tuple(found), np.zeros(3)
    a = found[name].statements(found[CONTROL].similarity, at, (), tuning)[-3:]
    b = found[CONTROL].statements(found[CONTROL].similarity, at, (), tuning)[-3:]
    off = np.array([s.value for s in a])
    bad = np.abs(off) > LIMIT * np.hypot([s.sigma for s in a], [s.sigma for s in b])
    bad[:2] |= bad[:2].any()
    return (CONTROL,) if bad.any() else tuple(found), np.where(bad, np.abs(off), 0.0)


def _at_the_ends(asked: Question, apart: float) -> np.ndarray:
    """(3,) m movement of positions by this error of the scale (logarithm) (root mean square)."""
    return apart * _spread(asked) * np.ones(3)


def _spread(asked: Question) -> float:
    own = asked.evidence.position[: asked.count]
    return rms_length(own - own.mean(axis=0)) if len(own) else float("nan")


def _own_trend(asked: Question, source: Source) -> Trend | None:
    """A trend in the residuals of positions to their own fit that exceeds their stated errors."""
    order = np.argsort(asked.times[: len(source.residual)], kind="stable")
    sigma = asked.evidence.sigma[: len(order)][order]
    found = [trend(source.residual[order, k], asked.tuning.trend, 3, sigma=sigma[:, k]) for k in range(3)]
    beyond = [t for t in found if t is not None and t.sigmas > TWO_ENDS]
    return max(beyond, key=lambda t: t.size) if beyond else None
