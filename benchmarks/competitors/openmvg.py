"""Competitor: openMVG (package openmvg-rs) with its defaults: a folder of images and one camera matrix for all, if any.

It knows neither rigs nor masks, and takes one matrix without distortion or what EXIF says.
"""

import json
import os
from pathlib import Path

import numpy as np
from command import arguments

from tiegraph.papers.measured import Stages

import pycolmap  # isort: skip


def main() -> None:
    """Link the images into one folder, reconstruct, and write the model under the images' own names."""
    args = arguments(__doc__)
    stages = Stages(args.json)
    try:
        import openmvg_rs
    except ImportError:
        return stages.end("openmvg-rs is not installed: pip install openmvg-rs")
    names = _flat(args.images, args.out / "images")
    if args.cameras:
        matrix = _matrix(json.loads(args.cameras.read_text()))
        if matrix is None:
            return stages.end("cameras differ or have distortion: openMVG takes one matrix for all images")
        np.savetxt(args.out / "images" / "K.txt", matrix)
    try:
        found = stages.run("sparse", lambda: openmvg_rs.reconstruct(args.out / "images", progress=False))
    except openmvg_rs.OpenMVGError as error:
        return stages.end(f"{type(error).__name__}: {error}")
    found.write_colmap(args.out)
    folder = args.out / "sparse" / "0"
    model = pycolmap.Reconstruction(folder)
    for image in model.images.values():
        image.name = names[Path(image.name).name]
    model.write(str(folder))
    stages.data |= {"models": [str(folder)], "software": {"openmvg-rs": openmvg_rs.__version__}}
    stages.end()


def _flat(images: Path, target: Path) -> dict[str, str]:
    """Links to all images in one folder, without blanks, at which it ends a name; the old name of each."""
    target.mkdir(parents=True)
    names = {}
    for path in sorted(p for p in images.rglob("*") if p.is_file()):
        old = path.relative_to(images).as_posix()
        new = old.replace("/", "__").replace(" ", "_")
        names[new] = old
        os.symlink(path.resolve(), target / new)
    return names


def _matrix(cameras: dict[str, dict]) -> np.ndarray | None:
    """(3, 3) that all cameras share; None if they differ or are no pinholes."""
    matrices = []
    for given in cameras.values():
        camera = pycolmap.Camera(**given)
        if camera.model.name not in ("PINHOLE", "SIMPLE_PINHOLE"):
            return None
        matrices.append(camera.calibration_matrix())
    return matrices[0] if all(np.allclose(m, matrices[0]) for m in matrices) else None


if __name__ == "__main__":
    main()
