"""What the mesh decides by: each constant with its unit and its meaning.

The values were chosen and looked at on the example survey; no benchmark has varied them yet.
"""

from pydantic import Field

from tiegraph.settings import Section


class SurfaceTuning(Section):
    """From points to triangles (`surface.py`)."""

    reach: float = Field(3.0, gt=0)
    """Gaps are bridged as far as this many details from the nearest point, or as its sigma allows (APART_SIGMAS)."""
    rim: float = Field(1.0, gt=0)
    """At its border the surface ends this many details from the nearest point."""
    border_rounds: int = Field(2, ge=0)
    """Times that teeth are taken off the border and it is smoothed."""
    least_share: float = Field(0.002, ge=0, lt=1)
    """Pieces with a smaller share of all faces are strays."""


class ViewTuning(Section):
    """Which image a face has its colour from (`views.py`)."""

    angle_power: float = Field(2.0, ge=0)
    """An image counts by its pixels on a face and by the cosine of its angle to it to this power, that of the
    orthophoto."""
    border: float = Field(0.05, gt=0, lt=0.5)
    """Nearer to the image border or mask than this share of the image size it counts less, in proportion."""
    unsure: float = Field(0.05, ge=0, le=1)
    """Weight of an image that may not see a face, beside one that does: its own depth map has no depth there, or from
    it the face lies behind others by less than the size of a face, as on a rough surface."""
    together: float = Field(4.0, ge=0)
    """How strongly neighbours want one image: a face goes along with all its neighbours unless its own best image is
    exp(4) times as good."""
    rounds: int = Field(30, ge=0)
    """Times that neighbours are asked; chosen, not measured."""
    least_faces: int = Field(30, ge=1)
    """Smaller patches go to an image of a neighbouring one that sees them."""


class TextureTuning(Section):
    """Textures and their colours (`texture.py`)."""

    most: int = Field(4, ge=1)
    """Textures at most: what viewers in a browser load without trouble."""
    smooth: float = Field(0.1, gt=0)
    """Weight of differences within a patch beside those across its border, when colours are levelled: chosen by eye on
    the example survey."""


class Tuning(Section):
    """Constants of the engine that are the same for every user."""

    surface: SurfaceTuning = Field(default_factory=SurfaceTuning)
    views: ViewTuning = Field(default_factory=ViewTuning)
    texture: TextureTuning = Field(default_factory=TextureTuning)
