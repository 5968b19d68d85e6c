"""What the report says of the georeference: heights, lever arm, adjustment."""

from __future__ import annotations

from typing import Any

from tiegraph.report.texts import said, t


def sentences(world: dict[str, Any]) -> list[str]:
    """In words: what heights count from, the lever arm of the antenna, and whether the model was adjusted."""
    out = []
    if world.get("vertical") and world.get("placed"):
        text = said(str(world["vertical"]))
        out.append(t("{}.", text[0].upper() + text[1:]))
    arm = world.get("antenna_m")
    if world.get("placed") and isinstance(arm, list) and len(arm) == 3:
        given = ", ".join(f"{v:.2f}" for v in arm)
        out.append(t("The lever arm of the GNSS antenna is {} m in the frame of the rig's first camera.", given))
    if world.get("adjusted"):
        if (world.get("accuracy") or {}).get("gcp"):
            text = "The model was adjusted together with its positions and control points, not only shifted to them."
        else:
            text = "The model was adjusted together with its positions, not only shifted to them."
        out.append(t(text))
    return out
