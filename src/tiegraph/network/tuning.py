"""Constants of the stages candidates, coarse and network, each with its unit, meaning and origin."""

from pydantic import Field

from tiegraph.settings import Section


class VocabularyTuning(Section):
    """Visual words (`loose.py`)."""

    vocabularies: int = Field(2, gt=0)
    """Number of vocabularies, with different starts; two find 0.01 to 0.02 more than one."""
    training: int = Field(200_000, gt=0)
    """Descriptors from which a vocabulary is learnt, at most: 100 MB."""
    rounds: int = Field(8, ge=0)
    """Rounds of k-means."""


class LooseTuning(Section):
    """Loose photographs (`loose.py`).

    Kept: count / min_matches, between the floor and the ceiling of all counts, plus `support` times the cosine of the
    two images' ties reaches `enough`.
    """

    all_limit: int = Field(100, ge=0)
    """Images up to which all pairs are previewed: 4950 previews, half a minute."""
    best: int = Field(5, ge=0)
    """Pairs of an image that are kept whatever their count, so that no image is without pairs."""
    start: int = Field(8, gt=0)
    """Look-alikes with which an image starts: nine of ten share something."""
    by_name: int = Field(2, ge=0)
    """Next photographs by name with which an image starts: a camera numbers its pictures."""
    hit_rate: float = Field(0.15, ge=0, le=1)
    """A round in which a smaller share of the previews ties is the last."""
    few_ties: int = Field(4, ge=0)
    """Ties of an image below which it goes further down its list of look-alikes."""
    support: float = Field(3.0, ge=0)
    """Weight of the cosine between two images' ties relative to their count in units of `min_matches`."""
    enough: float = Field(2.0, ge=0)
    """Sum of count and weighted cosine from which a pair is kept."""


class LoopSearchTuning(Section):
    """Loops of passes (`retrieval.py`)."""

    ladder: tuple[int, ...] = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96)
    """Frame distances at which similarity along a pass is measured."""
    strides_a_reach: int = Field(3, gt=0)
    """Sampled frames within a reach."""
    look_alikes: int = Field(4, gt=0)
    """Far images with which each sampled image is previewed."""
    patch: int = Field(10, ge=0)
    """Adjacent confirmed pairs that are needed to accept any of them. Simulated, 300 frames: false patches reach 9 if
    one unrelated preview in five ties. In long surveys, where repeated walls make patches of any size, the whole rig
    must confirm them too."""
    previews_an_image: int = Field(16, ge=0)
    """Previews per sampled image, at most, for the search for loops."""
    speaks: float = Field(0.4, ge=0, le=1)
    """Level of a camera at a loop, as a share of the range from the noise floor to the highest."""
    most_cameras: float = Field(0.6, ge=0, le=1)
    """Share of a rig's cameras that must reach it. Simulated: false loops 0.17 to 0.5, true ones 0.83 to 1."""


class RetrievalTuning(Section):
    """Retrieval of look-alikes."""

    sure_alike: float = Field(1.2, gt=0)
    """Factor on `min_matches` for a single preview of two similar images, whose neighbours are tested too."""
    vocabulary: VocabularyTuning = Field(default_factory=VocabularyTuning)
    """Visual words."""
    loose: LooseTuning = Field(default_factory=LooseTuning)
    """Loose photographs."""
    loops: LoopSearchTuning = Field(default_factory=LoopSearchTuning)
    """Loops of passes."""


class VisibleTuning(Section):
    """Which images see the same surface (`visible.py`, `proxy.py`)."""

    cells: tuple[int, int] = (24, 18)
    """Image cells across and down: votes and occlusion."""
    behind: float = Field(1.2, ge=1)
    """Factor on the distance of the nearest point of a cell, beyond which a point is hidden."""
    mean_visible: tuple[int, int] = (700, 2500)
    """Points that an image sees on average, in the largest surveys and in small ones."""
    cone_widens: float = Field(1.05, ge=1)
    """Factor on the cone around a field of view, for distortion."""
    min_share: float = Field(0.02, ge=0, le=1)
    """Predicted overlap below which a pair is not listed."""
    max_scale: float = Field(4.0, ge=1)
    """Largest ratio of the distances to the shared surface at which pairs match."""
    guessed_view_deg: float = Field(60.0, gt=0, lt=180)
    """Field of view of an image without a camera, across and down."""


class TrustTuning(Section):
    """Where the coarse model is trusted (`search.py`).

    `suspect` and `linked` are shares of the matches in strong previews of the images' best pairs between two sections
    of passes: the truth explains 0.96 of these in a survey of 4020 images (0.57 of all strong previews), models of
    canal with one pass displaced by a few periods of the wall 0.2 to 0.35.
    """

    near_steps: int = Field(2, ge=0)
    """Frames of a pass: images this close to each other show whether the model is right there."""
    trusted: float = Field(0.5, ge=0, le=1)
    """Share of a frame's strong previews with earlier and with later frames that the model must explain."""
    few: int = Field(3, gt=0)
    """Strong previews that are needed for a verdict."""
    strong: float = Field(1.6, gt=0)
    """Factor on `min_matches` from which previews between near frames are true."""
    sound: float = Field(0.95, ge=0, le=1)
    """Share of a model's images that must be trusted; otherwise it is torn."""
    suspect: float = Field(0.6, ge=0, le=1)
    """Share below which the explained matches may be the false ones."""
    linked: float = Field(0.3, ge=0, le=1)
    """Share below which the two sections are not in their right relative place."""


class TracksTuning(Section):
    """Points where the rays of tracks meet (`model.py`); the angles are those of COLMAP's global mapper."""

    images: int = Field(2, ge=2)
    """Rays of a point. With 3 there are half as many points, and the design accepts fewer pairs."""
    off_deg: float = Field(1.0, gt=0, lt=90)
    """Largest angle between a ray and its point."""
    angle_deg: float = Field(1.0, gt=0, lt=180)
    """Smallest angle between two of its rays."""


class CourseTuning(Section):
    """Matches against a rough model (`model.py`)."""

    steps: int = Field(24, gt=1)
    """Distances between the nearest and the farthest at which a ray is followed."""
    margin: float = Field(2.0, ge=1)
    """Distances outside those of the image's model points by this factor are still possible."""
    tolerance_deg: float = Field(1.0, gt=0)
    """Largest deviation from the course: preview key points are good to 0.2 degrees, rotations of their model to 0.15
    (canal)."""
    min_share: float = Field(0.25, ge=0, le=1)
    """Share of a pair's matches that must agree with the model. On canal (chosen there) it keeps 99.1 % of the pairs
    most of whose matches are true and 4 of 217 of which hardly any is; on canal_demo 98.6 % and 0 of 4."""
    any_distance: float = Field(10.0, ge=1)
    """Times nearer than the nearest point of the model, and farther than the farthest: any distance."""


class CoarseTuning(Section):
    """The coarse model (`search.py`, `model.py`)."""

    tie_matches: int = Field(15, gt=0)
    """Preview matches of a tie used for the model."""
    calibrates: float = Field(0.8, ge=0, le=1)
    """Share of the images in the model from which its calibration is used."""
    tries: int = Field(4, gt=0)
    """Models made, at most, if the first are torn or suspect."""
    most_focal: float = Field(1.1, ge=1)
    """Factor by which a model may correct the focal length of a data sheet or of EXIF."""
    most_turn_deg: float = Field(15.0, ge=0)
    """Rotation of a nominal mounting that needs confirmation by a second model."""
    visible: VisibleTuning = Field(default_factory=VisibleTuning)
    """Which images see the same surface."""
    tracks: TracksTuning = Field(default_factory=TracksTuning)
    """Points of its tracks."""
    course: CourseTuning = Field(default_factory=CourseTuning)
    """Which matches it explains."""
    trust: TrustTuning = Field(default_factory=TrustTuning)
    """Where the model is trusted."""


class CheckTuning(Section):
    """Mirrored and rolled rigs, cameras in another order (`rigcheck.py`)."""

    frames: int = Field(16, ge=0)
    """Frames whose images are compared, at most (0: rigs are not tested) ..."""
    least_frames: int = Field(4, gt=0)
    """... and at least."""
    samples: int = Field(250, gt=0)
    """Approximate number of compared pairs of images."""
    min_votes: int = Field(6, gt=0)
    """Image pairs with enough matches that are needed."""
    agreement: float = Field(0.5, ge=-1, le=1)
    """Mean cosine between predicted and seen motion that counts as agreement."""
    margin: float = Field(0.5, ge=0)
    """Difference by which a hypothesis must exceed the nominal rig to replace it."""
    tie: float = Field(0.03, ge=0)
    """Difference up to which agreements count as equal."""
    order_fit: float = Field(0.6, ge=-1, le=1)
    """Correlation between evidence and cosine of the axes that counts as an explanation."""
    order_better: float = Field(0.3, ge=0)
    """Difference by which a new order must correlate better than the nominal one, in all frames together ..."""
    order_alike: float = Field(0.02, ge=0)
    """Difference up to which correlations count as equal: turning or mirroring a ring changes no neighbours."""


class SynchronisationTuning(Section):
    """Synchronisation of cameras (`synchronisation.py`)."""

    short: float = Field(0.6, ge=0)
    """Share of the usual number of frames: a pass that short may have ended early."""
    off: float = Field(0.04, ge=0)
    """Deviation of a shift, as a share of the image size, from which it is odd (5 degrees of a nominal rig: 0.04)."""
    faint: float = Field(0.25, ge=0)
    """Evidence below this share of the other camera pairs' is odd."""
    least: float = Field(0.3, gt=0)
    """Evidence (`min_matches` above chance) that a pair of cameras must reach somewhere to vote."""
    gain: float = Field(1.25, ge=0)
    """Ratio of the evidence with a lag to that without ..."""


class CommonViewTuning(Section):
    """The overlap of two passes (`axes.py`)."""

    least_votes: float = Field(4.0, ge=0)
    """Effective number of nodes with a common view that is needed ..."""
    least_share: float = Field(0.02, ge=0, le=1)
    """... or their share of the previewed nodes: enough where passes are short."""
    whole: float = Field(0.9, ge=0, le=1)
    """Share of a pass above which the frames in common are not named."""
    rim: float = Field(0.05, ge=0, lt=1)
    """Share of the best row's evidence below which a frame is not counted."""


class RigTuning(Section):
    """The rig compared with the images."""

    check: CheckTuning = Field(default_factory=CheckTuning)
    """Mirrored, rolled and disordered rigs."""
    synchronisation: SynchronisationTuning = Field(default_factory=SynchronisationTuning)
    """Missing or late frames."""
    common_view: CommonViewTuning = Field(default_factory=CommonViewTuning)
    """Heading and direction of one pass relative to another."""


class ConstantTuning(Section):
    """One offset for each two cameras (`tiegraph.papers.meguro2024`)."""

    max_columns: int = Field(120, gt=0)
    """Frames of the other pass with which a sampled frame is compared."""
    heading_frames: int = Field(3, gt=0)
    """Sampled frames that first determine the heading of one pass relative to the other."""
    least_frames: int = Field(2, gt=0)
    """Sampled frames near the best offset that must have been previewed."""


class OffsetsTuning(Section):
    """Frame offsets within and between passes by evidence on a lattice (`offsets.py`, `scorematrix.py`)."""

    ladder: tuple[int, ...] = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48)
    """Frame distances at which the reach of a camera is measured."""
    strides_a_reach: float = Field(5, gt=0)
    """Lattice strides within the frames over which a typical camera keeps seeing the same surface."""
    window_nodes: int = Field(10, gt=0)
    """Distance of seeds from the path, in lattice nodes; evidence counts as far beyond it as the kernel reaches."""
    min_budget: int = Field(6000, ge=0)
    """Previews that are always allowed (less than a minute on one core)."""
    coarse_share: float = Field(0.5, gt=0, le=1)
    """Share of the budget for the first, coarse previews."""
    found_again: float = Field(0.55, ge=0, le=1)
    """Share of the features found again in a copy; measured: JPEG quality 60 .. 95: 0.59 .. 0.9, next frame 0.5."""
    copy_matches: float = Field(3.0, gt=0)
    """Factor on `min_matches` from which a pair is tested for being a copy."""
    peak: float = Field(1.2, ge=0)
    """Factor on `min_matches` that a patch of evidence must reach somewhere."""
    short_nodes: int = Field(8, ge=0)
    """Nodes of a short pass, whose lattice is most of the previews: its last node may replace another."""
    kernel_cut_sigmas: float = Field(2.5, gt=0)
    """Cut-off of the kernel, in sigmas."""
    most_level: float = Field(0.8, ge=0, lt=1)
    """Highest noise floor that is subtracted, as a share of the range from the lowest to the highest mean."""
    long_frames: int = Field(60, gt=2)
    """Frames of a pass from which most share nothing: evidence counts near its path only."""
    floor_previews: int = Field(12, gt=0)
    """Previews of two cameras from which they have their own noise floor; with fewer, that of all cameras."""
    band: float = Field(0.15, ge=0, le=1)
    """Mean count of frames at one distance from the path that counts there, as a share of the range above the floor."""
    constant: ConstantTuning = Field(default_factory=ConstantTuning)
    """One offset for each two cameras."""


class PriorTuning(Section):
    """Check of a prior (`posecheck.py`)."""

    drawn: int = Field(4000, ge=0)
    """Pairs drawn from all images with a prior position, those too far apart to be listed among them."""
    near_steps: int = Field(3, ge=0)
    """Frames of a pass that count as near in sequence."""
    enough: int = Field(15, gt=0)
    """Pairs proposed and refused that are needed for a verdict."""
    bad_ratio: float = Field(0.6, ge=0)
    """Ratio to the ties among the proposed pairs: a prior whose refused pairs tie more often tells nothing."""
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
    guessed_view_deg: float = Field(70.0, gt=0, lt=180)
    """Field of view of a camera with a guessed focal length and without a neighbour on its rig."""
    prior: PriorTuning = Field(default_factory=PriorTuning)
    """Check of a prior."""


class SectionsTuning(Section):
    """Bridge and open-sky sections (`sections.py`)."""

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
    """Kernel width of averages over neighbouring frames, in nodes or strides; 0.5 .. 1.5 are equally good."""


class Tuning(Section):
    """Constants of the engine that are the same for every user."""

    previews_an_image: int = Field(25, ge=0)
    """Previews per image, at most, for frame offsets, and for loose photographs above `retrieval.loose.all_limit`."""
    sample: int = Field(40, gt=0)
    """Previews for one verdict: on neighbours or images half a pass apart, on far frames of every two cameras, on each
    kind of pairs that a prior proposes or refuses."""
    counts: CountsTuning = Field(default_factory=CountsTuning)
    """Match counts of previews."""
    few_photos: int = Field(30, ge=0)
    """Loose photographs that are all compared with one another (435 pairs)."""
    nearest_photos: int = Field(10, ge=0)
    """Nearest loose photographs with positions that are kept whatever their previews show."""
    order_neighbours: int = Field(8, gt=0)
    """Pairs of neighbours that are needed for a verdict on the order of a pass."""
    order_far: float = Field(0.6, gt=0)
    """Largest count of images far apart in a sequence, as a share of that of neighbours above `min_matches`."""
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
