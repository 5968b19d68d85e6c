"""What filter decides by: each constant with its unit, its meaning and where its value comes from."""

from pydantic import Field

from tiegraph.settings import Section


class MotionTuning(Section):
    """The common motion of two units: five-point RANSAC, then Gauss-Newton (`motion.py`)."""

    matches_a_pair: int = Field(150, gt=0)
    """Matches of an image pair that are looked at: enough to tell, spread over them all."""
    least_matches: int = Field(8, ge=5)
    """Matches of two units below which they have no motion."""
    trials: int = Field(500, gt=0)
    """Of the RANSAC, at most: five of a share of 0.4 are met by 1 in 98."""
    least_trials: int = Field(60, gt=0)
    """Of the RANSAC, at least."""
    search_matches: int = Field(400, gt=0)
    """Matches the RANSAC scores its hypotheses by."""
    refine_matches: int = Field(800, gt=0)
    """Matches the refinement uses."""
    search_widens: float = Field(2.0, ge=1)
    """The RANSAC takes all centres as one: its bound is wider by this factor."""
    first_lengths: tuple[float, ...] = (3.0, 10.0, 40.0, 200.0)
    """First lengths of the translation, in sizes of the rig."""
    votes_a_pair: int = Field(100, gt=0)
    """Matches of one image pair that count in a vote: a wall full of windows is one opinion."""
    directions: int = Field(200, gt=0)
    """Samples of a translation under a given rotation."""
    direction_widens: float = Field(3.0, gt=0)
    """Such a sample is scored by matches within the bound times this."""
    steps: int = Field(6, gt=0)
    """Of Gauss-Newton."""


class RigTuning(Section):
    """The rig against the images, before it judges them (`cameraturns.py`)."""

    frame_pairs: int = Field(24, gt=0)
    """Pairs of frames the rig is checked on, those with most image pairs."""
    least_frame_pairs: int = Field(3, gt=0)
    """With fewer the rig is believed unchecked."""
    bounds: tuple[float, ...] = (6.0, 4.0, 3.0, 2.0, 1.5, 1.0, 1.0, 1.0)
    """Bounds of the rounds in multiples of `max_error_px`: a camera 3 degrees off starts 16 px (f = 310) off."""
    turn_prior_rad: float = Field(0.1, gt=0)
    """Sigma of a camera's turn before the images speak: one without ties stays where it is."""
    turn_deg: float = Field(0.3, ge=0)
    """A camera turned by more is refined, if the images then agree better."""
    max_turn_deg: float = Field(8.0, gt=0)
    """No mounting is off by more: wrong focal lengths of a ring look like that (20 degrees on canal)."""
    gain: float = Field(0.02, ge=0)
    """Of the median share of agreeing matches: less is noise, and the turn is not observable."""
    min_share: float = Field(0.6, ge=0, le=1)
    """Below, frames do not move as one: 0.89 on canal, 0.95 on PandaSet, 0.18 with a wrong focal length."""


class LoopTuning(Section):
    """Rotations of the motions against each other (`averaging.py`), and what contradicts them."""

    voters: int = Field(60, gt=0)
    """Ties between two clusters that are asked, the heaviest."""
    rounds: int = Field(10, gt=0)
    """Of the robust least squares, at most."""
    kernel_deg: float = Field(1.0, gt=0)
    """Geman-McClure kernel of the robust least squares."""
    noisy_deg: float = Field(10.0, gt=0)
    """Loops that close no better than this decide nothing."""
    sigmas: float = Field(5.0, gt=0)
    """How far a true tie may be off the loops, in their median residual."""
    neighbour_weight: float = Field(2.0, gt=0)
    """Weight of ties between neighbours of a pass, over their support."""
    neighbour_steps: int = Field(2, ge=0)
    """Steps of a pass within which two units are neighbours."""
    neighbours_enough: int = Field(10, gt=0)
    """Ties of neighbours from which these alone say how well loops close."""
    width_images: float = Field(2.0, gt=0)
    """`max_loop_deg` is wider by this for single images, which have no rig to lean on."""
    width_no_rig: float = Field(4.0, gt=0)
    """And by this after a rig that does not hold: focal lengths may be wrong, and every rotation with them."""


class PriorTuning(Section):
    """Matches against the coarse model (`prior.py`)."""

    steps: int = Field(24, gt=1)
    """Distances between the nearest and the farthest at which a ray is followed."""
    margin: float = Field(2.0, ge=1)
    """Distances outside those of the image's model points by this factor are still possible."""
    tolerance_deg: float = Field(1.0, gt=0)
    """Off course at most: preview key points are good to 0.2 degrees, their model's rotations to 0.15 (canal)."""
    min_share: float = Field(0.25, ge=0, le=1)
    """Share of a pair's matches that must agree with the model. On canal (chosen there) it keeps 99.1 % of the pairs
    most of whose matches are true and 4 of 217 of which hardly any is; on canal_demo 98.6 % and 0 of 4."""
    min_seeing: float = Field(0.5, ge=0, le=1)
    """Share of a sensor's images that see points, from which its place in the rig is the model's own."""
    mount_deg: float = Field(1.5, ge=0)
    """What a mounting that no point holds may be off: the up camera of canal_demo 1 to 1.5 by a wrong focal length."""
    any_distance: float = Field(10.0, ge=1)
    """Times nearer than the nearest point of the model, and farther than the farthest: any distance."""
    max_refused: float = Field(0.2, ge=0, le=1)
    """Share of the judged pairs: a model that contradicts more of them is wrong itself."""
    max_refused_image: float = Field(0.5, ge=0, le=1)
    """Share of an image's judged pairs: a model that contradicts more of them has the image at a wrong place."""


class Tuning(Section):
    """Constants of the engine that are the same for every user."""

    min_agree: int = Field(12, gt=0)
    """Matches of a pair that must agree with the common motion."""
    min_agree_share: float = Field(0.6, ge=0, le=1)
    """Or, of a pair of few matches, this share of them ..."""
    min_agree_few: int = Field(5, gt=0)
    """... and at least so many."""
    min_share: float = Field(0.3, ge=0, le=1)
    """Of a pair's matches, in any case: right ones 0.35 to 1 on canal, others mostly 0."""
    as_good: float = Field(0.65, ge=0, le=1)
    """Of the matches of a pair's free motion, that make a motion of the predicted rotation as good."""
    motion: MotionTuning = Field(default_factory=MotionTuning)
    """The motion of two units."""
    rig: RigTuning = Field(default_factory=RigTuning)
    """The check of the rig."""
    loops: LoopTuning = Field(default_factory=LoopTuning)
    """Votes and loops."""
    prior: PriorTuning = Field(default_factory=PriorTuning)
    """The coarse model as judge."""
