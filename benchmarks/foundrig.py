"""A rig that one half of a survey found, used on the other half, beside the rig as it was given.

    TIEGRAPH_DATA=... .venv/bin/python -m benchmarks.foundrig --sets pandaset canal_demo -o FILE --work DIR

The frames are halved in the order of their names. Each half is run with the rig of the set (``self``: it calibrates
itself) and with what `tiegraph rig` writes of the other half's run (``found``). ``--drawn`` gives the rig as a drawing:
no calibration, places to 0.1 m, angles to 5 degrees.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path

import numpy as np
from scipy.spatial.transform import Rotation

import tiegraph  # noqa: F401  before pycolmap
from benchmarks import datasets, variants
from benchmarks.confront.given import Given, of_dataset, write
from benchmarks.confront.sets import cut
from tiegraph.geometry import transforms
from tiegraph.pipeline.foundrig import rig_file
from tiegraph.scene.rig import Rig, Sensor

_DRAWN_M, _DRAWN_DEG = 0.1, 5.0


def drawn(rig: Rig) -> Rig:
    """The rig as a person would draw it: cameras unknown, places and angles rounded."""
    return replace(rig, sensors=tuple(_drawn(s) for s in rig.sensors), nominal=True, fixed=False)


def _drawn(sensor: Sensor) -> Sensor:
    if sensor.sensor_from_rig is None:
        return replace(sensor, camera=None)
    pose = transforms.invert(sensor.sensor_from_rig)
    angles = Rotation.from_matrix(pose[:3, :3]).as_euler("YXZ", degrees=True)
    turn = Rotation.from_euler("YXZ", np.round(angles / _DRAWN_DEG) * _DRAWN_DEG, degrees=True).as_matrix()
    place = np.round(pose[:3, 3] / _DRAWN_M) * _DRAWN_M
    return replace(sensor, camera=None, sensor_from_rig=transforms.invert(transforms.rigid(turn, place)))


def halves(given: Given) -> tuple[Given, Given]:
    """The first and the second half of the frames."""
    frames = len(given.in_order())
    return cut(given, 0, frames // 2), cut(given, frames // 2, frames)


def _dataset(given: Given, name: str, folder: Path) -> datasets.Dataset:
    return datasets.Dataset(name=name, cam_from_world=given.truth.cam_from_world, **write(given, folder))


def measure(name: str, as_drawn: bool, work: Path, book: variants.Book) -> None:
    """Four runs of a set, those that ``book`` does not have: each half with its rig, and with that of the other."""
    given = of_dataset(datasets.load(name, work / "datasets"))
    if given.rig is None or len(given.rig.sensors) < 2:
        raise SystemExit(f"{name}: no rig")
    if as_drawn:
        name, given = f"{name} drawn", replace(given, rig=drawn(given.rig))
    folder = work / name.replace(" ", "-")
    parts = [_dataset(half, name, folder / f"given{k}") for k, half in enumerate(halves(given))]
    for k, part in enumerate(parts):
        _kept(name, f"self {k + 1}", part, folder, book)
    for k, part in enumerate(parts):
        found = rig_file(folder / f"self {2 - k}")
        for line in found.said:
            sys.stderr.write(f"  {line}\n")
        rig = folder / f"found{k + 1}.toml"
        rig.write_text(found.text)
        _kept(name, f"found {k + 1}", replace(part, rig=rig), folder, book)


def _kept(name: str, variant: str, dataset: datasets.Dataset, folder: Path, book: variants.Book) -> None:
    if not book.has(name, variant):
        book.add(name, variants.Variant(variant), 0, variants.run(dataset, folder / variant, {}))


def main(argv: list[str] | None = None) -> int:
    """Measure what has no rows yet; a table to standard output."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sets", nargs="+", default=["pandaset"], choices=sorted(datasets.LOADERS))
    parser.add_argument("--drawn", action="store_true", help="give the rig as a drawing")
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("-o", "--output", type=Path, required=True)
    args = parser.parse_args(argv)
    book = variants.Book(args.output)
    for name in args.sets:
        measure(name, args.drawn, args.work, book)
    sys.stdout.write("| set | run | images | registered | ATE, mm |\n|---|---|---|---|---|\n")
    for row in book.rows:
        ate = f"{1000 * row['ate_m']:.1f}" if row.get("ate_m") is not None else row["status"]
        sys.stdout.write(
            f"| {row['set']} | {row['variant']} | {row.get('images')} | {row.get('registered')} | {ate} |\n"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
