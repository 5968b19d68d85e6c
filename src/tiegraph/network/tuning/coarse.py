"""Constants of the coarse model, each with its unit, meaning and origin."""

from pydantic import Field

from tiegraph.settings import Section


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
    """Where the coarse model is trusted (`trust.py`).

    `suspect` and `linked` are shares of the matches in strong previews of the images' best pairs between two sections
    of passes. Of all strong previews the truth explains 0.72 between the passes of canal (300 images), the rest are
    repeated walls, and 0.57 in a survey of 4020; of the best pairs there 0.96. Models that displaced one pass of
    canal by a few periods of the wall explain 0.2 to 0.35 of all.
    """

    near_steps: int = Field(2, ge=0)
    """Frames of a pass: images this close to each other show whether the model is right there."""
    trusted: float = Field(0.5, ge=0, le=1)
    """Share of a frame's strong previews with earlier and with later frames that the model must explain."""
    few: int = Field(3, gt=0)
    """Strong previews that are needed for a verdict."""
    strong: float = Field(1.6, gt=0)
    """Factor on `min_matches` from which previews between near frames are true."""
    steep_deg: float = Field(90.0, ge=0, le=180)
    """Angle between rays to the shared surface from which no preview is strong: such matches show a similar wall."""
    sound: float = Field(0.95, ge=0, le=1)
    """Share of a model's images that must be trusted; otherwise it is torn."""
    suspect: float = Field(0.6, ge=0, le=1)
    """Share below which the explained matches may be the false ones."""
    linked: float = Field(0.3, ge=0, le=1)
    """Share below which the two sections are not in their right relative place."""


class TracksTuning(Section):
    """Points at the intersections of the rays of tracks (`model.py`); the angles are those of
    COLMAP's global mapper."""

    images: int = Field(2, ge=2)
    """Rays of a point. With 3 there are half as many points and the design accepts fewer pairs: sigmas of canals of
    120 images are 1.10 times those over a model mapped as a whole, with 2 they are 1.03 times (benchmarks/README.md).
    """
    off_deg: float = Field(1.0, gt=0, lt=90)
    """Largest angle between a ray and its point."""
    angle_deg: float = Field(1.0, gt=0, lt=180)
    """Smallest angle between two of its rays."""


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
    trust: TrustTuning = Field(default_factory=TrustTuning)
    """Where the model is trusted."""
