"""What dense decides by: each constant with its unit, its meaning and where its value comes from."""

from pydantic import Field

from tiegraph.settings import Section


class PartnerTuning(Section):
    """Which images are matched with which (`plan.py`)."""

    min_shared: int = Field(10, gt=0)
    """Sparse points two images share; below, angle and scale are anyone's guess."""
    max_angle_deg: float = Field(35.0, gt=0)
    """Median angle of intersection: semi-global matching fails on convergent images (paper 004, section 5.2.4)."""
    best_angles_deg: tuple[float, float] = (4.0, 12.0)
    """Full weight between these angles: intersection is sound, and the images still look alike."""
    max_scale: float = Field(2.0, ge=1)
    """Size of an object in one image over its size in the other, at most."""
    min_usable: float = Field(0.5, ge=0, le=1)
    """Share of the shared points outside the surroundings of the epipole."""
    enough: int = Field(2, gt=0)
    """A point seen by so many partners counts 0.3 for a further one: two confirm each other."""
    witnesses: int = Field(8, ge=0)
    """Images whose depth maps are compared, partners included."""


class PairTuning(Section):
    """Rectified pairs, and their way back into the reference image (`engine.py`)."""

    max_disparities: int = Field(1024, gt=0, le=2047)
    """A pair with more is matched at a coarser resolution; the 16-bit fixed point of the matcher ends at 2047."""
    max_pixels_ratio: float = Field(1.5, gt=0)
    """Rectified pixels per pixel of the reference, at most."""


class TsgmTuning(Section):
    """The hierarchical matcher (`tsgm.py`); benchmarks/dense/README.md says how its values were found."""

    radius_px: tuple[int, int] = (4, 3)
    """Of the census window, along the row and across."""
    small_jump: int = Field(20, ge=0)
    """Penalty of a disparity step of one pixel (P1)."""
    large_jump: int = Field(120, ge=0)
    """Penalty of larger steps (P2) where neighbouring pixels are equally bright; it falls with the grey step."""
    full_disparities: int = Field(256, gt=16)
    """Disparities at most of the level that is matched over its full range, and of a pixel where the coarser level has
    none. 512 of such a pixel find thin bars a little better in the same time, but then no strip of 192 rows is sure to
    stay within 300 MB."""
    strip_overlap_px: int = Field(64, gt=0)
    """Rows that strips of a level share: a path has nearly forgotten where it began."""
    kernel: str = ""
    """Name of a native kernel, or cuda; empty = the fastest of this machine. All give the same."""


class RayTuning(Section):
    """Partners and depth maps that say the same of a pixel (`engine.py`, `depth.py`)."""

    max_relative: float = Field(0.05, gt=0)
    """However coarse a pair is, depths further apart than this share of the depth are not the same surface."""
    sigma_px: float = Field(0.3, gt=0)
    """One standard deviation of a disparity where an image cannot tell its own: 0.2-0.3 in paper 004, and the larger
    figure also covers the smoothing of slanted surfaces."""
    shared_variance: float = Field(0.3, ge=0, lt=1)
    """Share of a disparity's variance that partners have in common, as they share the base image. On a rendered rig
    (exact truth) disparities err by 0.107-0.120 px and differ from each other by 0.085-0.099 px, on three images of
    canal by 0.15-0.23 and 0.11-0.24 px."""
    min_relative: float = Field(0.002, ge=0)
    """Agreement is never asked closer than this share of the depth: poses are not perfect."""
    vague_share: float = Field(0.005, ge=0)
    """A point whose sigma is more than this share of its depth needs one depth map more: where a pixel of disparity is
    a large share of the depth, depth maps agree by chance. On canal these were half of the ghosts and 2 % of the right
    depths."""


class Tuning(Section):
    """Constants of the engine that are the same for every user."""

    partners: PartnerTuning = Field(default_factory=PartnerTuning)
    pairs: PairTuning = Field(default_factory=PairTuning)
    tsgm: TsgmTuning = Field(default_factory=TsgmTuning)
    rays: RayTuning = Field(default_factory=RayTuning)
