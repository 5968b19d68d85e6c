"""Glue of cloud: the depth maps fused."""

from collections.abc import Callable, Iterable, Mapping, Sequence
from functools import partial
from typing import Any

import numpy as np

from tiegraph.cloud.fuse import Maps, fuse
from tiegraph.evaluate.accuracy import in_layers
from tiegraph.pipeline.dense import coloured, depth_path, plan_of, read_depth
from tiegraph.pipeline.files import CLOUD, load_json, placement_error, world_origin
from tiegraph.pipeline.georef import stated
from tiegraph.project.run import Run
from tiegraph.project.stages import Outcome
from tiegraph.scene.atomic import remove, same_file
from tiegraph.scene.cloudfile import write_ply
from tiegraph.scene.copc import write_copc
from tiegraph.scene.results import LAYERS, Cloud


def cloud(run: Run) -> Outcome:
    """One cloud of all depth maps, tile by tile, as LAZ and PLY; and the agreement of two passes, if there are."""
    from tiegraph.pipeline.passes import write_agreement  # matplotlib, which no worker of this stage needs

    plans = {n: p for n, p in plan_of(run).images.items() if depth_path(run.folder, n).exists()}
    scratch = run.path(".tiles")
    remove(scratch)
    scratch.mkdir(parents=True)
    colours = coloured(plans, run.path("images"), run.settings.dense)
    maps = Maps(partial(read_depth, folder=run.folder), colours)
    settings, tuning = run.settings.cloud, run.settings.tuning.cloud
    fused = fuse(sorted(plans), maps, scratch, settings, tuning, world_origin(run.folder), _mapper(run))
    sigmas = _sigmas(run, fused.clouds())
    said = accuracy_said(run, sigmas)
    notes = [*write_copc(fused.clouds, run.path(CLOUD), fused.voxel, scratch, said)]
    same_file(run.path(CLOUD), run.path("cloud.laz"))
    notes += write_ply(fused.clouds(), run.path("cloud.ply"), said)
    agreement = write_agreement(run, scratch, fused.voxel, _mapper(run))
    if agreement is not None and agreement.why_not:
        notes.append(agreement.note())
    counts = {"points": fused.counts["points"], **{k: v for k, v in fused.counts.items() if k != "points"}, **sigmas}
    return Outcome({**counts, "voxel": float(f"{fused.voxel:.3g}")}, notes=tuple(dict.fromkeys(notes)))


def _sigmas(run: Run, parts: Iterable[Cloud]) -> dict[str, float]:
    """Median of the points' sigma, and median and 90th percentile of that in the world, if the model is placed: of
    the matching, of the cameras inside the model and of the placement together."""
    error, own, world = placement_error(run.folder), [], []
    inside = (load_json(run.path("world.json")).get("model_sigma") or {}).get("median", 0.0)
    for part in parts:
        some = part.where(np.arange(0, len(part), 50))  # points of the cloud sampled for its sigma in the world
        own.append(some.sigma_m)
        if error is not None:
            placed = np.linalg.norm(error.sigma(some.xyz_m), axis=1)
            world.append(np.sqrt(placed**2 + inside**2 + np.nan_to_num(some.sigma_m) ** 2))
    asked = {"sigma_median": (own, 50), "world_sigma_median": (world, 50), "world_sigma_p90": (world, 90)}
    there = {name: (np.concatenate(found), share) for name, (found, share) in asked.items() if found}
    known = {n: np.nanpercentile(v, share) for n, (v, share) in there.items() if np.isfinite(v).any()}
    return {f"{name}_m": round(float(value), 4) for name, value in known.items()}


def accuracy_said(run: Run, sigmas: Mapping[str, float]) -> str:
    """The accuracy stated in the files of clouds and rasters: the predicted one, because nothing is measured yet."""
    found = in_layers(stated(run, sigmas), ())
    heads = {name: found.head(layer).predicted for layer, name in LAYERS.items()}
    parts = [f"{name} {value:.3g} {found.unit}" for name, value in heads.items() if np.isfinite(value)]
    how = f"one standard deviation; held in the world by {found.held_by}; what was measured stands in metrics.json"
    return f"accuracy predicted: {', '.join(parts)} ({how})" if parts else ""


def _mapper(run: Run) -> Callable[[Callable[[Any], Any], Sequence[Any]], Iterable[Any]]:
    def apply(function: Callable[[Any], Any], items: Sequence[Any]) -> Iterable[Any]:
        run.reporter.total(len(items))
        return run.map(function, items)

    return apply
