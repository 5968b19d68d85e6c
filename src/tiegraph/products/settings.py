"""Settings of the products stage."""

from typing import Annotated, Literal

from pydantic import Field

from tiegraph.plugins import or_plugin
from tiegraph.settings import Section


class ProductsSettings(Section):
    """Delivered rasters: surface model, its sigma, true orthophoto; of a map, of elevations of walls, or unrolled."""

    make: Literal["auto", "none", "map", "elevations", "both", "undersides"] = "auto"
    """Rasters to make; auto = a map where cameras look down, elevations of the largest walls where they look
    sideways, and the undersides of what hangs over cameras, such as bridges."""
    pixel_m: float | None = Field(None, gt=0, le=1000)
    """Size of a pixel in metres (units of the model without georeference; default: by what the images resolve and how
    dense the points are, rounded up)."""
    plane: tuple[float, float, float, float] | None = None
    """A vertical reference plane instead of detected ones: east and north of its left and of its right end as
    seen from in front of it, in the CRS."""
    unroll: Literal["tunnel", "profile", "wall"] | None = None
    """Curved surfaces along the path of the cameras, unrolled, instead of elevations: the lining of a round tunnel or
    pipe, that of a tube with any other profile, or walls beside the path, such as curved quays or a round tower."""
    objects_m: float = Field(40.0, gt=0, le=1000)
    """For a map: trees, cars and houses up to this width, metres, are removed from the terrain model; wider objects in
    every direction, such as a hall or a closed forest, stay in it. Terrain is interpolated to half of this."""
    extra: tuple[Annotated[str, or_plugin("products", None)], ...] = ()
    """Plug-ins that make something of each surface too, in a folder of their name beside its rasters."""
