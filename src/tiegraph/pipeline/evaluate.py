"""Glue of evaluate: the result against what is known."""

from __future__ import annotations

from typing import Any

import numpy as np

from tiegraph.evaluate.accuracy import Hold, Predicted, Stated
from tiegraph.evaluate.accuracytable import accuracy_csv
from tiegraph.evaluate.settings import EvaluateSettings
from tiegraph.evaluate.survey import Products, evaluate_survey
from tiegraph.masks.compare import compare
from tiegraph.pipeline.files import FINAL, checked, load_json, load_model, reading
from tiegraph.pipeline.georef import covered_frames
from tiegraph.pipeline.placed import placement_error, world_origin
from tiegraph.project.run import Run, save_json
from tiegraph.project.stages import Outcome, write_atomic
from tiegraph.scene.cloudfile import read_cloud
from tiegraph.scene.registered import registration
from tiegraph.scene.scene import Scene


def evaluate(run: Run) -> Outcome:
    """Figures of merit of the masks, the model and the cloud, against references where they are given."""
    scene, settings = checked(run), run.settings.evaluate
    model = load_model(run.path("sparse", "world"))
    origin = world_origin(run)
    with reading(run.path("cloud.laz")):
        cloud = read_cloud(run.path("cloud.laz"), origin)
    world = load_json(run.path("world.json"))
    tuning = run.settings.tuning
    images = registration(model, scene, tuning.scene.registered)
    made = Products(model=model, images=images, cloud=cloud, origin=origin if world["placed"] else None)
    said = Stated(predicted(run, world, model), hold(run, scene, world), world, _rig(run))
    result = evaluate_survey(scene, made, settings, tuning.evaluate, said)
    if settings.reference_masks is not None:
        result["tables"]["mask accuracy"] = _masks(run, scene, settings)
    save_json(run.path("metrics.json"), result)
    tables = {**run.receipts.read("georef").get("tables", {}), **result["tables"]}
    write_atomic(run.path("accuracy.csv"), accuracy_csv(result, tables, world))
    counts = {"figures": sum(m["value"] is not None for m in result["metrics"]), "tables": len(result["tables"])}
    notes = tuple(n for n in result["notes"] if n.startswith("Reference"))  # what could be compared with what
    return Outcome(counts, notes=notes, contradictions=tuple(result["contradictions"]))


def predicted(run: Run, world: dict, model: Any) -> Predicted:
    """The run's own sigmas: of world.json, of its cameras' places in the world, of the points of its cloud."""
    sigma, inside = world.get("sigma") or {}, world.get("model_sigma") or {}
    half, most = inside.get("median", np.nan), inside.get("p90", np.nan)
    scale = sigma.get("scale", np.nan)
    if not sigma and world["scale_source"] != "none":  # not placed: the rig alone says how large it is
        rows = world.get("evidence", {}).get("rows", [])
        scale = next((row[3] for row in rows if row[0] == "scale"), np.nan)
    error, placed = placement_error(run), np.nan
    if error is not None:
        centres = np.array([i.projection_center() for i in model.images.values() if i.has_pose]).reshape(-1, 3)
        placed = float(np.sqrt(np.mean(np.sum(error.sigma(centres) ** 2, axis=1)))) if len(centres) else np.nan
    points = run.receipts.read("cloud").get("counts", {})
    return Predicted(
        inside_m=float(np.hypot(half, most) / np.sqrt(2)),
        scale=float(scale),
        placed_m=placed,
        point_m=points.get("sigma_median_m", np.nan),
        world_m=points.get("world_sigma_median_m", np.nan),
        world_90_m=points.get("world_sigma_p90_m", np.nan),
        between=np.array(world.get("between_frames") or []).reshape(-1, 2),
    )


_SOURCES = {"gnss": "GNSS positions", "exif": "the images' GPS positions", "trajectory": "the trajectory's positions"}


def hold(run: Run, scene: Scene, world: dict) -> Hold:
    """What holds the model in the world."""
    if not world["placed"]:
        return Hold(frames=scene.frames)
    rows = [row["frame"] for row in world["frames"] if row["inlier"]]
    source = _SOURCES.get(scene.prior, "positions")
    stated = scene.position_sigma_m[rows]
    if scene.prior == "gnss" and np.isfinite(stated).any():
        carrier = np.nanmedian(stated) <= run.settings.tuning.evaluate.carrier_m
        source += " of RTK quality" if carrier else ""
    without = np.setdiff1d(np.arange(scene.frames), rows)
    covered = covered_frames(run, scene)
    used = sum(row["role"] == "gcp" and row["off_m"] is not None and not row["why_not"] for row in world["control"])
    under = 0 if covered is None else int(covered[without].sum())
    return Hold(source=source, positions=len(rows), frames=scene.frames, covered=under, control=used)


def _rig(run: Run) -> tuple[float, float]:
    """Scatter of the cameras about their places in the rig and its expected value, metres, middle of the cameras."""
    table = run.receipts.read("sparse").get("tables", {}).get("rig diagnostics")
    if not table or not table["rows"]:
        return np.nan, np.nan
    at = [table["columns"].index(name) for name in ("scatter m", "expected m")]
    scatter, expected = (float(np.median([row[k] for row in table["rows"]])) for k in at)
    return scatter, expected


def _masks(run: Run, scene: Scene, settings: EvaluateSettings) -> dict:
    assert settings.reference_masks is not None
    cameras = {n: sensor for n, (_, sensor) in zip(scene.names, scene.image_label())}
    return compare(run.path(FINAL, "masks"), settings.reference_masks, cameras, settings.mask_labels).table()
