"""What the room coarse decides by: each constant with its unit, its meaning and where its value comes from."""

from pydantic import Field

from tiegraph.settings import Section


class VisibleTuning(Section):
    """Which images see the same surface (`visible.py`, `proxy.py`)."""

    cells: tuple[int, int] = (24, 18)
    """Image cells across and down: votes and occlusion."""
    behind: float = Field(1.2, ge=1)
    """A point further than this times the nearest one of its cell is hidden."""
    mean_visible: tuple[int, int] = (700, 2500)
    """Points an image sees on average, in the largest surveys and in small ones."""
    cone_widens: float = Field(1.05, ge=1)
    """The cone round a field of view is wider by this factor: distortion."""
    min_share: float = Field(0.02, ge=0, le=1)
    """Predicted overlap below which a pair is not listed."""
    max_scale: float = Field(4.0, ge=1)
    """Pairs whose distances to the shared surface differ by more than this factor match no more."""
    guessed_view_deg: float = Field(60.0, gt=0, lt=180)
    """Field of view of an image without a camera, across and down."""


class TrustTuning(Section):
    """Where the coarse model is believed (`trust.py`).

    `suspect` and `linked` are shares of the matches in strong previews of the images' best pairs between two stretches
    of passes. Of all strong previews the truth explains 0.72 between the passes of canal (300 images), the rest are
    repeated walls, and 0.57 in a survey of 4020; of the best pairs there 0.96. Models that put one pass of canal a few
    walls further explain 0.2 to 0.35 of all.
    """

    near_steps: int = Field(2, ge=0)
    """Frames of a pass: images this near each other show whether the model is right there."""
    trusted: float = Field(0.5, ge=0, le=1)
    """Share of a frame's strong previews with those before, and after it, that the model must explain."""
    few: int = Field(3, gt=0)
    """Fewer of them tell nothing."""
    strong: float = Field(1.6, gt=0)
    """Times `min_matches`: previews this strong between near frames are true."""
    steep_deg: float = Field(90.0, ge=0, le=180)
    """No preview is strong where rays to the shared surface meet at more: such matches are a wall like it."""
    sound: float = Field(0.95, ge=0, le=1)
    """Share of a model's images that must be trusted: else it is torn."""
    suspect: float = Field(0.6, ge=0, le=1)
    """Below: what the model explains may be the false ones."""
    linked: float = Field(0.3, ge=0, le=1)
    """Below: the two are not where the model has them."""


class TracksTuning(Section):
    """Points where the rays of tracks meet (`surface.py`); the angles are those of COLMAP's global mapper."""

    images: int = Field(2, ge=2)
    """Rays of a point. With 3 it is half as many points and the design is content with fewer pairs: sigmas of canals of
    120 images are 1.10 times those over a model mapped whole, with 2 they are 1.03 times (benchmarks/README.md)."""
    off_deg: float = Field(1.0, gt=0, lt=90)
    """By which a ray may miss its point."""
    angle_deg: float = Field(1.0, gt=0, lt=180)
    """Between two of its rays at least."""


class CoarseTuning(Section):
    """The coarse model (`search.py`, `model.py`)."""

    tie_matches: int = Field(15, gt=0)
    """Preview matches of a tie of the model."""
    calibrates: float = Field(0.8, ge=0, le=1)
    """Share of the images in the model from which its calibration is believed."""
    tries: int = Field(4, gt=0)
    """Models made, where the first are torn or suspect."""
    most_focal: float = Field(1.1, ge=1)
    """Factor by which a model may correct the focal length of a data sheet or of EXIF."""
    most_turn_deg: float = Field(15.0, ge=0)
    """Of a nominal mounting: further only if a second model turns the camera as far."""
    visible: VisibleTuning = Field(default_factory=VisibleTuning)
    """Which images see the same surface."""
    tracks: TracksTuning = Field(default_factory=TracksTuning)
    """Points of its tracks."""
    trust: TrustTuning = Field(default_factory=TrustTuning)
    """Where the model is believed."""
