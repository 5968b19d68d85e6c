"""Settings of the cloud stage."""

from pydantic import Field

from tiegraph.settings import Section


class CloudSettings(Section):
    """One point cloud of all depth maps, without duplicates and outliers."""

    voxel_size: float = Field(0.0, ge=0, le=1000)
    """Spacing of the points in metres (units of the model without georeference); 0 = median size of a pixel on the
    object. Points known less well are spaced more widely."""
    max_relative_sigma: float = Field(0.03, gt=0, le=0.5)
    """Largest standard deviation of a point as a share of its distance to the camera."""
    statistical_ratio: float = Field(2.0, ge=0, le=20)
    """A point is dropped if its mean distance to its twelve neighbours exceeds the average by this many standard
    deviations; 0 = filter off."""
    radius_neighbours: int = Field(3, ge=0, le=100)
    """Neighbours a point must have within three spacings; 0 = filter off."""

    @property
    def filtered(self) -> bool:
        """Whether any filter is on."""
        return self.statistical_ratio > 0 or self.radius_neighbours > 0

    def unfiltered(self, voxel_size: float) -> "CloudSettings":
        """The same without filters, for voxels of this size."""
        return self.model_copy(update={"voxel_size": voxel_size, "statistical_ratio": 0.0, "radius_neighbours": 0})
