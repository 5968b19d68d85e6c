"""What each source of a placement says by itself: positions alone, control points alone, the rig, the cameras' tops.

A source is a similarity of its own with a covariance. Its statements are read against the result: how many times the
result's scale, by how much turned, by how many metres elsewhere.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from tiegraph.geometry.align import Similarity
from tiegraph.geometry.gravity import Up
from tiegraph.geometry.placement import PlacementError
from tiegraph.scene.evidence import Statement
from tiegraph.sfm.tuning.world import NoiseTuning, SourceTuning, WorldTuning
from tiegraph.sfm.world import noise
from tiegraph.sfm.world.fit import Evidence, Fit, fit_similarity
from tiegraph.sfm.world.scale import RigScale

POSITIONS = {"gnss": "GNSS positions", "exif": "EXIF positions", "trajectory": "trajectory positions"}
CONTROL, ORIENTATIONS = "control points", "given orientations"
SCALE, HEADING, TILTS = "scale", "heading", ("tilt towards north", "tilt towards east")
PLACES = ("place east", "place north", "height")
_THREE = 3  # places, for a similarity


@dataclass(frozen=True)
class Source:
    """A placement by one source. ``covariance`` (7, 7) of turn, shift and log scale about ``middle`` (world);
    ``common_m`` (3,): errors of its places that all of them share; ``residual`` (K, 3) metres of its own fit."""

    name: str
    similarity: Similarity
    covariance: np.ndarray
    middle: np.ndarray
    common_m: np.ndarray
    residual: np.ndarray

    @property
    def scale_sigma(self) -> float:
        """Of the logarithm of the scale."""
        return float(np.sqrt(self.covariance[6, 6]))

    def statements(
        self, result: Similarity, at: np.ndarray, used: Sequence[str], tuning: SourceTuning
    ) -> list[Statement]:
        """What it says of scale, heading, tilt and place of a model point ``at`` (3,), against the result."""
        turn = np.degrees(Rotation.from_matrix(self.similarity.rotation @ result.rotation.T).as_rotvec())
        spread = np.degrees(np.sqrt(np.diag(self.covariance)[:3]))
        here = self.similarity(at[None])
        off = (here - result(at[None]))[0]
        place = np.hypot(PlacementError(self.middle, self.covariance).sigma(here)[0], self.common_m)
        out = []
        if self.scale_sigma < tuning.told_scale:
            ratio = self.similarity.scale / result.scale
            out.append(
                Statement(
                    quantity=SCALE,
                    source=self.name,
                    value=ratio,
                    sigma=ratio * self.scale_sigma,
                    unit="",
                    used=SCALE in used,
                )
            )
        names = ((HEADING, 2, -1.0), (TILTS[0], 0, -1.0), (TILTS[1], 1, 1.0))
        for name, k, sign in names:
            if spread[k] < tuning.told_deg:
                out.append(
                    Statement(
                        quantity=name,
                        source=self.name,
                        value=float(sign * turn[k]),
                        sigma=float(spread[k]),
                        unit="deg",
                        used=name in used,
                    )
                )
        out += [
            Statement(quantity=n, source=self.name, value=float(v), sigma=float(s), unit="m", used=n in used)
            for n, v, s in zip(PLACES, off, place)
        ]
        return out


def alone(
    evidence: Evidence,
    rows: np.ndarray,
    name: str,
    times: np.ndarray,
    common: np.ndarray,
    tuning: WorldTuning,
    free_antenna: bool = False,
) -> Source | None:
    """The placement by some rows (K,) bool of the evidence alone; None with fewer than three of them.

    Sigmas follow the scatter about this very fit and its correlation in time (what is stated of a receiver holds for
    its places on the Earth, not from one to the next); ``common`` (4,): what the places share, east, north, up (m), and
    what slow errors leave between the ends of the survey (m); ``free_antenna``: the lever arm may be anything.
    """
    own = evidence.where(rows)
    if len(np.unique(own.pose[:, :3, 3].round(9), axis=0)) < _THREE:
        return None
    own = replace(own, log_scale=None).with_arm(free_antenna).without_orientations()
    fit = fit_similarity(own, None, tuning.fit)
    for _ in range(tuning.sources.rounds):
        off = own.position_residuals(fit.similarity, fit.arm.place)
        scatter = _scatter(off / evidence.sigma[rows], times, tuning.noise, tuning.sources.least)
        own = replace(own, sigma=evidence.sigma[rows] * scatter)
        fit = fit_similarity(own, None, tuning.fit, fit.similarity)
    off = own.position_residuals(fit.similarity, fit.arm.place)
    return Source(
        name=name,
        similarity=fit.similarity,
        covariance=_with_slow(fit, own, float(common[3])),
        middle=fit.error.middle,
        common_m=common[:3],
        residual=off,
    )


def _scatter(residual: np.ndarray, times: np.ndarray, tuning: NoiseTuning, least: float) -> float:
    """By how much residuals over sigma (K, 3) are larger or smaller than said, with their correlation."""
    count = len(residual)
    free = 3 * count - 7
    if free < count:  # three or four: they meet whatever they are
        return 1.0
    typical = float(np.median(np.sum(residual**2, axis=1))) / noise.MEDIAN_CHI2_3 * 3 * count / free
    r = noise.correlation(residual, times, tuning)
    scatter = float(np.sqrt(typical * (1 + r) / (1 - r)))
    few = np.sqrt(2 / free)  # a scatter of few may be small by chance
    told = np.isfinite(times).sum() >= tuning.min_rows
    return max(scatter * (1 + float(few)), least) if told else max(scatter, 1.0)


def _with_slow(fit: Fit, own: Evidence, slow_m: float) -> np.ndarray:
    """The fit's covariance, and on its diagonal what an error of ``slow_m`` from end to end turns and stretches."""
    out = fit.error.covariance.copy()
    out[range(7), range(7)] = np.maximum(np.diag(out), 1e-18)
    off = own.position - own.position.mean(axis=0)
    east, north, up = np.mean(off**2, axis=0)
    shares = (north + up, east + up, east + north, np.inf, np.inf, np.inf, east + north + up)
    slow = np.array([slow_m**2 / max(v, 1e-12) for v in shares])
    limit = np.array([np.pi**2] * 3 + [1.0] * 3 + [1.0])
    out[range(7), range(7)] += np.minimum(slow, limit)
    return out


def common_of(sigma: np.ndarray, floor_m: float, antenna_m: float) -> np.ndarray:
    """(4,) what positions share: their stated sigma (median over (K, 3)), where no lever arm is known its size
    (``antenna_m``); and the sigma between far ends that the settings believe of no receiver."""
    stated = np.median(sigma, axis=0)
    return np.append(np.hypot(stated, antenna_m), floor_m)


def rig_statement(scale: RigScale | None, result: Similarity, used: bool) -> list[Statement]:
    """Known lengths, those of the rig or of scale bars, of the scale, where they tell it."""
    if scale is None or not scale.trusted:
        return []
    ratio = scale.metres_per_unit / result.scale
    return [Statement(quantity=SCALE, source=scale.source, value=ratio, sigma=ratio * scale.sigma, unit="", used=used)]


def up_statements(up: Up | None, result: Similarity, used: bool) -> list[Statement]:
    """What a ring of cameras says of the tilt. Those to one side say nothing unless they are needed for all of it: they
    may be held or mounted anyhow, upside down or looking straight down too."""
    if up is None or not (up.ring or (used and up.tilt)):
        return []
    lean = result.rotation @ up.direction
    values = np.degrees([-np.arctan2(lean[1], lean[2]), -np.arctan2(lean[0], lean[2])])
    return [
        Statement(quantity=n, source=up.cameras, value=float(v), sigma=up.sigma_deg, unit="deg", used=used)
        for n, v in zip(TILTS, values)
    ]


def orientation_statements(evidence: Evidence, result: Similarity, tuning: SourceTuning) -> list[Statement]:
    """Given orientations of heading and tilt, against the result."""
    known = np.isfinite(evidence.orientation).all(axis=(1, 2))
    if not known.any():
        return []
    model = result.rotation @ evidence.pose[known, :3, :3]
    turns = Rotation.from_matrix(evidence.orientation[known] @ np.swapaxes(model, 1, 2))
    mean = turns.mean()
    turn = np.degrees(mean.as_rotvec())
    scatter = np.degrees(np.sqrt(np.mean((turns * mean.inv()).magnitude() ** 2)))
    sigma = float(np.hypot(tuning.common_deg, scatter / np.sqrt(known.sum())))
    names = ((HEADING, 2, -1.0), (TILTS[0], 0, -1.0), (TILTS[1], 1, 1.0))
    return [
        Statement(quantity=n, source=ORIENTATIONS, value=float(s * turn[k]), sigma=sigma, unit="deg", used=True)
        for n, k, s in names
    ]
