"""What sfm/world decides by: each constant with its unit, its meaning and where its value comes from."""

from __future__ import annotations

from tiegraph.settings import Section


class WorldTuning(Section):
    """Constants of sfm/world."""
