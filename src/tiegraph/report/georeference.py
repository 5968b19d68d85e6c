"""What the report says of the georeference: heights, lever arm, adjustment."""

from __future__ import annotations

from typing import Any


def sentences(world: dict[str, Any]) -> list[str]:
    """In words: what heights count from, the lever arm of the antenna, and whether the model was adjusted."""
    out = []
    if world.get("vertical") and world.get("placed"):
        text = str(world["vertical"])
        out.append(text[0].upper() + text[1:] + ".")
    arm = world.get("antenna_m")
    if world.get("placed") and isinstance(arm, list) and len(arm) == 3:
        given = ", ".join(f"{v:.2f}" for v in arm)
        out.append(f"The lever arm of the GNSS antenna is {given} m in the frame of the rig's first camera.")
    if world.get("adjusted"):
        out.append("The model was adjusted together with its positions and control points, not only shifted to them.")
    return out
