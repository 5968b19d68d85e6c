"""What a plan takes for granted: each constant with its unit, its meaning and where its value comes from."""

from pydantic import Field

from tiegraph.settings import Section


class EffortTuning(Section):
    """What a survey costs (`figures.py`): CPU seconds of one core of an AMD EPYC, as benchmarks/results has them."""

    start_s: float = Field(5.0, ge=0)
    """Of a run."""
    image_s: float = Field(0.8, ge=0)
    """Of an image from `scan` to `georef`, and ..."""
    megapixel_s: float = Field(1.0, ge=0)
    """... of its megapixels: small_sets.json and large_sets.json, seven sets of 8 to 300 images within a third (canal
    441 s measured, 337 so; PandaSet 269 and 400; KITTI 164 and 134; canal_demo 121 and 121; Herz-Jesus-P25 59 and
    64)."""
    dense_megapixel_s: float = Field(2.4, ge=0)
    """Of a megapixel that is matched in `dense` and `cloud`: whole_way.json, canal, 221 s for 92 megapixels."""
    image_bytes: float = Field(0.3, gt=0)
    """Of a pixel as JPEG: canal 0.27, PandaSet 0.13; cameras set to their finest write up to 0.6."""
    room_bytes: float = Field(110e3, gt=0)
    """Of an image in the run folder up to `georef`: preview, masks, its part of the tables; and ..."""
    feature_bytes: float = Field(250.0, gt=0)
    """... of each of its features, in the database and the model."""
    features_a_megapixel: float = Field(5600.0, gt=0)
    """Features, up to those that an image may keep. The room up to `georef`, as `du` has it, kB an image: canal_demo
    323 measured, 348 so, canal 523 and 544, KITTI 1025 and 740, PandaSet 395 and 838, Herz-Jesus-P8 1004 and 1134."""
    features_px: float = Field(3200.0, gt=0)
    """As `features.max_image_size`, and ..."""
    dense_px: float = Field(3200.0, gt=0)
    """... as `dense.max_image_size`: of a larger image only so much is worked on."""
    dense_bytes: float = Field(6.0, gt=0)
    """Of a matched pixel: depth maps and cloud, three files; canal_demo 7.0, kerry_park, half of it placed, 0.5."""
    products_megapixel_s: float = Field(3.2, ge=0)
    """Of a megapixel of the images in `products`, at their full size: canal_demo 3.1 (64 s), fountain-P11 3.2 (56 s);
    and ..."""
    products_bytes: float = Field(0.8, ge=0)
    """... bytes of each of their pixels, for rasters and pictures: canal_demo 0.4, fountain-P11 1.2."""


class StationTuning(Section):
    """The closed forms (`figures.py`)."""

    blur_px: float = Field(0.5, gt=0)
    """Motion during the exposure that is allowed: key points and matching keep their precision."""
    most_rays: int = Field(6, ge=2)
    """Rays of a point up to which its precision is tabled."""


class NetworkTuning(Section):
    """The synthetic network (`network.py`): how many tie points, and which images see one."""

    ties_a_megapixel: float = Field(4000.0, gt=0)
    """Observations of tie points of an image, for each megapixel that shows surface: PandaSet 1400, canal_demo 4000,
    KITTI 4700, canal 6000."""
    most_ties: int = Field(4000, gt=0)
    """Of an image."""
    repeat: float = Field(0.45, gt=0, le=1)
    """Of the images that could see a point, those that do, ..."""
    turn_deg: float = Field(18.0, gt=0, lt=90)
    """... mean of how far, seen from the point, they may stand off each other, and ..."""
    nearer: float = Field(1.5, gt=1)
    """... mean of how many times as near one may be as the other: so the tracks of canal come out as measured (7 images
    in the mean, 2 to 20; rays 18 deg apart in the median, distances 1.3 times)."""
    incidence_deg: float = Field(80.0, gt=0, lt=90)
    """Of a ray on the surface."""
    least_angle_deg: float = Field(1.0, ge=0)
    """Between the rays of a point, as `sparse` keeps them."""
    relief: float = Field(0.1, ge=0, le=1)
    """Unevenness of a surface where none is given, sigma, in parts of the distance: no wall is a plane, which would
    leave lenses open; and ..."""
    street_relief: float = Field(0.25, ge=0, le=1)
    """... of what lines a canal or a road: houses behind quays, parked cars before houses (canal: 0.25)."""
    wobble_deg: float = Field(1.5, ge=0)
    """How much the rig is turned from frame to frame, sigma about each axis: boats, vehicles and hands are never still,
    and exactly parallel views would leave focal length and distance one unknown (canal: 0.5 to 1 deg)."""
    most_points: int = Field(3000, gt=0)
    """Points that are simulated: fewer than there will be, of so much smaller errors that they tell as much."""
    least_points: int = Field(25, gt=0)
    """That start from an image, however many images there are: fewer hold no camera."""
    most_frames: int = Field(1500, gt=0)
    """More are too many to propagate here."""


class ErrorTuning(Section):
    """What the observations of a run share, beside independent errors: known from runs, not simulated."""

    tracks: float = Field(1.6, ge=1)
    """Sigmas by the errors that the observations of a point share over those by independent ones: KITTI 1.8, canal
    2.0, canal_demo 1.4, Herz-Jesus-P8 1.4."""
    lens_px: float = Field(0.015, ge=0)
    """Of a lens that is adjusted, what it leaves: 0.02 to 0.18 px are found in canal and canal_demo, most of them
    smooth, which the lens's own unknowns take up; what is left does as much as this at ``reach``."""
    calibration_px: float = Field(0.5, ge=0)
    """Of a lens held as a file gives it, used away from where it was calibrated: a vehicle's is half a pixel off
    (KITTI 0.65, the one vehicle measured, rounded); one that came with its photographs 0.05 (Strecha)."""
    reach: float = Field(0.1, gt=0)
    """Of the image's diagonal, how far a lens error reaches: KITTI, Herz-Jesus-P8, canal_demo."""


class PathTuning(Section):
    """Shapes (`path.py`)."""

    passes_apart: float = Field(0.3, ge=0, lt=2)
    """Between the ways out and back, in parts of the distance to the wall: one keeps to the right."""
    camera_m: float = Field(2.0, gt=0)
    """Height of a camera over water or road."""


class WorldTuning(Section):
    """The placement in the world (`accuracy.py`)."""

    mark_px: float = Field(0.5, gt=0)
    """Of a control point marked in an image."""
    least_marks: int = Field(3, ge=2)
    """Images that a control point is marked in, where as many see it."""
    height_factor: float = Field(1.5, gt=0)
    """Sigma of a receiver's height over that of its place, where none is given."""
    sections: int = Field(8, ge=1)
    """Of a way that are told apart."""
    gain: float = Field(0.15, gt=0, lt=1)
    """By which a change must lower the worst sigma to be advised."""


class Tuning(Section):
    """All constants of the planner."""

    effort: EffortTuning = Field(default_factory=EffortTuning)
    station: StationTuning = Field(default_factory=StationTuning)
    network: NetworkTuning = Field(default_factory=NetworkTuning)
    errors: ErrorTuning = Field(default_factory=ErrorTuning)
    path: PathTuning = Field(default_factory=PathTuning)
    world: WorldTuning = Field(default_factory=WorldTuning)
