"""What the report says of the georeference: heights, adjustment, control and check points."""

from __future__ import annotations

from typing import Any

from tiegraph.report import formatting


def sentences(world: dict[str, Any]) -> list[str]:
    """In words: what heights count from, what held the model, and how control and check points are met."""
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
    for role, name in (("gcp", "control"), ("check", "check")):
        found = (world.get("accuracy") or {}).get(role)
        if isinstance(found, dict):
            out.append(_accuracy(name, found))
    return out


def _accuracy(name: str, found: dict[str, float]) -> str:
    count = formatting.plural(int(found["points"]), f"{name} point")
    verb = "is" if int(found["points"]) == 1 else "are"
    text = f"{count} {verb} met within {formatting.length(found['rmse_plan_m'])} in plan and "
    text += f"{formatting.length(found['rmse_up_m'])} in height (RMSE); CE90 {formatting.length(found['ce90_m'])}, "
    text += f"LE90 {formatting.length(found['le90_m'])}"
    return text + (": an independent check." if name == "check" else ".")
