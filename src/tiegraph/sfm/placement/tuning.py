"""What sfm/placement decides by: each constant with its unit, its meaning and where its value comes from."""

from __future__ import annotations

from tiegraph.settings import Section


class PlacementTuning(Section):
    """Constants of sfm/placement."""
