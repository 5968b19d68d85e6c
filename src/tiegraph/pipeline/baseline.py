"""Glue of `compare --baseline`: a block of a finished survey as a survey of its own, and the results of each method."""

from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from tiegraph.child import run_in_child
from tiegraph.errors import InputError
from tiegraph.evaluate.baseline import Reference, Side, compare_sides, stretch
from tiegraph.evaluate.reference import model_poses, read_reference_poses, reference_places
from tiegraph.papers import colmap, measured
from tiegraph.pipeline.files import checked, load_json, load_model
from tiegraph.project.artefacts import LOST
from tiegraph.project.folder import check_format
from tiegraph.project.run import Run
from tiegraph.project.stages import Stage, needed, save_json
from tiegraph.report.maps import frame_positions
from tiegraph.scene.atomic import remove
from tiegraph.scene.bags import source_of
from tiegraph.scene.colmapmodel import registered_images, registration
from tiegraph.scene.names import on_disk
from tiegraph.scene.scene import Scene
from tiegraph.sfm.covariance import position_sigma

BASELINES = ("conventional", "meguro2024", "meguro2025", "colmap")
UNTIL = "georef"
"""The last stage that counts: a model in the world. COLMAP ends with its model."""

_BLOCK, _OWN = "block.json", "tiegraph"


@dataclass(frozen=True)
class Block:
    """A part of a survey as a folder: ``images`` (links to the user's files) and a run folder of each method.

    ``scene``: the survey's, of these images alone; ``whole``: they are all its images, so the survey is its own side.
    """

    folder: Path
    run: Run
    scene: Scene
    whole: bool

    @property
    def images(self) -> Path:
        """The images, as in the user's folder; for a whole survey that folder."""
        return self.run.inputs.images if self.whole else self.folder / "images"

    @property
    def silent(self) -> tuple[str, ...]:
        """Inputs without data for these images: GNSS if all of them lie in an outage."""
        return () if self.run.inputs.gnss is None or self.scene.measured_positions().any() else ("gnss",)

    def side(self, name: str) -> Path:
        """The run folder of a method."""
        return self.run.folder if name == _OWN and self.whole else self.folder / name


def lay_out(run: Run, sample: int, out: Path) -> Block:
    """A block of about ``sample`` images of a finished run as links below ``out``; the same call again continues there.

    Raises InputError for a run without a model, images that are no files of the user's folder, and an ``out`` with
    other contents.
    """
    check_format(run.folder)
    if not run.path("sparse", "world").is_dir():
        raise InputError(f"{run.folder}: it has no sparse/world: run it to the stage {UNTIL} first")
    scene = checked(run)
    least = 3 * max(1, len(scene) // max(scene.frames, 1))
    if sample < least:
        raise InputError(f"--sample {sample}: give at least {least} images, three frames of this survey")
    centres = model_poses(load_model(run.path("sparse", "world")), scene).world_from_camera[:, :3, 3]
    taken = stretch(scene, frame_positions(scene, centres), sample)
    part = scene.only(taken)
    block = Block(folder=out, run=run, scene=part, whole=len(part) == len(scene))
    said = {"format": 1, "survey": str(run.folder), "images": [part.source_name(k) for k in range(len(part))]}
    path = out / _BLOCK
    if out.exists() and any(out.iterdir()) and not (path.exists() and load_json(path) == said):
        raise InputError(f"-o {out}: it contains other files than this block of {run.folder}: give another folder")
    root = source_of(run.inputs.images)
    if not block.whole:
        _link(root, block)
    out.mkdir(parents=True, exist_ok=True)
    save_json(path, said)
    return block


def _link(root: Path, block: Block) -> None:
    for name in sorted({block.scene.source_name(k) for k in range(len(block.scene))}):
        source, place = on_disk(root, name), block.images / name
        if source is None:
            raise InputError(
                f"{root / name}: no such file: a block is of a survey of images, not of videos or bags; run "
                f"{block.run.path('images')} as a survey and compare that"
            )
        place.parent.mkdir(parents=True, exist_ok=True)
        if not place.is_symlink():
            place.symlink_to(source.resolve())


def run_colmap(block: Block, images: Path) -> None:
    """COLMAP on the prepared images of the block. An unfinished step is begun again, because its times count."""
    out = block.side("colmap")
    record = out / "stages.json"
    if record.exists() and load_json(record)["status"] in (measured.DONE, measured.FAILED):
        return
    remove(out)
    out.mkdir(parents=True)
    run_in_child(colmap.exhaustive, images, out, record, log=out / "colmap.log", task="COLMAP")


def colmap_side(block: Block) -> Side:
    """COLMAP's result: its model with the most registered images."""
    said = load_json(block.side("colmap") / "stages.json")
    stages = {row["stage"]: (row["cpu_s"], row["wall_s"]) for row in said["stages"]}
    counts = {"pairs matched": said.get("pairs", {}).get("matched"), "models": len(said["models"])}
    models = [load_model(Path(folder)) for folder in said["models"]]
    return _side("COLMAP", block, models, stages, counts)


def run_side(block: Block, name: str, stages: tuple[Stage, ...]) -> Side:
    """The result of a run of tiegraph with the settings of ``name``: its model in the world, if there is one."""
    folder = block.side(name)
    run = Run(folder, block.run.inputs, block.run.settings)
    receipts = {s.name: run.receipts.read(s.name) for s in needed(stages, UNTIL)}
    done = {n: r for n, r in receipts.items() if "finished" in r}
    times = {n: (r["cpu_s"], r["seconds"]) for n, r in done.items()}
    sparse = done.get("sparse", {}).get("counts", {})
    counts = {"pairs matched": done.get("match", {}).get("counts", {}).get("asked"), "models": sparse.get("models")}
    world = folder / "sparse" / "world"
    models = [load_model(world)] if UNTIL in done else []
    return _side(name, block, models, times, counts)


def _side(
    name: str, block: Block, models: list[Any], stages: dict[str, tuple[float, float]], counts: dict[str, Any]
) -> Side:
    scene, tuning = block.scene, block.run.settings.tuning
    known = {n: v for n, v in counts.items() if v is not None}
    if not models:
        none, nothing, nowhere = (
            np.zeros(len(scene), bool),
            np.full(len(scene), np.nan),
            np.full((len(scene), 3), np.nan),
        )
        return Side(name, none, nowhere, sigma=nothing, stages=stages, counts=known)
    found = [registration(model, scene, tuning.scene.registered).registered for model in models]
    best = int(np.argmax([f.sum() for f in found]))
    model, known["points"] = models[best], models[best].num_points3D()
    centres = model_poses(model, scene).world_from_camera[:, :3, 3]
    return Side(name, found[best], centres, sigma=_sigma(model, block), stages=stages, counts=known)


def _sigma(model: pycolmap.Reconstruction, block: Block) -> np.ndarray:
    """(N,) sigma of each image's frame; the same estimator for both sides, and its time counts for neither."""
    out = np.full(len(block.scene), np.nan)
    if model.num_reg_frames() > block.run.settings.sparse.covariance_frames:
        return out
    try:
        found = position_sigma(model, tuning=block.run.settings.tuning.sfm)
    except (ValueError, RuntimeError):  # of an inverse too
        return out
    of_frame = dict(zip(found.frame_ids, np.linalg.norm(found.sigma, axis=1)))
    for k, image in registered_images(model, block.scene):
        out[k] = of_frame.get(image.frame_id, np.nan)
    return out


def judged(block: Block, name: str, stages: tuple[Stage, ...], notes: list[str]) -> dict[str, Any]:
    """The comparison of both sides, kept as ``<name>.json`` in the block's folder."""
    theirs = colmap_side(block) if name == "colmap" else run_side(block, name, stages)
    reference, said = _reference(block)
    section = [str(s) for s in block.scene.section[block.scene.frame]]
    result = compare_sides(run_side(block, _OWN, stages), theirs, reference, section)
    result["notes"] = [
        f"{len(block.scene)} images, a section of the path of {block.run.folder.name}"
        + (": all of it" if block.whole else f" of {len(checked(block.run))}; both methods ran on these alone"),
        said,
        *(["no frame of the block has a GNSS position: neither method was given any"] if block.silent else []),
        *notes,
    ]
    save_json(block.folder / f"{name}.json", result)
    return result


def _reference(block: Block) -> tuple[Reference, str]:
    settings, tuning = block.run.settings.evaluate, block.run.settings.tuning.evaluate.trajectory
    if settings.reference is not None:
        centres = reference_places(read_reference_poses(settings.reference), checked(block.run), tuning.max_gap_s)
        centres = centres[[checked(block.run).image_index[n] for n in block.scene.names]]
        there = int(np.isfinite(centres).all(axis=1).sum())
        said = f"errors against {settings.reference.name} ({there} of the images), after a similarity"
        return Reference(centres, True, tuning.within_m), said
    model = model_poses(load_model(block.run.path("sparse", "world")), block.scene)
    said = (
        "no reference poses: errors are differences from the poses of the whole survey's run, made by the method under "
        "test; errors common to both are not included"
    )
    return Reference(model.world_from_camera[:, :3, 3], False, tuning.within_m), said


def interrupted_note(block: Block, name: str, stages: tuple[Stage, ...]) -> str:
    """A sentence if the run of a method was interrupted and continued: its stage under way lost its first part."""
    mark, run = block.folder / f"{name}.interrupted", Run(block.side(name), block.run.inputs, block.run.settings)
    begun = run.folder.is_dir() and run.folder != block.run.folder
    if begun and not {"finished", LOST} & set(run.receipts.read(needed(stages, UNTIL)[-1].name)):
        mark.touch()
    return f"{name} was interrupted: its times are too short" if mark.exists() else ""
