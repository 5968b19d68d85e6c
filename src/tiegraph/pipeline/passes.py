"""Glue of `compare --passes`: the clouds of two passes of one run against each other, without any reference.

Each is fused of the depth maps of its own images. What this tells is how well both passes agree: poses across the
survey, and depth. What it does not tell is what both share: the place and scale of the model, the cameras, and what
matching got wrong in both; and a depth map of one pass may have been confirmed by images of the other.
"""

from __future__ import annotations

import tempfile
from collections.abc import Iterator
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tiegraph.cloud.fuse import FusionResult, Maps, fuse
from tiegraph.errors import InputError
from tiegraph.evaluate.clouds.nearest import Cameras
from tiegraph.geometry.transforms import centre
from tiegraph.pipeline.dense import coloured, depth_path, plan_of, read_depth
from tiegraph.pipeline.epochs import Pair, differences_of
from tiegraph.pipeline.files import checked
from tiegraph.pipeline.placed import world_origin
from tiegraph.project.run import Run
from tiegraph.scene.cloudchunks import Points, PointSource

_LEAST = 2  # passes


def compare_passes(run: Run, out: Path, depth_m: float | None = None) -> dict[str, Any]:
    """Compare the two passes with the most depth maps; writes what ``compare_epochs`` writes.

    Raises InputError for a run without depth maps of two passes.
    """
    scene = checked(run)
    plans = {n: p for n, p in plan_of(run).images.items() if depth_path(run.folder, n).exists()}
    by_pass: dict[str, list[str]] = {name: [] for name in scene.sequences}
    for name in sorted(n for n in plans if n in scene.image_index):
        sequence = scene.sequence[scene.frame[scene.image_index[name]]]
        if sequence >= 0:
            by_pass[scene.sequences[sequence]].append(name)
    chosen = sorted((n for n in by_pass if by_pass[n]), key=lambda n: (-len(by_pass[n]), n))[:_LEAST]
    if len(chosen) < _LEAST:
        raise InputError(
            f"{run.folder}: depth maps of {len(chosen)} passes, and two are needed: run it to the stage dense, with "
            "images of each pass in a folder of its own"
        )
    colours = coloured(plans, run.path("images"), run.settings.dense, run.settings.tuning.dense.views)
    maps = Maps(partial(read_depth, folder=run.folder), colours)
    with tempfile.TemporaryDirectory() as scratch:
        clouds: list[PointSource] = []
        for name in chosen:
            folder = Path(scratch, str(len(clouds)))
            folder.mkdir()
            fused = fuse(by_pass[name], maps, folder, run.settings.cloud, run.settings.tuning.cloud, world_origin(run))
            clouds.append(PointSource(f"pass {name}", partial(_parts, fused)))
        centres = centre(np.array([read_depth(n, run.folder).cam_from_world for n in by_pass[chosen[0]]]))
        pair = Pair(
            first=clouds[0],
            second=clouds[1],
            cameras=Cameras(centres, ("",) * len(centres)),
            origin=world_origin(run),
            held=f"in one model, pass {chosen[1]} minus pass {chosen[0]}: what both share is not told",
        )
        return differences_of(pair, out, depth_m)


def _parts(fused: FusionResult) -> Iterator[Points]:
    for part in fused.clouds():
        yield Points(part.xyz_m, part.sigma_m.astype(float))
