"""Glue of the comparison of two passes of one run, without any reference: their clouds against each other.

Each is fused of the depth maps of its own images. The comparison shows how well both passes agree: poses across the
survey, and depth. It does not show errors common to both: the place and scale of the model, the cameras, and wrong
matches in both; and a depth map of one pass may have been confirmed by images of the other. The stage
``cloud`` compares some depth maps for the report (``write_agreement``), `compare --passes` all of them.

To keep the first cheap (5.7 CPU s on the example survey, 37 and 36 depth maps), the passes are not filtered, which
M3C2 does not need (mean places in cylinders are hardly affected by 3 % of strays), their voxels are those of the cloud,
and 5000 core points are enough. Half of the depth maps would leave one of the example's sections without any.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from dataclasses import dataclass
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tiegraph.cloud.fuse import FusionResult, Maps, fuse
from tiegraph.cloud.settings import CloudSettings
from tiegraph.errors import InputError, ReconstructionError
from tiegraph.evaluate.clouds.judge import PassAgreement, by_section, difference_map, near_places
from tiegraph.evaluate.clouds.nearest import Cameras
from tiegraph.geometry.transforms import centre
from tiegraph.pipeline.clouds import Pair, differences_of, m3c2_of
from tiegraph.pipeline.dense import depth_path, read_depth
from tiegraph.pipeline.evaluate import PASSES, measured
from tiegraph.pipeline.files import checked, load_model, world_origin
from tiegraph.project.run import Run
from tiegraph.project.stages import save_json, write_atomic
from tiegraph.scene.atomic import scratch_folder
from tiegraph.scene.cloudchunks import Points, PointSource, write_measured
from tiegraph.scene.colmapmodel import matrix
from tiegraph.scene.scene import Scene

Mapper = Callable[[Callable[[Any], Any], Sequence[Any]], Iterable[Any]]


@dataclass(frozen=True)
class _Pass:
    """A pass: its images that have depth maps, in the order of its path, and their positions (N, 3)."""

    name: str
    images: tuple[str, ...]
    centres: np.ndarray

    def where(self, rows: np.ndarray) -> "_Pass":
        """Some of the images."""
        return _Pass(self.name, tuple(self.images[k] for k in rows), self.centres[rows])


def compare_passes(run: Run, out: Path, depth_m: float | None = None) -> dict[str, Any]:
    """Compare the two passes with the most depth maps; writes what ``compare_epochs`` writes.

    Raises InputError for a run without depth maps of two passes.
    """
    scene = checked(run)
    found = _two_largest(run, scene)
    if len(found) < 2:
        raise InputError(
            f"{run.folder}: depth maps of {len(found)} passes, but two are needed: run it to the stage dense, with "
            "images of each pass in a folder of its own"
        )
    with scratch_folder() as scratch:
        pair = _pair(run, scene, found, scratch, run.settings.cloud, map)
        return differences_of(pair, out, run.settings.tuning.evaluate, depth_m)


def write_agreement(run: Run, scratch: Path, voxel_m: float, mapper: Mapper) -> PassAgreement | None:
    """Compare depth maps of the two largest passes, all of few and else some near places along the path, and write
    agreement.json, differences.png and differences.laz into the folder ``passes``; None for one pass.

    ``voxel_m``: of the cloud of both.
    """
    scene, tuning = checked(run), run.settings.tuning.evaluate
    there = _two_largest(run, scene)
    if len(there) < 2:
        return None
    rows = near_places(there[0].centres, there[1].centres, tuning.passes)
    used = [one.where(k) for one, k in zip(there, rows)]
    of: dict[str, Any] = {
        "passes": (used[0].name, used[1].name),
        "maps": (len(used[0].images), len(used[1].images)),
        "there": (len(there[0].images), len(there[1].images)),
    }
    folder = run.path(PASSES)
    try:
        pair = _pair(run, scene, used, scratch, run.settings.cloud.unfiltered(voxel_m), mapper)
        (scratch / "tiles").mkdir()
        found = m3c2_of(pair, scratch / "tiles", tuning, most=tuning.passes.cores)
    except (InputError, ReconstructionError) as error:
        agreement = PassAgreement(**of, found={}, why_not=str(error))
    else:
        agreement = PassAgreement(**of, found=by_section(found, pair.cameras))
        title = f"{used[1].name} minus {used[0].name}"
        write_atomic(folder / "differences.png", difference_map(found, title))
        write_measured([measured(found)], folder / "differences.laz", pair.origin, found.cylinders.cores_m)
    save_json(folder / "agreement.json", agreement.to_dict())
    return agreement


def _two_largest(run: Run, scene: Scene) -> list[_Pass]:
    """The two passes with the most depth maps, the largest first; fewer if there are fewer."""
    model = load_model(run.path("sparse", "world"))
    centres = {i.name: centre(matrix(i.cam_from_world())) for i in model.images.values() if i.has_pose}
    by_pass: dict[int, list[str]] = {}
    for k in np.lexsort((np.arange(len(scene)), scene.sequence_index[scene.frame])):
        name, sequence = scene.names[k], int(scene.sequence[scene.frame[k]])
        if sequence >= 0 and name in centres and depth_path(run.folder, name).exists():
            by_pass.setdefault(sequence, []).append(name)
    found = [_Pass(scene.sequences[s], tuple(n), np.array([centres[k] for k in n])) for s, n in by_pass.items()]
    return sorted(found, key=lambda one: (-len(one.images), one.name))[:2]


def _pair(
    run: Run, scene: Scene, passes: Sequence[_Pass], scratch: Path, settings: CloudSettings, mapper: Mapper
) -> Pair:
    """The clouds of two passes, fused of their depth maps into ``scratch``. Raises ReconstructionError for empty
    ones."""
    clouds: list[PointSource] = []
    maps = Maps(partial(read_depth, folder=run.folder))
    for one in passes:
        folder = scratch / str(len(clouds))
        folder.mkdir()
        tuning = run.settings.tuning.cloud
        fused = fuse(sorted(one.images), maps, folder, settings, tuning, world_origin(run.folder), mapper)
        clouds.append(PointSource(f"pass {one.name}", partial(_parts, fused)))
    sections = [int(scene.section[scene.frame[scene.image_index[n]]]) for n in passes[0].images]
    return Pair(
        first=clouds[0],
        second=clouds[1],
        cameras=Cameras(passes[0].centres, tuple(f"{s}" if s >= 0 else "(none)" for s in sections)),
        origin=world_origin(run.folder),
        held=f"in one model, pass {passes[1].name} minus pass {passes[0].name}: common errors of both do not show",
    )


def _parts(fused: FusionResult) -> Iterator[Points]:
    for part in fused.clouds():
        yield Points(part.xyz_m, part.sigma_m.astype(float))
