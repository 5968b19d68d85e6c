"""What cloud decides by: each constant with its unit, its meaning and where its value comes from."""

from pydantic import Field

from tiegraph.settings import Section


class Tuning(Section):
    """Constants of the engine that are the same for every user."""

    sampled_maps: int = Field(50, gt=0)
    """Depth maps that decide the automatic voxel size."""
    held_medians: float = Field(10.0, gt=0)
    """The statistical filter holds distances at so many medians: a few points very far away would enlarge the deviation
    and save the others."""
    neighbours: int = Field(12, ge=3)
    """Nearest neighbours of the statistical filter."""
    radius_voxels: float = Field(3.0, gt=0)
    """Radius of the radius filter, in spacings of the point."""
