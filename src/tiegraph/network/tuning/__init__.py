"""Constants of the stages candidates, coarse and network, each with its unit, meaning and origin."""

from pydantic import Field

from tiegraph.network.tuning.coarse import CoarseTuning
from tiegraph.network.tuning.retrieval import RetrievalTuning
from tiegraph.network.tuning.rig import RigTuning
from tiegraph.settings import Section


class ScoreMatrixTuning(Section):
    """Preview evidence on a lattice of frames (`scorematrix.py`)."""

    peak: float = Field(1.2, ge=0)
    """Factor on `min_matches` that a patch of evidence must reach somewhere."""
    short_nodes: int = Field(8, ge=0)
    """Nodes of a short pass, whose lattice is most of the previews: its last node may replace another."""
    kernel_cut_sigmas: float = Field(2.5, gt=0)
    """Cut-off of the kernel, in sigmas."""
    most_level: float = Field(0.8, ge=0, lt=1)
    """Highest noise floor of unrelated frames that is subtracted, as a share of the range from the lowest to the
    highest mean."""


class BackgroundTuning(Section):
    """The noise floor of unrelated frames (`background.py`)."""

    long_frames: int = Field(60, gt=2)
    """Frames of a pass from which most share nothing: evidence counts near its path only."""
    samples: int = Field(40, gt=0)
    """Far frame pairs that are previewed for every two cameras."""
    enough: int = Field(12, gt=0)
    """Previews of two cameras from which they have their own noise floor; with fewer, that of all cameras."""
    band: float = Field(0.15, ge=0, le=1)
    """Mean count of the frames at one distance from the path that is needed there, as a share of the range above the
    floor."""


class ConstantTuning(Section):
    """One offset for each two cameras (`tiegraph.papers.meguro2024`)."""

    max_columns: int = Field(120, gt=0)
    """Frames of the other pass with which a sampled frame is compared."""
    heading_frames: int = Field(3, gt=0)
    """Sampled frames that first determine the heading of one pass relative to the other."""
    least_frames: int = Field(2, gt=0)
    """Sampled frames near the best offset that must have been previewed."""


class OffsetsTuning(Section):
    """Frame offsets within and between passes (`offsets.py`)."""

    ladder: tuple[int, ...] = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48)
    """Frame distances at which the reach of a camera is measured."""
    strides_a_reach: float = Field(5, gt=0)
    """Lattice strides within the frames over which a typical camera keeps seeing the same surface."""
    window_nodes: int = Field(10, gt=0)
    """Distance of seeds from the path, in lattice nodes."""
    window_margin_nodes: int = Field(2, ge=0)
    """Nodes beyond the window in which evidence still counts."""
    min_budget: int = Field(6000, ge=0)
    """Previews that are always allowed (less than a minute on one core)."""
    coarse_share: float = Field(0.5, gt=0, le=1)
    """Share of the budget for the first, coarse previews."""
    scores: ScoreMatrixTuning = Field(default_factory=ScoreMatrixTuning)
    """Evidence on a lattice."""
    background: BackgroundTuning = Field(default_factory=BackgroundTuning)
    """The noise floor of unrelated frames."""
    constant: ConstantTuning = Field(default_factory=ConstantTuning)
    """One offset for each two cameras."""


class PriorTuning(Section):
    """Check of a prior (`check.py`)."""

    sample: int = Field(40, gt=0)
    """Previews of each kind, proposed and refused, by the place of the two images on the passes."""
    drawn: int = Field(4000, ge=0)
    """Pairs drawn from all images with a prior position, those too far apart to be listed among them."""
    near_steps: int = Field(3, ge=0)
    """Frames of a pass that count as near in sequence."""
    enough: int = Field(15, gt=0)
    """Pairs proposed and refused that are needed for a verdict."""
    bad_ratio: float = Field(0.6, ge=0)
    """Ratio to the ties among the proposed pairs: a prior whose refused pairs tie more often is not informative ..."""
    sigmas: float = Field(2.0, ge=0)
    """... nor one whose difference is within this many standard deviations."""
    lost_sigmas: float = Field(2.5, ge=0)
    """Standard deviations by which refused pairs of a kind with hardly any proposed pair may tie more often than
    refused pairs of the others: 0.6 % by chance."""
    few_ties: int = Field(8, gt=0)
    """Ties among both that are needed for a verdict on a kind of pairs."""
    better: float = Field(0.04, ge=0)
    """Increase of the correlation with the previews from which another reading of the prior is named ..."""
    sure_fit: float = Field(0.45, ge=-1, le=1)
    """... and its smallest correlation."""
    better_tells: float = Field(0.03, ge=0)
    """Increase of the area under the ROC curve that it must have too."""
    alike: float = Field(0.01, ge=0)
    """Readings whose correlations are this close are named together."""
    shifts_frames: tuple[int, ...] = (-8, -5, -3, -2, -1, 1, 2, 3, 5, 8)
    """Shifts in time that are tried as readings."""


class PosesTuning(Section):
    """Pairs by prior poses (`poses.py`)."""

    range_spacings: float = Field(10.0, gt=0)
    """Assumed distance to the object, in distances between frames."""
    far_ranges: float = Field(2.0, gt=0)
    """Distance, in ranges, beyond which frames share nothing that matches."""
    near_ranges: float = Field(1 / 500, ge=0)
    """Length, in ranges, below which a base of one camera measures nothing."""
    neighbours: int = Field(40, gt=0)
    """Nearest frames of a frame that are tested ..."""
    drift: float = Field(0.01, ge=0)
    """Error of a trajectory without given accuracy, as a share of the path between two frames (odometry: about 1 %)."""
    sigmas: float = Field(2.0, ge=0)
    """Standard deviations of a distance by which a base must be too long or too short to be refused."""
    guessed_view_deg: float = Field(70.0, gt=0, lt=180)
    """Field of view of a camera with a guessed focal length and without a neighbour on its rig."""
    prior: PriorTuning = Field(default_factory=PriorTuning)
    """Check of a prior."""


class SectionsTuning(Section):
    """Bridge and open-sky sections (`light.py`, `sections.py`)."""

    min_frames: int = Field(8, ge=2)
    """Frames of a pass with an up camera that are needed to find its threshold."""
    min_separation: float = Field(0.7, ge=0, le=1)
    """Share of the variance the two classes must explain (a normal distribution: 0.64 to 0.67)."""
    sky_contrast: float = Field(0.3, ge=0)
    """Difference of the classes' open shares of the masks that is needed."""
    luminance_contrast: float = Field(2.0, gt=0)
    """Factor by which the classes' luminances must differ."""
    brightness_contrast: float = Field(1.25, gt=0)
    """Factor by which the classes' brightnesses must differ."""
    frame_say: float = Field(4.0, ge=0)
    """Largest log likelihood ratio of one frame: no single frame decides ..."""
    min_shared: float = Field(0.2, ge=0)
    """Density of pairs between two sections of one place, as a share of that within sections."""


class CountsTuning(Section):
    """Reading of preview match counts, in units of ``candidates.min_matches``, common to all sources."""

    floor: float = Field(2 / 3, ge=0, lt=1)
    """Factor on `min_matches`: count of unrelated images by chance."""
    ceiling: float = Field(2.0, gt=1)
    """Factor on `min_matches`: higher counts add no evidence."""
    sure: float = Field(1.3, gt=0)
    """Factor on `min_matches` for a single preview, which must be surer than an average over neighbouring frames."""
    sigma_nodes: float = Field(0.8, gt=0)
    """Kernel width of averages over neighbouring frames, in nodes of a lattice or strides; 0.5 .. 1.5 are equally
    good."""


class SourcesTuning(Section):
    """The choice of sources, and the pairs kept of their proposals (`sources.py`); whether a pass is a sequence
    (`candidates.py`)."""

    few_photos: int = Field(30, ge=0)
    """Loose photographs that are all compared with one another (435 pairs)."""
    nearest: int = Field(10, ge=0)
    """Nearest loose photographs with positions that are kept whatever their previews show."""
    sample: int = Field(40, gt=0)
    """Pairs of neighbours, and of images half a pass apart, that are previewed."""
    least_neighbours: int = Field(8, gt=0)
    """Pairs of neighbours that are needed for a verdict."""
    quartiles: tuple[float, float] = (25.0, 75.0)
    """Percentiles: most neighbours are better than the lower one, most images far apart worse than the upper one."""
    most_far: float = Field(0.6, gt=0)
    """Largest count of images far apart in a sequence, as a share of that of neighbours above `min_matches`."""


class Tuning(Section):
    """Constants of the engine that are the same for every user."""

    previews_an_image: int = Field(25, ge=0)
    """Previews per image, at most, for frame offsets, and for more than `retrieval.loose.all_limit` loose
    photographs: linear in the number of images."""
    counts: CountsTuning = Field(default_factory=CountsTuning)
    """Match counts of previews."""
    sources: SourcesTuning = Field(default_factory=SourcesTuning)
    """The choice of sources."""
    retrieval: RetrievalTuning = Field(default_factory=RetrievalTuning)
    """Retrieval of look-alikes."""
    offsets: OffsetsTuning = Field(default_factory=OffsetsTuning)
    """Frame offsets within and between passes."""
    poses: PosesTuning = Field(default_factory=PosesTuning)
    """Pairs by prior poses."""
    rig: RigTuning = Field(default_factory=RigTuning)
    """The rig compared with the images."""
    coarse: CoarseTuning = Field(default_factory=CoarseTuning)
    """The coarse model."""
    sections: SectionsTuning = Field(default_factory=SectionsTuning)
    """Bridge and open sections."""
