"""What the search for coded targets decides by: each constant with its unit, its meaning and where it comes from."""

from pydantic import Field

from tiegraph.settings import Section


class Tuning(Section):
    """Constants of the engine that are the same for every user."""

    least_side_px: float = Field(16.0, gt=0)
    """Side of a target: of 8 bits across each then has two pixels, and fewer are not read reliably."""
    refine_share: float = Field(0.5, gt=0, lt=1)
    """Half window of the refinement of a corner, in the width of the border: at 0.8 those of targets that are turned
    reach the bits, and corners are off by pixels ..."""
    refine_px: tuple[int, int] = (2, 11)
    """... and its bounds."""
    looked_at: int = Field(60, gt=0)
    """Images that ``scan`` looks at, spread evenly, so that wrong names are said before hours of work."""
