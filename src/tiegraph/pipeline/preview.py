"""Glue of preview: SIFT of the reduced images."""

from pathlib import Path

from tiegraph.features.preview import Preview, extract_preview
from tiegraph.features.settings import PreviewSettings
from tiegraph.features.tuning import Tuning
from tiegraph.pipeline.files import load_npz, read_image, read_mask, reading, save_npz, scanned
from tiegraph.project.run import Run
from tiegraph.project.stages import Outcome


def preview(run: Run) -> Outcome:
    """Low-resolution features and brightness of every image, under its mask."""
    scene, settings, tuning = scanned(run), run.settings.preview, run.settings.tuning.features
    run.make_missing(_preview_item, scene.names, lambda n: preview_path(run.folder, n), run.folder, settings, tuning)
    return Outcome({"images": len(scene)})


def preview_path(folder: Path, name: str) -> Path:
    """Where the preview of an image is."""
    return folder / "preview" / f"{name}.npz"


def read_preview(folder: Path, name: str) -> Preview:
    """The preview of an image. Raises UnreadableArtefact."""
    path = preview_path(folder, name)
    with reading(path):
        return Preview.from_npz(load_npz(path))


def _preview_item(name: str, folder: Path, settings: PreviewSettings, tuning: Tuning) -> None:
    found = extract_preview(read_image(folder / "images" / name), read_mask(folder, name), settings, tuning)
    save_npz(preview_path(folder, name), **found.to_npz())
