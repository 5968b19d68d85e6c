"""What the odometry decides by: each constant with its unit, its meaning and where its value comes from."""

from pydantic import Field

from tiegraph.settings import Section


class FollowTuning(Section):
    """Corners and how they are followed (`follow.py`, `cameras.py`)."""

    corners: int = Field(400, gt=0)
    """Corners that a camera is kept filled to: more cost time and buy little (ORB-SLAM takes 1000 to 2000 an image)."""
    quality: float = Field(0.002, gt=0, lt=1)
    """Least eigenvalue of a corner over that of the best one (Shi and Tomasi 1994)."""
    spacing: float = Field(0.012, gt=0, lt=1)
    """Least distance between corners, in longer sides of the image."""
    margin_px: int = Field(8, ge=1)
    """Corners closer to the edge of the image are not taken: their window is cut."""
    window_px: int = Field(15, ge=5)
    """Side of the window that is followed (Lucas and Kanade): with OpenCV's 21 KITTI is no better and slower."""
    levels: int = Field(4, ge=0)
    """Levels of the pyramid above the image: shifts of about the window times 2 to the power of this are found."""
    back_px: float = Field(1.0, gt=0)
    """A corner that does not come back to within this when it is followed back is lost."""
    partner_share: float = Field(0.6, gt=0, le=1)
    """A camera of whose view so much is seen by an earlier one gets no corners of its own, only those seen there."""
    partner_far: float = Field(20.0, gt=0)
    """Distance, in baselines, at which that is looked at."""
    turned_deg: float = Field(5.0, gt=0)
    """Angle between two cameras of a rig from which the image of the one is turned to the other's view first."""
    off_plane_px: float = Field(1.0, gt=0)
    """Distance from the epipolar line up to which a corner in another camera of the rig is the same."""


class PoseTuning(Section):
    """The pose of a frame by points that are known (`resect.py`)."""

    first_px: float = Field(25.0, gt=0)
    """Points that are off by more from where the predicted pose sees them do not count in the first refinement."""
    inlier_px: float = Field(3.0, gt=0)
    """A point that is off by more is followed no further."""
    share: float = Field(0.5, gt=0, le=1)
    """Share of points within that, below which the pose is looked for by RANSAC ..."""
    least_share: float = Field(0.3, gt=0, le=1)
    """... and below which, or ..."""
    least_points: int = Field(15, ge=6)
    """... with fewer points there is none: six unknowns, and RANSAC finds a few that agree in any heap."""
    trials: tuple[int, int] = (50, 2000)
    """Least and most trials of RANSAC."""


class MapTuning(Section):
    """Keyframes and points (`worldmap.py`, `adjust.py`)."""

    moved: float = Field(0.06, gt=0)
    """A frame is a keyframe when its points have moved by so much since the last, in longer sides of the image ..."""
    kept: float = Field(0.6, gt=0, lt=1)
    """... or when less of the last one's points than this are left."""
    angle_deg: float = Field(0.2, gt=0)
    """Angle between the rays of a point from which it has a place."""
    window: int = Field(8, ge=3)
    """Keyframes that are adjusted together ..."""
    held: int = Field(3, ge=1)
    """... of which the oldest stay where they are."""
    loss_px: float = Field(1.0, gt=0)
    """Scale of the Cauchy loss."""
    outlier_px: float = Field(2.5, gt=0)
    """An observation that is off by more after the adjustment is forgotten."""
    shared: float = Field(3.0, ge=1)
    """Errors over the sigmas that the observations say: what all corners of an image share, hundredths of a pixel by
    which following errs, is in no residual. Told by a rendered drive (`tests/odometry`), checked on five paths that
    it did not see (docs/odometry.md): turns over some way come out at 0.8 to 1.65 of the widened sigmas."""
    iterations: int = Field(8, gt=0)
    """Of Ceres in a window: its start is the pose that was found a moment ago."""
    loop_px: tuple[float, ...] = (30.0, 3.0, 1.0)
    """Scales of the loss when all is adjusted after a loop was closed: it stands off by the drift at first."""
    loop_iterations: int = Field(60, gt=0)
    """Of Ceres then."""


class StartTuning(Section):
    """The first points of a segment (`resect.py`)."""

    least_points: int = Field(30, ge=6)
    """Points with a place from which a segment is begun."""
    together: float = Field(0.25, gt=0, le=1)
    """Share of the corners that must have one by the cameras of the rig at one instant: a ring of cameras, which share
    the edges of their views only, is begun from two frames, and its cameras tell the scale."""
    moved: float = Field(0.04, gt=0)
    """Median shift of the corners, in longer sides of the image, from which two frames of one camera may begin it."""
    angle_deg: float = Field(0.6, gt=0)
    """Median angle between the rays that they must have: less tells no depth."""
    inlier_px: float = Field(2.0, gt=0)
    """Of RANSAC for the relative orientation."""
    share: float = Field(0.6, gt=0, le=1)
    """Share of corners that must agree with it."""
    least_known: int = Field(8, ge=1)
    """Points that the cameras of a rig place at one instant from which these tell the length of the base line."""
    least_left: float = Field(0.2, gt=0, lt=1)
    """Share of the corners that must still be there: else it is tried from the present frame on."""


class RecallTuning(Section):
    """Known places seen again (`recall.py`)."""

    patience: int = Field(3, ge=1)
    """Frames in a row without a pose after which a new segment is begun."""
    recent: int = Field(2, ge=1)
    """Keyframes before a loss that are looked at."""
    candidates: int = Field(3, ge=1)
    """Keyframes of all whose thumbnails are most alike that are looked at."""
    alike: float = Field(0.6, gt=-1, lt=1)
    """Correlation of thumbnails from which."""
    thumbnail: tuple[int, int] = (40, 24)
    """Columns and rows of a thumbnail (Klein and Murray 2008, who took 40 x 30)."""
    apart: int = Field(20, ge=1)
    """Keyframes between two that may close a loop: nearer ones share points anyway."""
    least_points: int = Field(25, ge=8)
    """Points that must agree with the pose for it to be the same place."""
    ratio: float = Field(0.8, gt=0, lt=1)
    """Distance of the best over that of the second best descriptor (Lowe 2004)."""
    patch_px: float = Field(12.0, gt=0)
    """Size of the key points that are described at the corners; upright."""
    scales: tuple[float, ...] = (0.71, 1.0, 1.41)
    """Of the key points of the frame that is looked for: it may stand nearer or farther."""
    sigma: float = Field(0.01, gt=0)
    """Sigma of the place that is told, in distances of the points, above which it is not."""
    inlier_px: float = Field(4.0, gt=0)
    """Of the pose by matched points: corners are found again to a pixel or two."""


class Tuning(Section):
    """Constants of the engine that are the same for every user."""

    follow: FollowTuning = Field(default_factory=FollowTuning)
    pose: PoseTuning = Field(default_factory=PoseTuning)
    map: MapTuning = Field(default_factory=MapTuning)
    start: StartTuning = Field(default_factory=StartTuning)
    recall: RecallTuning = Field(default_factory=RecallTuning)
