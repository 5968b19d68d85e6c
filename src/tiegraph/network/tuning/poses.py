"""What the room poses decides by: each constant with its unit, its meaning and where its value comes from."""

from pydantic import Field

from tiegraph.settings import Section


class PriorTuning(Section):
    """Whether a prior may be believed (`check.py`)."""

    sample: int = Field(40, gt=0)
    """Previews of each kind: proposed or refused, by where the two images are on the passes."""
    drawn: int = Field(4000, ge=0)
    """Pairs drawn from all images with a prior position, those too far apart to be listed among them."""
    near_steps: int = Field(3, ge=0)
    """Frames of a pass no further apart are near in sequence."""
    enough: int = Field(15, gt=0)
    """Pairs proposed and refused, below which nothing can be said."""
    bad_ratio: float = Field(0.6, ge=0)
    """Of the ties among the proposed: a prior whose refused pairs tie more often tells nothing ..."""
    sigmas: float = Field(2.0, ge=0)
    """... nor one whose refused pairs tie more rarely by no more than this many standard deviations."""
    lost_sigmas: float = Field(2.5, ge=0)
    """Standard deviations by which what it refuses of a kind that it hardly proposes may tie more often than what it
    refuses of the others: 0.6 % by chance."""
    few_ties: int = Field(8, gt=0)
    """Ties among both, below which a kind of pairs tells nothing."""
    better: float = Field(0.04, ge=0)
    """By how much another reading of the prior must correlate better with the previews to be named ..."""
    sure_fit: float = Field(0.45, ge=-1, le=1)
    """... and how well in all."""
    better_tells: float = Field(0.03, ge=0)
    """By how much it must tell the pairs that tie from those that do not better, too."""
    alike: float = Field(0.01, ge=0)
    """Readings whose correlations are this close are named together."""
    shifts_frames: tuple[int, ...] = (-8, -5, -3, -2, -1, 1, 2, 3, 5, 8)
    """Shifts in time that are tried as readings."""


class PosesTuning(Section):
    """Pairs by prior poses (`poses.py`)."""

    range_spacings: float = Field(10.0, gt=0)
    """Assumed distance to the object, in distances between frames."""
    far_ranges: float = Field(2.0, gt=0)
    """Frames further apart than this many ranges share nothing that matches."""
    near_ranges: float = Field(1 / 500, ge=0)
    """In ranges: a shorter base of one camera measures nothing."""
    neighbours: int = Field(40, gt=0)
    """Nearest frames of a frame that are looked at ..."""
    neighbour_radii: float = Field(2.0, gt=0)
    """... within this many times the distance beyond which frames share nothing."""
    drift: float = Field(0.01, ge=0)
    """Of the path between two frames: error of a trajectory without given accuracy (odometry: about 1 %)."""
    sigmas: float = Field(2.0, ge=0)
    """Standard deviations of a distance: a base refuses only what is too long or too short by all of them."""
    unsure: float = Field(0.25, ge=0)
    """Of the range: less certain than this, two frames are not refused by sight."""
    max_slack_rad: float = Field(0.3, ge=0)
    """Most that an uncertain position widens a field of view."""
    guessed_view_deg: float = Field(70.0, gt=0, lt=180)
    """Of a camera whose focal length is a guess and that has no neighbour on its rig."""
    shared_view: float = Field(1.25, gt=0)
    """Field of view of such a camera over the angle to the next one on its rig: they overlap."""
    max_view_deg: float = Field(120.0, gt=0, lt=180)
    """Most that a guessed field of view is widened to."""
    next_deg: float = Field(5.0, ge=0)
    """Cameras of a rig whose axes are nearer look the same way: neither is the other's next one."""
    heading_sigmas: float = Field(4.0, ge=0)
    """Standard deviations of the positions, above which a stretch of the track tells a heading."""
    prior: PriorTuning = Field(default_factory=PriorTuning)
    """Whether a prior may be believed."""
