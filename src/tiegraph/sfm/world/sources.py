"""The statements of each single source: positions alone, control points alone, the rig, the cameras' upward
direction.

Each source gives its own similarity with a covariance. Its statements are relative to the result: factor on the
scale, rotation, and shift in metres.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace

import numpy as np
from scipy.spatial.transform import Rotation

from tiegraph.geometry.align import PlacementError, Similarity
from tiegraph.geometry.gravity import Up
from tiegraph.scene.evidence import Statement
from tiegraph.sfm.tuning.world import SourceTuning, WorldTuning
from tiegraph.sfm.world.fit import Evidence, by_errors, fit_similarity
from tiegraph.sfm.world.positionerrors import MEDIAN_CHI2_3, Stated
from tiegraph.sfm.world.scale import RigScale

POSITIONS = {"gnss": "GNSS positions", "exif": "EXIF positions", "trajectory": "trajectory positions"}
CONTROL, ORIENTATIONS = "control points", "given orientations"
SCALE, HEADING, TILTS = "scale", "heading", ("tilt towards north", "tilt towards east")
PLACES = ("place east", "place north", "height")
_THREE = 3  # places, for a similarity


@dataclass(frozen=True)
class Source:
    """A similarity from one source. ``covariance`` (7, 7) of rotation, shift and log scale about ``middle`` (world);
    ``residual`` (K, 3) metres of its own fit."""

    name: str
    similarity: Similarity
    covariance: np.ndarray
    middle: np.ndarray
    residual: np.ndarray

    @property
    def scale_sigma(self) -> float:
        """Sigma of the logarithm of the scale."""
        return float(np.sqrt(self.covariance[6, 6]))

    def statements(
        self, result: Similarity, at: np.ndarray, used: Sequence[str], tuning: SourceTuning
    ) -> list[Statement]:
        """Its statements on scale, heading, tilt and place of a model point ``at`` (3,), relative to the result."""
        turn = np.degrees(Rotation.from_matrix(self.similarity.rotation @ result.rotation.T).as_rotvec())
        spread = np.degrees(np.sqrt(np.diag(self.covariance)[:3]))
        here = self.similarity(at[None])
        off = (here - result(at[None]))[0]
        place = PlacementError(self.middle, self.covariance).sigma(here)[0]
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
    stated: Stated | None,
    tuning: WorldTuning,
    free_antenna: bool = False,
) -> Source | None:
    """The similarity from some rows (K,) bool of the evidence alone; None with fewer than three of them.

    Positions are weighed by the errors that their residuals in this fit show, and by their common error
    (``positionerrors``); control points by their ``stated`` sigmas; ``free_antenna``: the lever arm may be anything.
    """
    own = evidence.where(rows)
    if len(np.unique(own.pose[:, :3, 3].round(9), axis=0)) < _THREE:
        return None
    own = replace(own, log_scale=None).with_arm(free_antenna).without_orientations()
    fit = fit_similarity(own, None, tuning.fit)
    for _ in range(tuning.sources.rounds):
        off = own.position_residuals(fit.similarity, fit.arm.place) / evidence.sigma[rows]
        typical = float(np.sqrt(np.median(np.sum(off**2, axis=1)) / MEDIAN_CHI2_3))
        own = replace(own, sigma=evidence.sigma[rows] * max(1.0, typical))
        fit = fit_similarity(own, None, tuning.fit, fit.similarity)
    fit = fit if stated is None else by_errors(own, None, fit, stated, tuning.fit, tuning.noise)
    off = own.position_residuals(fit.similarity, fit.arm.place)
    return Source(
        name=name,
        similarity=fit.similarity,
        covariance=fit.error.covariance,
        middle=fit.error.middle,
        residual=off,
    )


def rig_statement(scale: RigScale | None, result: Similarity, used: bool) -> list[Statement]:
    """The statement of known lengths, those of the rig or of scale bars, on the scale, if they determine it."""
    if scale is None or not scale.trusted:
        return []
    ratio = scale.metres_per_unit / result.scale
    return [Statement(quantity=SCALE, source=scale.source, value=ratio, sigma=ratio * scale.sigma, unit="", used=used)]


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


def orientation_statements(evidence: Evidence, result: Similarity, tuning: SourceTuning) -> list[Statement]:
    """The statements of given orientations on heading and tilt, relative to the result."""
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
