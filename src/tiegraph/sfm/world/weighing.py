"""The statements of each single source of a place in the world, and which sources are used if they contradict each
other.

Positions alone and control points alone give a similarity each, with a covariance; the rig or scale bars give the
scale, the cameras' upward direction the tilt, given orientations heading and tilt. Statements are relative to the
result: factor on the scale, rotation, and shift in metres.
"""

from collections.abc import Sequence
from dataclasses import dataclass, field, replace

import numpy as np
from scipy.spatial.transform import Rotation

from tiegraph.geometry.gravity import Up
from tiegraph.geometry.transforms import LEAST_PLACES, PlacementError, Similarity, rms_length
from tiegraph.scene.evidence import LIMIT, Statement, Trend, trend
from tiegraph.sfm.tuning.world import FitTuning, StatementTuning, WorldTuning
from tiegraph.sfm.world.fit import ANTENNA, Evidence, by_errors, fit_similarity
from tiegraph.sfm.world.fixes import Fixes, Measured
from tiegraph.sfm.world.positionerrors import MEDIAN_CHI2_3, Stated
from tiegraph.sfm.world.scale import BARS, RIG, LengthScale

POSITIONS = {"gnss": "GNSS positions", "exif": "EXIF positions", "trajectory": "trajectory positions"}
CONTROL, ORIENTATIONS = "control points", "given orientations"
SCALE, HEADING, TILTS = "scale", "heading", ("tilt towards north", "tilt towards east")
PLACES = ("place east", "place north", "height")
UNKNOWN = 1.0  # relative sigma of a scale that is not known at all
TWO_ENDS = LIMIT / np.sqrt(2)  # half a trend's size in sigmas of a position, from which its ends contradict each other


@dataclass(frozen=True)
class Source:
    """A similarity from one source; ``residual`` (K, 3) metres of its own fit."""

    name: str
    similarity: Similarity
    error: PlacementError
    residual: np.ndarray

    @property
    def scale_sigma(self) -> float:
        """Sigma of the logarithm of the scale."""
        return float(np.sqrt(self.error.covariance[6, 6]))

    def off(self, result: Similarity, at: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """(3,) metres from the place of a model point ``at`` (3,) by the result to that by this source, and its
        sigmas (3,)."""
        here = self.similarity(at[None])
        return (here - result(at[None]))[0], self.error.sigma(here)[0]

    def statements(
        self, result: Similarity, at: np.ndarray, used: Sequence[str], tuning: StatementTuning
    ) -> list[Statement]:
        """Its statements on scale, heading, tilt and place of a model point ``at`` (3,), relative to the result."""
        said = []
        if self.scale_sigma < tuning.told:
            said += _of_scale(self.name, self.similarity.scale / result.scale, self.scale_sigma, SCALE in used)
        turn = Rotation.from_matrix(self.similarity.rotation @ result.rotation.T)
        spread = np.degrees(np.sqrt(np.diag(self.error.covariance)[:3]))
        said += [s for s in _of_turn(self.name, turn, spread, used) if np.radians(s.sigma) < tuning.told]
        return said + [
            Statement(quantity=n, source=self.name, value=float(v), sigma=float(s), unit="m", used=n in used)
            for n, v, s in zip(PLACES, *self.off(result, at))
        ]


def _of_scale(source: str, ratio: float, sigma: float, used: bool) -> list[Statement]:
    return [Statement(quantity=SCALE, source=source, value=ratio, sigma=ratio * sigma, unit="", used=used)]


def _of_turn(source: str, turn: Rotation, sigma_deg: np.ndarray, used: Sequence[str]) -> list[Statement]:
    """Heading and tilt of a rotation from the result, sigmas (3,) about east, north and up."""
    off = np.degrees(turn.as_rotvec())
    return [
        Statement(
            quantity=name, source=source, value=float(sign * off[k]), sigma=float(sigma_deg[k]), unit="deg",
            used=name in used,
        )
        for name, k, sign in ((HEADING, 2, -1.0), (TILTS[0], 0, -1.0), (TILTS[1], 1, 1.0))
    ]  # fmt: skip


def length_statement(scale: LengthScale, result: Similarity, used: bool) -> list[Statement]:
    """The statement of known lengths, those of the rig or of scale bars, on the scale, if they determine it."""
    return [] if scale.why_not else _of_scale(scale.source, scale.metres_per_unit / result.scale, scale.sigma, used)


def up_statements(up: Up | None, result: Similarity, used: bool) -> list[Statement]:
    """The statement of a ring of cameras on the tilt. Cameras on one side give none unless they alone determine it:
    they may be held or mounted in any way, even upside down or looking straight down."""
    if up is None or not (up.ring or (used and up.tilt)):
        return []
    lean = result.rotation @ up.direction
    values = np.degrees([-np.arctan2(lean[1], lean[2]), -np.arctan2(lean[0], lean[2])])
    return [
        Statement(quantity=n, source=up.cameras, value=float(v), sigma=up.sigma_deg, unit="deg", used=used)
        for n, v in zip(TILTS, values)
    ]


def orientation_statements(evidence: Evidence, result: Similarity, tuning: FitTuning) -> list[Statement]:
    """The statements of given orientations on heading and tilt, relative to the result."""
    known = evidence.oriented
    if not known.any():
        return []
    model = result.rotation @ evidence.pose[known, :3, :3]
    turns = Rotation.from_matrix(evidence.orientation[known] @ np.swapaxes(model, 1, 2))
    mean = turns.mean()
    scatter = np.degrees(np.sqrt(np.mean((turns * mean.inv()).magnitude() ** 2)))
    sigma = np.hypot(tuning.common_deg, scatter / np.sqrt(known.sum()))
    return _of_turn(ORIENTATIONS, mean, np.full(3, sigma), (HEADING, *TILTS))


# --- which sources are used ------------------------------------------------------------------------------------------


@dataclass(frozen=True)
class Weighed:
    """The sources, and which of them are used."""

    sources: tuple[Source, ...]
    at: np.ndarray  # (3,) the model point at which places are compared
    name: str  # of the positions
    free_antenna: bool  # no lever arm was given
    scale_used: tuple[str, ...] = ()  # sources of the scale
    places_used: tuple[str, ...] = ()
    extra_m: np.ndarray = field(default_factory=lambda: np.zeros(3))  # added to the positions' sigmas
    scale_sigma: float = 0.0  # to which the sigma of the scale is increased
    why: str = ""  # how the scale was decided, in words

    @property
    def lengths_used(self) -> bool:
        """Whether the rig's baselines, or scale bars, may determine the scale."""
        return RIG in self.scale_used or BARS in self.scale_used


def weigh(measured: Measured, evidence: Evidence, fixes: Fixes, rows: Stated, free_antenna: bool) -> Weighed:
    """Compute each source alone, compare them, and decide which are used for scale and places.

    The first rows of the evidence are the fixes, which state the errors ``rows``. If positions (or control points)
    contradict a rig's baseline, it is not used if they fit without a trend of their own, because a wrong scale leaves a
    trend (scale bars are not overruled by one source alone). If nothing else decides, the sigma of the scale covers
    both. If positions and control points contradict each other, the control points are used.
    """
    tuning, name = measured.tuning, POSITIONS.get(measured.scene.prior, "positions")
    first, points = np.arange(len(evidence.frame)) < len(fixes), len(measured.points) > 0
    free = frozenset([ANTENNA] if free_antenna else [])
    own = _alone(name, evidence.alone(first, free), rows, tuning)
    marked = _alone(CONTROL, evidence.alone(~first, frozenset()), None, tuning)
    if points and marked is None:
        marked = _few(evidence.where(~first), own)
    sources = tuple(s for s in (own, marked) if s is not None)
    at = evidence.pose[~first if points else first, :3, 3].mean(axis=0)
    out = Weighed(sources, at, name, free_antenna=free_antenna, places_used=tuple(s.name for s in sources))
    out = _with_scale(out, measured, evidence, fixes)
    if own is None or marked is None:
        return out
    off, sigma = own.off(marked.similarity, at)
    bad = np.abs(off) > LIMIT * np.hypot(sigma, marked.off(marked.similarity, at)[1])
    bad[:2] |= bad[:2].any()
    places = (CONTROL,) if bad.any() else out.places_used
    return replace(out, places_used=places, extra_m=np.hypot(out.extra_m, np.where(bad, np.abs(off), 0.0)))


def _alone(name: str, own: Evidence, rows: Stated | None, tuning: WorldTuning) -> Source | None:
    """The similarity from positions or control points alone; None with too few of them.

    Positions are weighed by the errors that their residuals in this fit show, and by their common error
    (``positionerrors``); control points by their stated sigmas (``rows`` None).
    """
    if len(np.unique(own.pose[:, :3, 3].round(9), axis=0)) < LEAST_PLACES:
        return None
    own, sigma = replace(own, log_scale=None), own.sigma
    fit = fit_similarity(own, None, tuning.fit)
    for _ in range(2):  # its sigmas follow the scatter about its own fit
        off = fit.residuals(own) / sigma
        typical = float(np.sqrt(np.median(np.sum(off**2, axis=1)) / MEDIAN_CHI2_3))
        own = replace(own, sigma=sigma * max(1.0, typical))
        fit = fit_similarity(own, None, tuning.fit, fit.similarity)
    fit = fit if rows is None else by_errors(own, None, fit, rows, tuning)
    return Source(name, fit.similarity, fit.error, residual=fit.residuals(own))


def _few(own: Evidence, positions: Source | None) -> Source | None:
    """One or two control points: they give the position of the positions' world, but no rotation or scale."""
    if positions is None:
        return None
    there, middle = positions.similarity, own.position.mean(axis=0)
    moved = middle - there(own.pose[:, :3, 3]).mean(axis=0)
    variance = np.mean(own.sigma**2, axis=0) / len(own.sigma)
    error = PlacementError(middle, np.diag([10.0, 10.0, 10.0, *variance, 100.0]))
    shifted = Similarity(there.scale, there.rotation, there.translation + moved)
    return Source(CONTROL, shifted, error, residual=np.zeros_like(own.position))


def _with_scale(out: Weighed, measured: Measured, evidence: Evidence, fixes: Fixes) -> Weighed:
    """Which sources determine the scale: the majority against one; of two, the one whose residuals have no trend."""
    told = {s.name: s for s in out.sources if s.scale_sigma < UNKNOWN}
    names, own = tuple(told), fixes.position
    spread_m = rms_length(own - own.mean(axis=0)) if len(own) else 0.0

    def ends_m(apart: float) -> np.ndarray:
        """(3,) metres by which this error of the scale (logarithm) moves the positions (root mean square)."""
        return apart * spread_m * np.ones(3)

    lengths = measured.length_scale
    against = {} if lengths is None else {
        n: apart for n, s in told.items()
        if (apart := abs(float(np.log(s.similarity.scale / lengths.metres_per_unit))))
        > LIMIT * np.hypot(s.scale_sigma, lengths.sigma)
    }  # fmt: skip
    if lengths is None or not against:
        names += () if lengths is None else (lengths.source,)
        if out.name in told and CONTROL in told:
            a, b = told[out.name], told[CONTROL]
            apart = abs(float(np.log(a.similarity.scale / b.similarity.scale)))
            if apart > LIMIT * np.hypot(a.scale_sigma, b.scale_sigma):
                names, why = tuple(n for n in names if n != out.name), f"that of the {CONTROL} is used"
                return replace(out, scale_used=names, extra_m=ends_m(apart), why=why)
        return replace(out, scale_used=names)
    agreeing = tuple(n for n in told if n not in against)
    if agreeing and out.name in against:
        why = f"{out.name} contradict the others and are not used for it"
        return replace(out, scale_used=(lengths.source, *agreeing), extra_m=ends_m(against[out.name]), why=why)
    if agreeing or len(against) > 1:
        verbs = ("contradicts", "is") if lengths.source == RIG else ("contradict", "are")
        why = f"the {lengths.source} {verbs[0]} the others and {verbs[1]} not used for it"
        return replace(out, scale_used=names, why=why)
    ((name, apart),) = against.items()  # one against one: the sigma of the scale covers both
    covering = replace(out, scale_used=(lengths.source,), scale_sigma=apart, extra_m=ends_m(apart))
    if lengths.source == BARS:  # they were measured for the scale alone
        return replace(covering, why=f"that of the {BARS} is used")
    drift = _own_trend(measured, evidence, fixes, told[name]) if name == out.name else None
    if drift is not None:
        why = f"the residuals of the {name} {drift.text()} even in a fit of their own, so that of the rig is used"
        return replace(covering, why=why)
    fits = float(np.median(np.linalg.norm(told[name].residual, axis=1)))
    why = f"without the rig's scale they fit to {fits:.2g} m (median), so that of the {name} is used"
    return replace(out, scale_used=(name,), scale_sigma=apart, why=why)


def _own_trend(measured: Measured, evidence: Evidence, fixes: Fixes, source: Source) -> Trend | None:
    """A trend in the residuals of positions to their own fit that exceeds their stated errors."""
    order = measured.time_order(fixes)
    residual, sigma = source.residual[order], evidence.sigma[: len(fixes)][order]
    found = [trend(residual[:, k], 3, sigma=sigma[:, k]) for k in range(3)]
    beyond = [t for t in found if t is not None and t.sigmas > TWO_ENDS]
    return max(beyond, key=lambda t: t.size) if beyond else None
