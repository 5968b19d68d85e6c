"""Glue of evaluate: the result against what is known."""

from __future__ import annotations

from tiegraph.evaluate.accuracytable import accuracy_csv
from tiegraph.evaluate.settings import EvaluateSettings
from tiegraph.evaluate.survey import Products, evaluate_survey
from tiegraph.masks.compare import compare
from tiegraph.pipeline.files import FINAL, checked, load_json, load_model, reading
from tiegraph.pipeline.placed import world_origin
from tiegraph.pipeline.predicted import stated
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
    said = stated(run, run.receipts.read("cloud").get("counts", {}))
    result = evaluate_survey(scene, made, settings, tuning.evaluate, said)
    if settings.reference_masks is not None:
        result["tables"]["mask accuracy"] = _masks(run, scene, settings)
    save_json(run.path("metrics.json"), result)
    tables = {**run.receipts.read("georef").get("tables", {}), **result["tables"]}
    write_atomic(run.path("accuracy.csv"), accuracy_csv(result, tables, world))
    counts = {"figures": sum(m["value"] is not None for m in result["metrics"]), "tables": len(result["tables"])}
    notes = tuple(n for n in result["notes"] if n.startswith("Reference"))  # what could be compared with what
    return Outcome(counts, notes=notes, contradictions=tuple(result["contradictions"]))


def _masks(run: Run, scene: Scene, settings: EvaluateSettings) -> dict:
    assert settings.reference_masks is not None
    cameras = {n: sensor for n, (_, sensor) in zip(scene.names, scene.image_label())}
    return compare(run.path(FINAL, "masks"), settings.reference_masks, cameras, settings.mask_labels).table()
