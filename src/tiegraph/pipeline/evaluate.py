"""Glue of evaluate and report: model and cloud against references; receipts and artefacts become one page."""

from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

from tiegraph.errors import InputError
from tiegraph.evaluate.accuracy import accuracy_csv
from tiegraph.evaluate.clouds.judge import CloudJudgement, PassAgreement, difference_map
from tiegraph.evaluate.clouds.m3c2 import Differences
from tiegraph.evaluate.settings import EvaluateSettings
from tiegraph.evaluate.survey import Products, evaluate_survey
from tiegraph.geometry.geodesy import Origin
from tiegraph.geometry.transforms import Similarity
from tiegraph.pipeline.files import checked, load_json, load_model, reading, world_origin
from tiegraph.pipeline.georef import stated
from tiegraph.project.run import Run
from tiegraph.project.stages import Outcome, save_json, write_atomic
from tiegraph.scene.atomic import remove
from tiegraph.scene.cloudchunks import Measured, open_cloud, write_measured
from tiegraph.scene.cloudfile import shift_of
from tiegraph.scene.colmapmodel import registration
from tiegraph.text import command

PASSES = "passes"
"""Folder of the comparison of two passes by the stage ``cloud``."""


def evaluate(run: Run) -> Outcome:
    """Figures of merit of the model and the cloud, against references if they are given."""
    scene, settings = checked(run), run.settings.evaluate
    model = load_model(run.path("sparse", "world"))
    origin = world_origin(run.folder)
    receipt, cloud = run.receipts.read("cloud"), None
    counts = receipt.get("counts") or {}
    if receipt.get("made") and counts.get("points"):  # else the images gave none
        with reading(run.path("cloud.laz")):
            found = open_cloud(run.path("cloud.laz")).moved(lambda xyz: xyz - shift_of(origin))
        cloud = replace(found, name="the cloud")
    world = load_json(run.path("world.json"))
    tuning = run.settings.tuning
    images = registration(model, scene, tuning.scene.registered)
    placed = origin if world["placed"] else None
    scratch = run.path("evaluate", ".tiles")
    remove(scratch)
    if settings.reference_cloud is not None:
        scratch.mkdir(parents=True)
    made = Products(model=model, images=images, cloud=cloud, origin=placed, gsd_m=counts.get("voxel"), scratch=scratch)
    passes = run.path(PASSES, "agreement.json")
    agreement = PassAgreement(**load_json(passes)) if passes.exists() else None  # of one pass
    of_run, unfit = (tuning.evaluate, stated(run, counts), agreement), []
    try:
        found = evaluate_survey(scene, made, settings, *of_run)
    except InputError as error:
        unfit = [f"no reference is compared: {error}"]
        without = settings.model_copy(update={"reference": None, "reference_cloud": None})
        found = evaluate_survey(scene, made, without, *of_run)
    if found.cloud is not None:
        write_judgement(found.cloud, run.path("evaluate"), origin, found.alignment)
    result = found.metrics
    save_json(run.path("metrics.json"), result)
    tables = {**run.receipts.read("georef").get("tables", {}), **result["tables"]}
    write_atomic(run.path("accuracy.csv"), accuracy_csv(result, tables, world))
    shown = {"figures": sum(m["value"] is not None for m in result["metrics"]), "tables": len(result["tables"])}
    notes = tuple(n for n in result["notes"] if n.startswith("Reference"))  # which comparisons were possible
    return Outcome(shown, notes=notes, contradictions=(*unfit, *result["contradictions"]))


def evaluate_poses(run: Run, reference: Path, origin: tuple[float, float, float] | None) -> dict[str, Any]:
    """Poses of a run with a model in the world (``georef``) against reference poses: the content of metrics.json.

    Nothing is made or written. ``origin``: that of the reference's east-north-up metres. Raises InputError for a run
    without a model in the world, and for poses that cannot be read or matched.
    """
    world = run.path("sparse", "world")
    if not (world / "cameras.bin").exists():
        raise InputError(f"{run.folder}: there is no model in {world}: run `{command('georef', run.folder)}` first")
    scene, model, tuning = checked(run), load_model(world), run.settings.tuning
    settings = EvaluateSettings(reference=reference, reference_origin=origin)
    images = registration(model, scene, tuning.scene.registered)
    placed = world_origin(run.folder) if load_json(run.path("world.json"))["placed"] else None
    made = Products(model=model, images=images, cloud=None, origin=placed)
    return evaluate_survey(scene, made, settings, tuning.evaluate, stated(run, {})).metrics


def write_judgement(
    found: CloudJudgement, folder: Path, origin: Origin | None, alignment: Similarity | None = None
) -> None:
    """The map of differences, and both clouds with the measured values, into a folder: the judged one in its place
    before the ``alignment``, so that it lies on the run's cloud."""
    back = (lambda xyz: xyz) if alignment is None else alignment.inverse()
    differences, spacing = found.differences, found.nearest.criteria.voxel_m
    limit = found.nearest.criteria.ghost_m
    write_atomic(folder / "m3c2.png", difference_map(differences, "cloud minus reference"))
    parts = (Measured(back(xyz), {"distance_m": away}, (0.0, limit)) for xyz, away in found.nearest.points())
    write_measured(parts, folder / "distances.laz", origin, spacing)
    write_measured([measured(differences)], folder / "m3c2.laz", origin, spacing)


def measured(found: Differences) -> Measured:
    """The core points with difference, level of detection, and 1 where the difference is significant."""
    columns = {
        "distance_m": found.distance_m,
        "lod_m": found.lod_m,
        "significant": np.where(found.known, found.significant, np.nan),
    }
    limit = float(np.nanpercentile(np.abs(found.distance_m), 95)) if found.known.any() else 1.0
    return Measured(found.xyz, columns, (-limit, limit))


def report(run: Run) -> Outcome:
    """One HTML page from receipts and artefacts, and from plan.json if the user put one into the run folder."""
    from tiegraph.pipeline.plan import PLAN, compare  # the engines, which the other stage does not need
    from tiegraph.report.formatting import Table
    from tiegraph.report.html import write_report

    planned, notes = None, []
    if run.path(PLAN).is_file():
        try:
            found = compare(run.folder, None)
            planned = Table(found.columns, found.rows, (False, True, True, True), title=found.title)
            notes.append(f"planned and reached: {found.sentence}")
        except InputError as error:
            notes.append(str(error))
    path = write_report(run.folder, run.settings.report, planned)
    return Outcome({"bytes": path.stat().st_size}, notes=tuple(notes))
