"""What the search for coded targets decides by: each constant with its unit, its meaning and where it comes from."""

from pydantic import Field

from tiegraph.settings import Section


class Tuning(Section):
    """Constants of the engine that are the same for every user."""

    least_side_px: float = Field(16.0, gt=0)
    """Side of a target: of 8 bits across each then has two pixels, and fewer are not read reliably."""
    error_correction: float = Field(0.3, ge=0, le=1)
    """Share of a family's correctable bits that may be wrong; OpenCV's 0.6 finds small families in gravel."""
    bits: float = Field(8.0, gt=0)
    """... and how many of it make the side of an AprilTag 36h11; others are near."""
    refine_share: float = Field(0.5, gt=0, lt=1)
    """Half window of the refinement of a corner, in the width of the border: at 0.8 those of targets that are turned
    reach the bits, and corners are off by pixels ..."""
    refine_px: tuple[int, int] = (2, 11)
    """... and its bounds."""
    least_sigma_px: float = Field(0.06, gt=0)
    """Of a corner, however sharp and noiseless: sampling and blur, as in rendered images (tests/targets)."""
    apart_sides: float = Field(0.5, gt=0)
    """Sides of a target that two places of one name lie apart, to be two prints and not two outlines of one."""
    other_families_in: int = Field(12, gt=0)
    """Images that are searched for other families where none of those named is seen."""
    looked_at: int = Field(60, gt=0)
    """Images that ``scan`` looks at, spread evenly, so that wrong names are said before hours of work."""
