"""What a run says of its own accuracy before anything measures it: by world.json, its model and its cloud."""

from collections.abc import Mapping

import numpy as np

from tiegraph.evaluate.accuracy import Hold, Predicted, Stated
from tiegraph.geometry.align import rms_length
from tiegraph.pipeline.files import checked, load_json, load_model, placement_error
from tiegraph.pipeline.georef import covered_frames
from tiegraph.project.run import Run
from tiegraph.scene.colmapmodel import model_centres

_SOURCES = {"gnss": "GNSS positions", "exif": "the images' GPS positions", "trajectory": "the trajectory's positions"}


def stated(run: Run, points: Mapping[str, float]) -> Stated:
    """All of it; ``points``: what the cloud's receipt counts of the sigmas of its points."""
    world = load_json(run.path("world.json"))
    predicted = _predicted(run, world, points)
    return Stated(predicted=predicted, hold=_hold(run, world), world=world, rig=_rig(run))


def _predicted(run: Run, world: dict, points: Mapping[str, float]) -> Predicted:
    sigma, inside = world.get("sigma") or {}, world.get("model_sigma") or {}
    half, most = inside.get("median", np.nan), inside.get("p90", np.nan)
    scale = sigma.get("scale", np.nan)
    if not sigma and world["scale_source"] != "none":  # not placed: the rig alone says how large it is
        rows = world.get("evidence", {}).get("rows", [])
        scale = next((row[3] for row in rows if row[0] == "scale"), np.nan)
    model, error = load_model(run.path("sparse", "world")), placement_error(run)
    centres = model_centres(model)
    return Predicted(
        inside_m=float(np.hypot(half, most) / np.sqrt(2)),
        scale=float(scale),
        spread_m=rms_length(centres - centres.mean(axis=0)),
        placed_m=np.nan if error is None else rms_length(error.sigma(centres)),
        point_m=points.get("sigma_median_m", np.nan),
        world_m=points.get("world_sigma_median_m", np.nan),
        world_90_m=points.get("world_sigma_p90_m", np.nan),
        between=np.array(world.get("between_frames") or []).reshape(-1, 2),
    )


def _hold(run: Run, world: dict) -> Hold:
    """What holds the model in the world."""
    scene = checked(run)
    if not world["placed"]:
        return Hold(frames=scene.frames)
    rows = [row["frame"] for row in world["frames"] if row["inlier"]]
    source, stated_m = _SOURCES.get(scene.prior, "positions"), scene.position_sigma_m[rows]
    if scene.prior == "gnss" and np.isfinite(stated_m).any():
        source += " of RTK quality" if np.nanmedian(stated_m) <= run.settings.tuning.evaluate.carrier_m else ""
    without = np.setdiff1d(np.arange(scene.frames), rows)
    covered = covered_frames(run, scene)
    under = 0 if covered is None else int(covered[without].sum())
    found = [row["role"] for row in world["control"] if row["off_m"] is not None and not row["why_not"]]
    points = {"control": found.count("gcp"), "checks": found.count("check")}
    return Hold(source=source, positions=len(rows), frames=scene.frames, covered=under, **points)


def _rig(run: Run) -> tuple[float, float]:
    """Scatter of the cameras about their places in the rig and its expected value, metres, middle of the cameras."""
    table = run.receipts.read("sparse").get("tables", {}).get("rig diagnostics")
    if not table or not table["rows"]:
        return np.nan, np.nan
    at = [table["columns"].index(name) for name in ("scatter m", "expected m")]
    scatter, expected = (float(np.median([row[k] for row in table["rows"]])) for k in at)
    return scatter, expected
