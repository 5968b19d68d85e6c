"""Settings of the design stage."""

from typing import Literal

from pydantic import Field

from tiegraph.settings import Section

MethodName = Literal["hybrid", "top", "all", "fuse2014", "fuse2014_safe"]


class DesignSettings(Section):
    """The candidate pairs that are matched at full resolution."""

    method: MethodName = "hybrid"
    """hybrid: pairs that join new tracks where the network is weak; top: the best pairs of each image; all: every kept
    pair; fuse2014: minimum cuts as in paper 002, which may disconnect; fuse2014_safe: the same, kept together."""
    budget: Literal["loss", "pairs"] = "loss"
    """Method hybrid stops at loss_percent (loss) or pairs_per_image (pairs)."""
    loss_percent: float = Field(5.0, ge=0, le=1000)
    """Budget loss: increase of the position sigma over using all candidates, by the previews, percent. Of loose
    photographs with few candidates all are matched."""
    pairs_per_image: int = Field(40, ge=1, le=1000)
    """Budget pairs: mean pairs of an image; method top: pairs kept by an image's own ranking."""
