"""Settings of the stage filter."""

from typing import Literal

from tiegraph.settings import Section


class FilterSettings(Section):
    """View-graph filtering: matched pairs tested by the coarse model and by loops of rotations."""

    method: Literal["auto", "off"] = "auto"
    """auto: pairs of the coarse model by it, others by loops; off: all are kept."""
