"""A georeference: its evidence, its residuals at held-out positions, and its update after the model was bent."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from tiegraph.geometry.align import Similarity
from tiegraph.geometry.gravity import Up
from tiegraph.scene.scene import Scene
from tiegraph.sfm.model import frame_poses
from tiegraph.sfm.tuning.world import WorldTuning
from tiegraph.sfm.world.bars import BarsFound
from tiegraph.sfm.world.fit import Evidence, Fit, by_errors
from tiegraph.sfm.world.fixes import Fixes
from tiegraph.sfm.world.marks import Target
from tiegraph.sfm.world.positionerrors import Stated, factors
from tiegraph.sfm.world.scale import RigScale
from tiegraph.sfm.world.unknowns import Bend
from tiegraph.sfm.world.weighing import EvidenceWeights


@dataclass(frozen=True)
class Model:
    """The data of the model that a georeference needs."""

    images: np.ndarray  # cam_from_world (N, 4, 4)
    up: Up | None
    scale: RigScale | None  # from known lengths: scale bars where there are some, else the rig's baselines
    targets: list[Target]
    names: tuple[str, ...] = ()  # of the images
    bars: BarsFound | None = None
    rig: RigScale | None = None  # from the rig, where bars determine the scale

    def frames(self, scene: Scene, metres_per_unit: float | None = None) -> np.ndarray:
        """world_from_rig (F, 4, 4), with the rig's scale if none is given."""
        guess = 1.0 if self.scale is None else self.scale.metres_per_unit
        return frame_poses(self.images, scene, metres_per_unit or guess)


@dataclass(frozen=True)
class SimilarityFit:
    """The evidence and result of a georeference; rows of ``evidence`` are the fixes, then the control points."""

    evidence: Evidence  # sigmas as used
    fixes: Fixes  # sigmas as stated, with doubt about outages and bridges
    fit: Fit
    up: Up | None  # used to determine the tilt
    points: np.ndarray  # (C,) control points in the evidence: rows of the control file
    notes: tuple[str, ...]
    weighed: EvidenceWeights
    model: Model
    tuning: WorldTuning
    rows: Stated  # the fixes as stated

    def residuals(self) -> np.ndarray:
        """(K, 3) metres, of the fixes."""
        fit = self.fit
        return self.evidence.position_residuals(fit.similarity, fit.arm.place, fit.clock.offset_s)[: len(self.fixes)]

    def held_out(self, bends: bool) -> np.ndarray | None:
        """(K, 3) metres, residuals of the fixes in the fit without the held-out ones, with or without its estimate of
        the model's shape; None without held-out fixes, or with too few others."""
        count, evidence = len(self.fixes), self.evidence if bends else replace(self.evidence, bend=None)
        held = np.append(self.fixes.held, np.zeros(len(evidence.frame) - count, bool))
        seen = self.fit.inlier & ~held
        if not held.any() or seen.sum() < self.tuning.similarity_fit.min_positions:
            return None
        fit = replace(self.fit, inlier=seen)
        blind = replace(self, evidence=evidence, fit=fit).refitted()
        off, (coefficients, _) = blind.residuals(), blind.fit.bent or (np.zeros(0), None)
        turn = blind.fit.similarity.scale * blind.fit.similarity.rotation
        return off if evidence.bend is None else off + evidence.bend.modes[:count] @ coefficients @ turn.T

    def refitted(self) -> SimilarityFit:
        """The same after its inlier positions were fitted again."""
        tuning = self.tuning
        return replace(self, fit=by_errors(self.evidence, self.up, self.fit, self.rows, tuning.fit, tuning.noise))

    def of_bent(self, poses: np.ndarray, targets: np.ndarray, bent: np.ndarray) -> SimilarityFit:
        """The same for a model that was placed by its similarity and then bent: ``poses`` (F, 4, 4) of the scene's
        frames, places (C, 3) of the control points used, coefficients (M,) of the modes of its shape."""
        there, evidence, tuning, count = self.fit.similarity, self.evidence, self.tuning, len(self.fixes)
        pose, speed = self.fixes.blend(poses)
        points = evidence.pose[count:].copy()
        before = there(points[:, :3, 3])
        points[:, :3, 3] = np.where(np.isfinite(targets), targets, before)  # rays that no longer meet
        turn, bend = there.scale * there.rotation, evidence.bend
        length, up = evidence.log_scale, self.up
        evidence = replace(
            evidence,
            pose=np.concatenate([pose, points]),
            speed=np.concatenate([speed, np.zeros_like(points)]),
            bend=bend and Bend(np.einsum("ij,kjm->kim", turn, bend.modes), bent),
            log_scale=length and replace(length, value=length.value - np.log(there.scale)),
        )
        start = replace(self.fit, similarity=Similarity(1.0, np.eye(3), np.zeros(3)))
        up = up and replace(up, direction=there.rotation @ up.direction)
        placed = replace(self, evidence=evidence, fit=start, up=up)
        off = placed.residuals()
        factor = factors(off / self.fixes.sigma, self.fixes.level, self.fixes.time_s, tuning.noise)
        times = np.linalg.norm(off / self.fixes.stretched(factor).sigma, axis=1)
        inlier = np.append(times < tuning.fit.inlier_sigmas * np.sqrt(3), self.fit.inlier[count:])
        return replace(placed, fit=replace(start, inlier=inlier)).refitted()


@dataclass(frozen=True)
class NotPlaced:
    """Why a model is not placed, and whether that contradicts it."""

    why: str
    contradicts: bool = False
