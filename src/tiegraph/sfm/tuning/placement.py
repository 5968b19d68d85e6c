"""What sfm/placement decides by: each constant with its unit, its meaning and where its value comes from."""

from __future__ import annotations

from pydantic import Field

from tiegraph.settings import Section


class AgreementTuning(Section):
    """Which verified matches a model explains (`verified.py`)."""

    tolerance_rad: float = Field(0.006, gt=0)
    """Between a ray and the other's epipolar line: about 2 px of a survey camera."""
    matches_a_pair: int = Field(100, gt=0)
    """Matches of one image pair that count: a wall full of windows is one opinion."""
    least_matches: int = Field(8, gt=0)
    """Matches below which a pair has no opinion, and points below which an image tells no reach."""
    reach_percent: tuple[float, float] = (2.0, 98.0)
    """Percentiles of the distances of the points an image sees: the nearest and the farthest."""
    reach: float = Field(3.0, ge=1)
    """Times the nearest and farthest points an image sees: matches must meet in between."""
    parallax: float = Field(3.0, ge=0)
    """Tolerances that the step between two images may be, seen from the farthest: parallel rays agree then."""


class ConsistencyTuning(Section):
    """Frames judged by the ties between them (`consistency.py`)."""

    near_steps: int = Field(3, gt=0)
    """Steps of a pass within which a tie is one of the neighbours'."""
    agrees: float = Field(0.5, ge=0, le=1)
    """Share of a pair's matches that the model explains, from which the pair agrees."""
    contradicts: float = Field(0.25, ge=0, le=1)
    """Share of a pair's matches that the model explains, below which the pair contradicts it."""
    min_votes: float = Field(30.0, ge=0)
    """Matches that make an opinion of two frames."""
    min_partners: int = Field(2, gt=0)
    """Frames whose ties agree: false ties to one are soon found."""


class ContinuityTuning(Section):
    """Whether a model moves as its passes do (`continuity.py`)."""

    expected_times: float = Field(2.0, ge=1)
    """Times the expected way between two frames that they may be apart ..."""
    jump_steps: float = Field(2.0, ge=0)
    """... and usual steps beyond that; a wall's period is more in a survey that overlaps."""
    brisk_percent: float = Field(80.0, ge=0, le=100)
    """Percentile of the steps that is called usual: vehicles also stand."""
    least_frames: int = Field(5, ge=2)
    """Of a pass, to speak of a usual step."""


class RepairTuning(Section):
    """Doubtful frames placed again (`repair.py`)."""

    rounds: int = Field(3, ge=0)
    """Of judging and placing again."""
    max_doubted: float = Field(0.5, ge=0, le=1)
    """Share of the frames in doubt beyond which nothing is moved."""
    max_lost: float = Field(0.2, ge=0, le=1)
    """Of the frames that may be left out for their place; more is a model that fell apart, and is said so."""
    block_frames: int = Field(4, gt=0)
    """Fewer are placed one by one, more as a rigid block."""
    block_trials: int = Field(2000, gt=0)
    """Of the RANSAC for the motion of a block."""
    block_error: float = Field(0.1, gt=0)
    """How far points of a block may lie off their own in the main part, in distances of an image's nearest points."""
    block_scale: tuple[float, float] = (0.9, 1.1)
    """Of a block against the main part: outside, the points are not the same."""
    refinements: int = Field(1, gt=0)
    """Of points made anew under poses that stay: the final adjustment follows, and a long one is of no use."""
    refine_iterations: int = Field(5, gt=0)
    """Of such a refinement."""


class ResectionTuning(Section):
    """The place of a frame by matches with points of the model (`resection.py`)."""

    search_px: float = Field(6.0, gt=0)
    """Bound of the RANSAC."""
    trials: int = Field(3000, gt=0)
    """Of the RANSAC, at most."""
    min_inliers: int = Field(20, gt=0)
    """Points that must agree with a place."""
    min_partners: int = Field(2, gt=0)
    """Partner images these must come from."""
    min_share: float = Field(0.15, ge=0, le=1)
    """Of the correspondences: below, chance agreements of a repeated wall are as many."""


class PredictTuning(Section):
    """Where a frame should stand that no match has placed (`predictedpose.py`)."""

    neighbours: int = Field(8, gt=0)
    """Frames whose poses carry those of the coarse model over: what it drifts, it drifts slowly."""
    least_frames: int = Field(3, ge=2)
    """Placed frames of the coarse model below which it predicts nothing."""
    away_steps: int = Field(4, gt=0)
    """Steps to a neighbour on the pass at most."""
    by_preview_rad: float = Field(0.01, gt=0)
    """How far off a point may be seen of a frame that the coarse model places."""
    by_pass_rad: float = Field(0.04, gt=0)
    """How far off a point may be seen of a frame that its neighbours on the pass place."""


class GuidedTuning(Section):
    """Guided matching, and what it places or ties (`guidedmatching.py`, `guidedregistration.py`)."""

    partners: int = Field(12, gt=0)
    """Images whose points an image is asked for."""
    turn_deg: float = Field(60.0, gt=0, le=180)
    """Between the axes of an image and its partners."""
    max_angle_rad: float = Field(0.7, gt=0)
    """Between descriptors: COLMAP's own limit."""
    ratio: float = Field(0.85, gt=0, le=1)
    """Of the angle to the second best in sight."""
    same_px: float = Field(2.0, ge=0)
    """Key points nearer are one, in two sizes or orientations."""
    rounds: int = Field(2, ge=0)
    """Of placing what is missing: what is placed may help the next."""
    min_points: int = Field(10, gt=0)
    """An image that sees fewer hangs on its rig and is searched for points; with so many found it is tied."""
    near_px: float = Field(8.0, gt=0)
    """How far off the points of an image that the rig places may be."""
    least_px: float = Field(6.0, gt=0)
    """Searched at least about a point of an image whose place is predicted."""
    agree_px: float = Field(4.0, gt=0)
    """Between a point and where it is found: COLMAP's own limit of an observation."""
    agree_share: float = Field(0.5, ge=0, le=1)
    """Of what was found that must agree with the rig's pose."""
    max_miss: float = Field(3.0, gt=0)
    """Times the slack that a found pose may turn from the predicted one."""


class PlacementTuning(Section):
    """The place of frames, tested, mended and completed."""

    missing_rounds: int = Field(4, ge=0)
    """Of placing what is missing by verified matches: each lets the next lean on it."""
    agreement: AgreementTuning = AgreementTuning()
    """Matches that a model explains."""
    consistency: ConsistencyTuning = ConsistencyTuning()
    """What the ties of frames say of their place."""
    continuity: ContinuityTuning = ContinuityTuning()
    """The course of the passes."""
    repair: RepairTuning = RepairTuning()
    """Doubtful frames placed again."""
    resection: ResectionTuning = ResectionTuning()
    """A place by matches."""
    predict: PredictTuning = PredictTuning()
    """A place predicted."""
    guided: GuidedTuning = GuidedTuning()
    """Guided matching."""
