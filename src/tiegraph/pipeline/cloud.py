"""Glue of cloud: the depth maps fused."""

from __future__ import annotations

from collections.abc import Callable, Iterable, Sequence
from functools import partial
from typing import Any

import numpy as np

from tiegraph.cloud.fuse import Maps, fuse
from tiegraph.pipeline.dense import coloured, depth_path, plan_of, read_depth
from tiegraph.pipeline.placed import placement_error, world_origin
from tiegraph.project.run import Run
from tiegraph.project.stages import Outcome, remove
from tiegraph.scene.atomic import same_file
from tiegraph.scene.cloudfile import write_cloud
from tiegraph.scene.copc import write_copc
from tiegraph.scene.results import Cloud

_EVERY = 50  # points of the cloud looked at for its sigma in the world


def cloud(run: Run) -> Outcome:
    """One cloud of all depth maps, tile by tile, as LAZ and PLY."""
    plans = {n: p for n, p in plan_of(run).images.items() if depth_path(run.folder, n).exists()}
    scratch = run.path(".tiles")
    remove(scratch)
    scratch.mkdir(parents=True)
    colours = coloured(plans, run.path("images"), run.settings.dense, run.settings.tuning.dense.views)
    maps = Maps(partial(read_depth, folder=run.folder), colours)
    settings, tuning = run.settings.cloud, run.settings.tuning.cloud
    fused = fuse(sorted(plans), maps, scratch, settings, tuning, world_origin(run), _mapper(run))
    notes = [*write_copc(fused.clouds, run.path("cloud.copc.laz"), fused.voxel, scratch)]
    same_file(run.path("cloud.copc.laz"), run.path("cloud.laz"))
    notes += write_cloud(fused.clouds(), run.path("cloud.ply"))
    world = _world_sigma(run, fused.clouds())
    remove(scratch)
    counts = {"points": fused.counts["points"], **{k: v for k, v in fused.counts.items() if k != "points"}, **world}
    return Outcome({**counts, "voxel": float(f"{fused.voxel:.3g}")}, notes=tuple(dict.fromkeys(notes)))


def _world_sigma(run: Run, parts: Iterable[Cloud]) -> dict[str, float]:
    """Median and 90th percentile of the points' sigma in the world: of the matching and of the placement together."""
    error, found = placement_error(run), []
    if error is None:
        return {}
    for part in parts:
        some = part.where(np.arange(0, len(part), _EVERY))
        placed = np.linalg.norm(error.sigma(some.xyz_m), axis=1)
        found.append(np.hypot(placed, np.nan_to_num(some.sigma_m)))
    both = np.concatenate(found) if found else np.zeros(0)
    if not len(both):
        return {}
    return {f"world_sigma_{n}_m": round(float(np.percentile(both, p)), 4) for n, p in (("median", 50), ("p90", 90))}


def _mapper(run: Run) -> Callable[[Callable[[Any], Any], Sequence[Any]], Iterable[Any]]:
    def apply(function: Callable[[Any], Any], items: Sequence[Any]) -> Iterable[Any]:
        run.reporter.total(len(items))
        return run.map(_call, list(items), function)

    return apply


def _call(item: Any, function: Callable[[Any], Any]) -> Any:
    return function(item)
