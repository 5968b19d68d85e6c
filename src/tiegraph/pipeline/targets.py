"""Glue of coded targets: the images of a run, searched for the targets that its control point file names."""

from collections.abc import Sequence
from pathlib import Path

import pycolmap

from tiegraph.errors import InputError
from tiegraph.pipeline.files import read_image
from tiegraph.project.run import Run
from tiegraph.scene.gcp import GcpFile
from tiegraph.scene.scene import Scene
from tiegraph.scene.sorting import evenly
from tiegraph.targets.detect import Seen, find_targets
from tiegraph.targets.marks import OTHERS, TargetMarks, likely_family, marks_of
from tiegraph.targets.tuning import Tuning


def target_marks(
    run: Run, scene: Scene, file: GcpFile, model: pycolmap.Reconstruction | None = None, most: int | None = None
) -> TargetMarks:
    """Marks of the file's coded targets in the prepared images, ``most`` of them or all; by the cameras of a model
    where there is one.

    Raises InputError where none of them is seen in any image, with the family that is, if there is one.
    """
    named = file.targets
    if not named:
        return TargetMarks()
    tuning = run.settings.tuning.targets
    families = sorted({t.family for t in named.values()})
    images = evenly(len(scene), len(scene) if most is None else most).tolist()
    found = run.map(_search, [run.path("images", scene.names[k]) for k in images], families, tuning)
    seen = dict(zip(images, found))
    if not any(s.target in named.values() for one in found for s in one) and len(images) == len(scene):
        _say_family(run, scene, file, families, tuning)
    cameras = {} if model is None else {i.name: i.camera for i in model.images.values()}
    return marks_of(seen, named, lambda k: cameras.get(scene.names[k]), scene.names, tuning)


def _search(path: Path, families: Sequence[str], tuning: Tuning) -> list[Seen]:
    return find_targets(read_image(path), families, tuning)


def _say_family(run: Run, scene: Scene, file: GcpFile, families: Sequence[str], tuning: Tuning) -> None:
    """Raise InputError: no target is seen; with what else is."""
    images = evenly(len(scene), tuning.other_families_in).tolist()
    others = [f for f in OTHERS if f not in families]
    found = run.map(_search, [run.path("images", scene.names[k]) for k in images], others, tuning)
    likely = likely_family([s for one in found for s in one])
    first = next(iter(file.targets))
    remedy = f"but of {likely}: is that the family?" if likely else (
        f"and of no other family; a side of {tuning.least_side_px:g} px and a white margin are needed"
    )  # fmt: skip
    raise InputError(
        f"--gcp {file.path}: none of its {len(file.targets)} coded targets, such as {first}, is seen in any of "
        f"{len(scene)} images, {remedy}"
    )
