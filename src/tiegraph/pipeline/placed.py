"""How the model lies in the world, read from what georef wrote."""

from __future__ import annotations

from tiegraph.geometry.geodesy import Origin
from tiegraph.geometry.placement import PlacementError
from tiegraph.pipeline.files import load_json
from tiegraph.project.run import Run


def world_origin(run: Run) -> Origin | None:
    """Where the world is on the Earth: by the scene's positions, or by control points alone."""
    data = load_json(run.path("world.json")).get("origin")
    return None if data is None else Origin.from_dict(data)


def world_unit(run: Run) -> str:
    """Unit of lengths in the world: m, or "units" where nothing told the scale."""
    return "units" if load_json(run.path("world.json"))["scale_source"] == "none" else "m"


def placement_error(run: Run) -> PlacementError | None:
    """How well the placement is known; None = not placed."""
    data = load_json(run.path("world.json")).get("placement_error")
    return None if data is None else PlacementError.from_dict(data)
