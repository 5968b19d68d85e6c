"""What sfm/rig decides by: each constant with its unit, its meaning and where its value comes from."""

from __future__ import annotations

from tiegraph.settings import Section


class RigTuning(Section):
    """Constants of sfm/rig."""
