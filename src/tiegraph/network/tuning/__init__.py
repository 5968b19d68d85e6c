"""What the network stage decides by: each constant with its unit, its meaning and where its value comes from."""

from pydantic import Field

from tiegraph.network.tuning.coarse import CoarseTuning
from tiegraph.network.tuning.retrieval import RetrievalTuning
from tiegraph.network.tuning.rig import RigTuning
from tiegraph.settings import Section


class ScoreMatrixTuning(Section):
    """Preview evidence on a lattice of frames (`scorematrix.py`)."""

    peak: float = Field(1.2, ge=0)
    """Times `min_matches`: what a patch of evidence must reach somewhere."""
    short_nodes: int = Field(8, ge=0)
    """Nodes of a short pass, whose lattice is most of what is previewed: its last node may take another's place."""
    kernel_cut_sigmas: float = Field(2.5, gt=0)
    """Where the kernel of the decision ends."""
    most_level: float = Field(0.8, ge=0, lt=1)
    """Of the way from the lowest to the highest mean: the highest level of unrelated frames that is taken off."""


class BackgroundTuning(Section):
    """What frames that share nothing reach (`background.py`)."""

    long_frames: int = Field(60, gt=2)
    """From which on most frames of a pass share nothing: evidence counts near its path only."""
    samples: int = Field(40, gt=0)
    """Far frame pairs that are previewed, for every two cameras."""
    enough: int = Field(12, gt=0)
    """Previews of two cameras that tell their own level; of fewer, that of all."""
    band: float = Field(0.15, ge=0, le=1)
    """Of the way from the level to the highest: what the frames at one distance from the path reach on average."""


class ConstantTuning(Section):
    """One offset for each two cameras (`tiegraph.papers.meguro2024`)."""

    max_columns: int = Field(120, gt=0)
    """Frames of the other pass a sampled frame is compared with."""
    heading_frames: int = Field(3, gt=0)
    """Sampled frames that show the heading of one pass against the other first."""
    least_frames: int = Field(2, gt=0)
    """Sampled frames that must have been looked at near the best offset."""


class OffsetsTuning(Section):
    """Frame offsets within and between passes (`offsets.py`)."""

    ladder: tuple[int, ...] = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48)
    """Frame distances at which the reach of a camera is measured."""
    strides_a_reach: float = Field(5, gt=0)
    """Lattice strides in the frames over which a typical camera keeps seeing the same things."""
    window_nodes: int = Field(10, gt=0)
    """Seeds reach this far from the path, in lattice nodes."""
    window_margin_nodes: int = Field(2, ge=0)
    """So many nodes beyond the window evidence still counts."""
    min_budget: int = Field(6000, ge=0)
    """Previews that are always affordable (less than a minute on one core)."""
    coarse_share: float = Field(0.5, gt=0, le=1)
    """Of the budget: what the first look may take."""
    scores: ScoreMatrixTuning = Field(default_factory=ScoreMatrixTuning)
    """Evidence on a lattice."""
    background: BackgroundTuning = Field(default_factory=BackgroundTuning)
    """What frames that share nothing reach."""
    constant: ConstantTuning = Field(default_factory=ConstantTuning)
    """One offset for each two cameras."""


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
    drift: float = Field(0.01, ge=0)
    """Of the path between two frames: error of a trajectory without given accuracy (odometry: about 1 %)."""
    sigmas: float = Field(2.0, ge=0)
    """Standard deviations of a distance: a base refuses only what is too long or too short by all of them."""
    guessed_view_deg: float = Field(70.0, gt=0, lt=180)
    """Of a camera whose focal length is a guess and that has no neighbour on its rig."""
    prior: PriorTuning = Field(default_factory=PriorTuning)
    """Whether a prior may be believed."""


class SectionsTuning(Section):
    """Bridge and open-sky sections (`light.py`, `sections.py`)."""

    min_frames: int = Field(8, ge=2)
    """Of a pass with an up camera, or nothing can be learnt from it alone."""
    min_separation: float = Field(0.7, ge=0, le=1)
    """Share of the variance the two classes must explain (a normal distribution: 0.64 to 0.67)."""
    sky_contrast: float = Field(0.3, ge=0)
    """By which the classes' open shares of the masks must differ."""
    luminance_contrast: float = Field(2.0, gt=0)
    """Factor by which the classes' luminances must differ."""
    brightness_contrast: float = Field(1.25, gt=0)
    """Factor by which the classes' brightnesses must differ."""
    frame_say: float = Field(4.0, ge=0)
    """Log likelihood ratio of one frame at most: none decides alone ..."""
    min_shared: float = Field(0.2, ge=0)
    """Of the density of pairs within sections: what two sections must share to be one place."""


class CountsTuning(Section):
    """What the match counts of previews say, in units of ``candidates.min_matches``; every room reads them so."""

    floor: float = Field(2 / 3, ge=0, lt=1)
    """Times `min_matches`: what unrelated images reach by chance."""
    ceiling: float = Field(2.0, gt=1)
    """Times `min_matches`: more matches say nothing more."""
    sure: float = Field(1.3, gt=0)
    """Times `min_matches`: a single preview must be surer than an average over neighbouring frames."""
    sigma_nodes: float = Field(0.8, gt=0)
    """Kernel width of averages over neighbouring frames, in nodes of a lattice or strides; 0.5 .. 1.5 serve alike."""


class SourcesTuning(Section):
    """Which sources are asked, and what is kept of what they propose (`sources.py`); whether a pass is a sequence
    (`candidates.py`)."""

    few_photos: int = Field(30, ge=0)
    """Loose photographs that are all compared with one another (435 pairs)."""
    nearest: int = Field(10, ge=0)
    """Loose photographs with positions: nearest ones that are kept whatever the preview says."""
    sample: int = Field(40, gt=0)
    """Pairs of neighbours, and of images half a pass apart, that are previewed."""
    least_neighbours: int = Field(8, gt=0)
    """Pairs of neighbours, below which nothing can be said."""
    quartiles: tuple[float, float] = (25.0, 75.0)
    """Percentiles: most neighbours are better than the lower one, most images far apart worse than the upper one."""
    most_far: float = Field(0.6, gt=0)
    """Of what neighbours reach above `min_matches`: images far apart in a sequence reach less."""


class Tuning(Section):
    """Constants of the engine that are the same for every user."""

    previews_an_image: int = Field(25, ge=0)
    """The most that frame offsets may take, and that more than `retrieval.loose.all_limit` loose photographs may:
    linear in the number of images."""
    counts: CountsTuning = Field(default_factory=CountsTuning)
    """Match counts of previews."""
    sources: SourcesTuning = Field(default_factory=SourcesTuning)
    """The choice of sources."""
    retrieval: RetrievalTuning = Field(default_factory=RetrievalTuning)
    """Which images look alike."""
    offsets: OffsetsTuning = Field(default_factory=OffsetsTuning)
    """Frame offsets within and between passes."""
    poses: PosesTuning = Field(default_factory=PosesTuning)
    """Pairs by prior poses."""
    rig: RigTuning = Field(default_factory=RigTuning)
    """The rig against the images."""
    coarse: CoarseTuning = Field(default_factory=CoarseTuning)
    """The coarse model."""
    sections: SectionsTuning = Field(default_factory=SectionsTuning)
    """Bridge and open sections."""
