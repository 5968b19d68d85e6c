"""Sets of `benchmarks.sigma` beside `datasets`: canals of any seed, and parts of close-range sets with known camera
poses (a light-field gantry, a hand-held Kinect, a ring of industrial cameras)."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from pathlib import Path

import numpy as np

from benchmarks import datasets
from tiegraph.geometry import transforms

DINO_VIEWS = 40  # neighbours on the hemisphere
KITCHEN_FRAMES = 60  # the first
RING_CAPTURE = "2016_10_24__17_43_02"  # of robovision_rig12, the first


def load(name: str, work: Path) -> datasets.Dataset:
    """A part of one of these sets or, by any other name, a set of ``datasets``; images are linked below ``work``.

    ``canal@FOLDER`` is a canal as `canal_generator` of the data sets renders it. Raises what ``datasets.load`` raises.
    """
    if name.startswith("canal@"):
        made = work / "canal"
        made.mkdir(parents=True, exist_ok=True)
        return datasets.LOADERS["canal"](Path(name.partition("@")[2]).resolve(), made)
    loader = LOADERS.get(name)
    if loader is None:
        return datasets.load(name, work)
    made = work / name
    made.mkdir(parents=True, exist_ok=True)
    return loader(datasets.data_root(), made)


def linked(files: Mapping[str, Path], folder: Path) -> Path:
    """The folder ``images`` below ``folder`` with links to files under these names."""
    for name, source in files.items():
        place = folder / "images" / name
        place.parent.mkdir(parents=True, exist_ok=True)
        place.unlink(missing_ok=True)
        place.symlink_to(source)
    return folder / "images"


def _dino(root: Path, work: Path) -> datasets.Dataset:
    folder = root / "dino"
    truth = {}
    for line in (folder / "dino_par.txt").read_text().splitlines():
        name, *numbers = line.split()
        if len(numbers) == 21:
            v = np.array(numbers, float)
            truth[Path(name).stem + ".jpg"] = transforms.rigid(v[9:18].reshape(3, 3), v[18:])
    centres = {n: datasets.pose_centre(p) for n, p in truth.items()}
    middle = centres[sorted(centres)[len(centres) // 2]]
    near = sorted(centres, key=lambda n: float(np.linalg.norm(centres[n] - middle)))[:DINO_VIEWS]
    truth = {n: truth[n] for n in sorted(near)}
    return datasets.Dataset(
        name="dino_part", images=linked({n: folder / n for n in truth}, work), cam_from_world=truth,
        notes=("40 neighbouring views; no calibration given",),
    )  # fmt: skip


def _kitchen(root: Path, work: Path) -> datasets.Dataset:
    folder, truth, files = root / "rgbd_250", {}, {}
    for image in sorted(folder.glob("frame-*.color.jpg"))[:KITCHEN_FRAMES]:
        name = image.name.replace(".color", "")
        truth[name] = transforms.invert(np.loadtxt(folder / image.name.replace(".color.jpg", ".pose.txt")))
        files[name] = image
    return datasets.Dataset(
        name="rgbd_part", images=linked(files, work), cam_from_world=truth,
        notes=("first 60 frames; no calibration given; poses of KinectFusion: good to centimetres",),
    )  # fmt: skip


def _ring(root: Path, work: Path) -> datasets.Dataset:
    folder = root / "robovision_rig12" / RING_CAPTURE
    truth, files = {}, {}
    for path in sorted(folder.glob("extrinsics_camera*.txt")):
        number = path.stem.removeprefix("extrinsics_camera")
        pose = np.loadtxt(path).reshape(3, 4)
        truth[f"camera{number}.jpg"] = transforms.invert(transforms.rigid(pose[:, :3], pose[:, 3]))
        files[f"camera{number}.jpg"] = folder / f"image_camera{number}.jpg"
    return datasets.Dataset(
        name="ring", images=linked(files, work), cam_from_world=truth,
        notes=("one capture of twelve cameras as loose photographs; no calibration given",),
    )  # fmt: skip


LOADERS: dict[str, Callable[[Path, Path], datasets.Dataset]] = {
    "dino_part": _dino,
    "rgbd_part": _kitchen,
    "ring": _ring,
}
