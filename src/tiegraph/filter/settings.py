"""Settings of the stage filter."""

from typing import Literal

from tiegraph.settings import Section


class FilterSettings(Section):
    """View-graph filtering: matched pairs tested by the coarse model."""

    method: Literal["auto", "off"] = "auto"
    """auto: pairs of images of the coarse model are tested by it; off: all are kept."""
