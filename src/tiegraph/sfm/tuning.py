"""What sparse and georef decide by: each constant with its unit, its meaning and where its value comes from."""

from __future__ import annotations

from tiegraph.settings import Section
from tiegraph.sfm.placement.tuning import PlacementTuning
from tiegraph.sfm.rig.tuning import RigTuning
from tiegraph.sfm.start.tuning import StartTuning
from tiegraph.sfm.world.tuning import WorldTuning


class Tuning(Section):
    """Constants of the engine that are the same for every user."""

    start: StartTuning = StartTuning()
    """The start from poses that are roughly known."""
    placement: PlacementTuning = PlacementTuning()
    """The place of frames, tested, mended and completed."""
    rig: RigTuning = RigTuning()
    """The rig against the images."""
    world: WorldTuning = WorldTuning()
    """The model in the world."""
