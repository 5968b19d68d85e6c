"""The sets of the ladder (``sets.toml``): what a user has of each, and what only the evaluation sees."""

from __future__ import annotations

import sys
from dataclasses import dataclass
from pathlib import Path

import numpy as np
from PIL import Image

from benchmarks.datasets import Dataset, Mark, exif_truth
from tiegraph.errors import InputError
from tiegraph.geometry import transforms
from tiegraph.scene.exif import orientation_of
from tiegraph.scene.gcp import read_gcps
from tiegraph.scene.rig import Copy, Sensor

import pycolmap  # isort: skip

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

FILE = Path(__file__).with_name("sets.toml")
_SUFFIXES = (".jpg", ".jpeg", ".png", ".tif", ".tiff")


@dataclass(frozen=True)
class Survey:
    """A set as ``sets.toml`` has it."""

    name: str
    repository: str
    images: str
    kind: str
    camera: str
    size: tuple[int, int]
    count: int
    licence: str
    truth: str = ""
    gcp: str = ""
    px_of_marks: float = 1.0
    marks_turned: bool = False
    below_mib: float = float("inf")
    mixed: bool = False

    def folder(self, root: Path) -> Path:
        """Where it lies below ``root``. Raises InputError with the command that fetches it."""
        folder = root / self.repository.partition("/")[2]
        if not folder.is_dir():
            raise InputError(f"{self.name}: git clone --depth 1 https://github.com/{self.repository} {folder}")
        return folder

    def files(self, root: Path) -> dict[str, Path]:
        """Its images by name. Raises InputError if they are not as many as the ladder has."""
        folder = self.folder(root) / self.images
        found = sorted(p for p in folder.rglob("*") if p.suffix.lower() in _SUFFIXES)
        kept = [p for p in found if p.stat().st_size < self.below_mib * 2**20]
        if len(kept) != self.count:
            raise InputError(f"{self.name}: {len(kept)} images in {folder}, the ladder has {self.count}")
        return {p.relative_to(folder).as_posix(): p for p in kept}


def surveys() -> dict[str, Survey]:
    """All sets by name, small ones first."""
    return {name: Survey(name=name, **row) for name, row in tomllib.loads(FILE.read_text()).items()}


def load(survey: Survey, root: Path, work: Path) -> Dataset:
    """The set, with links to its images in ``work``/``name``."""
    files, images = survey.files(root), work / survey.name
    for name, path in files.items():
        link = images / name
        link.parent.mkdir(parents=True, exist_ok=True)
        if not link.is_symlink():
            link.symlink_to(path.resolve())
    folder = survey.folder(root)
    truth, origin = exif_truth(files) if survey.truth == "exif" else ({}, None)
    if survey.truth and survey.truth != "exif":
        truth = middlebury(folder / survey.truth)
    gcp = folder / survey.gcp if survey.gcp else None
    return Dataset(
        name=survey.name,
        images=images,
        cam_from_world=truth,
        truth_origin=origin,
        gcp=gcp,
        marks=_marks(gcp, files, Copy(1 / survey.px_of_marks, survey.marks_turned)) if gcp else (),
    )


def middlebury(path: Path) -> dict[str, np.ndarray]:
    """cam_from_world (4, 4) by image: a line ``name k11 .. k33 r11 .. r33 t1 t2 t3`` each."""
    rows = [line.split() for line in path.read_text().splitlines()[1:] if line.strip()]
    numbers = {row[0]: np.array(row[10:22], float) for row in rows}
    return {name: transforms.rigid(n[:9].reshape(3, 3), n[9:]) for name, n in numbers.items()}


def _marks(path: Path, files: dict[str, Path], copy: Copy) -> tuple[Mark, ...]:
    """Marks of the images of the set, in pixels of the full upright image, by surveyed place."""
    found = read_gcps(path)
    lookup = {Path(name).name.lower(): name for name in files}
    place = {p.name: (float(x), float(y), float(z)) for p in found.points for x, y, z in [p.xyz]}
    marks = []
    for mark in found.marks:
        name = lookup.get(Path(mark.image).name.lower())
        if name is not None:
            with Image.open(files[name]) as image:
                turned, (wide, high) = orientation_of(files[name]), image.size
            size = (high, wide) if turned > 4 else (wide, high)
            upright = pycolmap.Camera.create_from_model_name(1, "SIMPLE_PINHOLE", 1.0, *size)
            marks.append(Mark(name, place[mark.name], copy.pixel(mark.xy, Sensor("", upright), turned), turned))
    return tuple(marks)
