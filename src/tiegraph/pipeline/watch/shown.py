"""Glue of watch: what the page shows, of scene, ties, poses and the surface of the last model."""

from typing import Any

import numpy as np

from tiegraph.design.surface import VERDICTS, SurfaceMap
from tiegraph.geometry import transforms
from tiegraph.pipeline.watch.model import CoarseModels
from tiegraph.scene.matches import PreviewMatches
from tiegraph.scene.scene import Scene
from tiegraph.watch.view import path_and_ties, plan_from_world, rounded

_PLACES = 20  # listed: more than anybody goes to again


def shown_scene(
    scene: Scene, ties: PreviewMatches, poses: np.ndarray, models: CoarseModels, least: int, drawn: int
) -> dict[str, Any]:
    """Path, ties, images without ties and surface for the page; ``least`` matches of a tie, ``drawn`` ties at most."""
    plan, scale = plan_from_world(poses, scene)
    places = transforms.apply(plan, transforms.centre(poses))
    by_model = np.array([name in models.of for name in scene.names], bool)
    out = path_and_ties(scene, ties, places, by_model, least, drawn)
    images = len(scene)
    out["counts"] = {
        "images": images, "tied": images - len(out["untied"]), "posed": int(np.isfinite(places[:, 0]).sum()),
    }  # fmt: skip
    known = (r for r in scene.rigs if len(r.sensors) > 1 and not r.nominal and r.known())
    out["metric"] = scale != 1.0 or any(known)
    out["surface"] = shown_surface(models, plan, scale)
    return out


def shown_surface(models: CoarseModels, plan: np.ndarray, scale: float) -> dict[str, Any]:
    """The map of the surface of the last model in the plan, and the places to go to again."""
    out: dict[str, Any] = {"verdicts": VERDICTS, "cells": [], "places": [], "shares": [], "side": 0.0}
    out["of"] = len(models.of)
    made = models.made
    if made is None or made.surface is None or not len(made.surface):
        return out
    surface = made.surface
    at = transforms.apply(plan, surface.xyz)
    out["cells"] = [[*rounded(xyz[:2]), int(v)] for xyz, v in zip(at, surface.verdict)]
    out["shares"] = list(surface.shares().values())
    out["side"] = surface.side * scale
    out["median"] = _typical(surface, np.arange(len(surface)), scale)
    for place in made.places[:_PLACES]:
        x, y, _ = transforms.apply(plan, place.xyz[None])[0]
        out["places"].append({
            "x": float(x), "y": float(y), "near": models.names[place.image], "verdict": place.verdict,
            "cells": len(place.cells), "area": len(place.cells) * out["side"] ** 2,
            **_typical(surface, place.cells, scale),
        })  # fmt: skip
    return out


def _typical(surface: SurfaceMap, cells: np.ndarray, scale: float) -> dict[str, float | None]:
    """Medians of some cells."""
    sigma = float(np.median(surface.sigma[cells])) * scale
    return {
        "images": float(np.median(surface.images[cells])),
        "angle": float(np.median(surface.angle_deg[cells])),
        "sigma": sigma if np.isfinite(sigma) else None,
    }
