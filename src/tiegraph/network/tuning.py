"""Constants of the stages candidates, coarse and network, each with its unit, meaning and origin.

A verdict needs ``scene.evidence.ENOUGH`` values, or ``FEW`` where a majority of few decides. Counts of matches are
read in units of ``candidates.min_matches`` everywhere.
"""

from pydantic import Field

from tiegraph.settings import Section


class CountsTuning(Section):
    """Reading of preview match counts, in units of ``candidates.min_matches``, common to all sources."""

    floor: float = Field(2 / 3, ge=0, lt=1)
    """Factor on `min_matches`: count of unrelated images by chance."""
    ceiling: float = Field(2.0, gt=1)
    """Factor on `min_matches`: higher counts add no evidence."""
    sure: float = Field(1.2, gt=0)
    """Factor on `min_matches` for a single preview, which must be surer than an average over neighbouring frames, and
    for the highest count of a patch of evidence."""
    sigma_nodes: float = Field(0.8, gt=0)
    """Kernel width of averages over neighbouring frames, in nodes or strides; 0.5 .. 1.5 are equally good."""

    @property
    def tie_share(self) -> float:
        """Share of the range from chance to the ceiling at which `min_matches` lies: where two cameras tie."""
        return (1 - self.floor) / (self.ceiling - self.floor)


class VerdictTuning(Section):
    """Tests of what the user or the files say by previews: order of a pass, rig, prior."""

    sample: int = Field(40, gt=0)
    """Previews for one verdict: on neighbours or images half a pass apart, on far frames of every two cameras, on each
    kind of pairs that a prior proposes or refuses."""
    votes: int = Field(6, gt=0)
    """Pairs of images of one frame, or nodes of a lattice (effective number), that are needed for a statement on the
    axes of a rig or on two passes."""
    tells_nothing: float = Field(0.6, ge=0)
    """Ratio of the evidence for pairs that should share nothing to that for pairs that should: above it an order or a
    prior says nothing about the images."""
    agreement: float = Field(0.5, ge=-1, le=1)
    """Cosine or correlation between predicted and seen values from which a reading explains the images."""
    better: float = Field(0.3, ge=0)
    """Difference in agreement by which another reading must exceed the given one to replace it."""
    alike: float = Field(0.03, ge=0)
    """Difference up to which two readings agree equally well with the images."""
    shifts_frames: tuple[int, ...] = (-8, -5, -3, -2, -1, 1, 2, 3, 5, 8)
    """Shifts in time that are tried as readings of a prior."""


class RetrievalTuning(Section):
    """Retrieval of look-alikes."""

    look_alikes: int = Field(5, gt=0)
    """Images with which each image is previewed at a time: the most similar ones, or neighbours of its neighbours."""
    hit_rate: float = Field(0.15, ge=0, le=1)
    """A round in which a smaller share of the previews ties is the last."""
    support: float = Field(3.0, ge=0)
    """Weight of the cosine between two images' ties relative to their count in units of `min_matches`: a pair of loose
    photographs is kept if both together reach the ceiling of counts."""
    strides_a_reach: int = Field(3, gt=0)
    """Sampled frames within a reach in the search for loops."""
    patch: int = Field(10, ge=0)
    """Adjacent confirmed pairs that are needed to accept a loop. Simulated, 300 frames: false patches reach 9 if
    one unrelated preview in five ties. In long surveys, where repeated walls make patches of any size, the whole rig
    must confirm them too."""


class OffsetsTuning(Section):
    """Frame offsets within and between passes by evidence on a lattice (`offsets.py`, `scorematrix.py`)."""

    window_nodes: int = Field(10, gt=0)
    """Distance of seeds from the path, in lattice nodes; evidence counts as far beyond it as the kernel reaches."""
    found_again: float = Field(0.55, ge=0, le=1)
    """Share of the features found again in a copy; measured: JPEG quality 60 .. 95: 0.59 .. 0.9, next frame 0.5."""
    copy_matches: float = Field(3.0, gt=0)
    """Factor on `min_matches` from which a pair is tested for being a copy."""
    long_frames: int = Field(60, gt=2)
    """Frames of a pass from which most share nothing: evidence counts near its path only."""
    max_columns: int = Field(120, gt=0)
    """Constant offsets (paper 000): frames of the other pass with which a sampled frame is compared."""


class RigTuning(Section):
    """The rig compared with the images."""

    frames: int = Field(16, ge=0)
    """Frames whose images are compared (0: rigs are not tested)."""
    short: float = Field(0.6, ge=0)
    """Share of the usual number of frames: a pass that short may have ended early."""
    off: float = Field(0.04, ge=0)
    """Deviation of a shift, as a share of the image size, from which it is odd (5 degrees of a nominal rig: 0.04)."""
    gain: float = Field(1.25, ge=0)
    """Ratio of the evidence with a lag to that without, from which a camera runs late."""
    common_share: float = Field(0.02, ge=0, le=1)
    """Share of the previewed nodes with a common view that two short passes need."""
    rim: float = Field(0.05, ge=0, lt=0.5)
    """Share of the best row's evidence below which a frame is not counted to the common view of two passes, and of a
    pass that may lack at either end of a view of the whole pass."""


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


class VisibleTuning(Section):
    """Which images see the same surface (`visible.py`, `proxy.py`)."""

    cells: tuple[int, int] = (24, 18)
    """Image cells across and down: votes and occlusion."""
    behind: float = Field(1.2, ge=1)
    """Factor on the distance of the nearest point of a cell, beyond which a point is hidden."""
    mean_visible: tuple[int, int] = (700, 2500)
    """Points that an image sees on average, in the largest surveys and in small ones."""
    min_share: float = Field(0.02, ge=0, le=1)
    """Predicted overlap below which a pair is not listed."""
    max_scale: float = Field(4.0, ge=1)
    """Largest ratio of the distances to the shared surface at which pairs match."""
    guessed_view_deg: float = Field(60.0, gt=0, lt=180)
    """Field of view, across and down, of an image without a camera, and of one with a guessed focal length and without
    a neighbour on its rig."""


class CourseTuning(Section):
    """Rays of matches against a model (`model.py`)."""

    tolerance_deg: float = Field(1.0, gt=0, lt=90)
    """Largest angle between a ray and its point, or the course of the matched ray, and smallest angle between two rays
    of a point: preview key points are good to 0.2 degrees, rotations of their model to 0.15 (canal)."""
    margin: float = Field(2.0, ge=1)
    """Distances outside those of the image's model points by this factor are still possible."""
    min_share: float = Field(0.25, ge=0, le=1)
    """Share of a pair's matches that must agree with the model. On canal (chosen there) it keeps 99.1 % of the pairs
    most of whose matches are true and 4 of 217 of which hardly any is; on canal_demo 98.6 % and 0 of 4."""


class CoarseTuning(Section):
    """The coarse model (`search.py`, `model.py`)."""

    tries: int = Field(4, gt=0)
    """Models made, at most, if the first are torn or suspect."""
    near_steps: int = Field(2, ge=0)
    """Frames of a pass: images this close to each other share most of their view; they show whether a model, or a
    prior, is right there."""
    sound: float = Field(0.95, ge=0, le=1)
    """Share of a model's images that must be trusted; otherwise it is torn."""
    calibrates: float = Field(0.8, ge=0, le=1)
    """Share of the images in the model from which its calibration is used."""
    most_focal: float = Field(1.1, ge=1)
    """Factor by which a model may correct the focal length of a data sheet or of EXIF."""
    most_turn_deg: float = Field(15.0, ge=0)
    """Rotation of a nominal mounting that needs confirmation by a second model."""
    visible: VisibleTuning = Field(default_factory=VisibleTuning)
    """Which images see the same surface."""
    course: CourseTuning = Field(default_factory=CourseTuning)
    """Which matches it explains, and which tracks give a point."""


class SectionsTuning(Section):
    """Bridge and open-sky sections (`sections.py`)."""

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


class Tuning(Section):
    """Constants of the engine that are the same for every user."""

    previews_an_image: int = Field(25, ge=0)
    """Previews per image, at most: for frame offsets, for loops, and for loose photographs."""
    free_previews: int = Field(5000, ge=0)
    """Previews that are always allowed: half a minute on one core, all pairs of 100 photographs."""
    few_photos: int = Field(30, ge=0)
    """Loose photographs that are all compared with one another (435 pairs)."""
    best_photos: int = Field(8, ge=0)
    """Best pairs of a loose photograph, by previews or by the distance of known positions, that are kept whatever
    their count, so that no image is without pairs."""
    ladder: tuple[int, ...] = (1, 2, 3, 4, 6, 8, 12, 16, 24, 32, 48, 64, 96)
    """Frame distances at which the reach of a camera, over which it sees the same surface, is measured."""
    strides_a_reach: int = Field(5, gt=0)
    """Sampled frames within a reach."""
    counts: CountsTuning = Field(default_factory=CountsTuning)
    """Match counts of previews."""
    verdict: VerdictTuning = Field(default_factory=VerdictTuning)
    """Tests of order, rig and prior."""
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
