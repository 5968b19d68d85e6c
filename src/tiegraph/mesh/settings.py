"""Settings of the mesh."""

from pydantic import Field

from tiegraph.settings import Section


class MeshSettings(Section):
    """A textured mesh of the finished cloud (GLB, OBJ, PLY)."""

    faces: int = Field(500_000, ge=100, le=20_000_000)
    """Triangles at most; a finer surface is simplified where it is flat."""
    detail_m: float | None = Field(None, gt=0, le=1000)
    """Size of the smallest shapes in metres (units of the model without georeference; default: twice the spacing of
    the points)."""
    max_sigma_m: float | None = Field(None, gt=0)
    """Points with a larger standard deviation, in the same unit, are left out, and the surface ends there."""
    texture_px: int = Field(8192, ge=256, le=16384)
    """Edge of a texture at most, in pixels; images are reduced until their parts fit on four of them."""
