"""Canals of many seeds: frames that stand more than five of their own stated sigmas off, and whether that is told.

    .venv/bin/python -m benchmarks.sfm.canals --generator canal_generator/canal.py --python PYTHON --preset tiny \
        --seeds 1-40 --gnss given float none --work SCRATCH -o FILE

Each canal is rendered (``--python`` has numba; without its laser scans, which nothing here reads), run until georef
with the nominal rig, the times of its odometry and each kind of GNSS in turn, and removed: ``given`` (fixed, floating
and single, none below bridges), ``good`` (fixed everywhere), ``float`` (its places with the errors that the generator
gives to floating ones), ``none``, and ``images``: nothing but the images, no rig file either. Of each case one JSON
line is added to FILE; what stands there is not run again.

``shape``: frames whose place after the robust similarity to the truth is more than five sigmas off (``shape.npz``);
``world``: in the world, without any alignment (placement and shape together). ``told``: what sparse and georef say
contradicts, and how many frames they left out. ``right``: images within 0.1 m of the truth after that similarity.
"""

from __future__ import annotations

import argparse
import json
import shutil
import subprocess
import sys
import time
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np

import tiegraph  # noqa: F401  before pycolmap
from benchmarks import datasets, variants
from tiegraph.geometry.geodesy import Origin, geodetic_from_world, world_from_geodetic
from tiegraph.geometry.transforms import PlacementError, robust_umeyama
from tiegraph.scene.colmapmodel import read_model
from tiegraph.scene.scene import Scene
from tiegraph.sfm.shape import SHAPE, Shape

GNSS = ("given", "good", "float", "none", "images")
SIGMAS = 5.0
_RENDER = """
import sys; sys.path.insert(0, sys.argv[1])
import canal
canal.write_lidar = lambda *a, **k: 0
write, out = canal.write_sensors, sys.argv[2]
def sensors(out, made, poses, seed):
    bridges, made.bridge_s = made.bridge_s, [(1e9, 0.0)]
    write(out, made, poses, seed)
    (out / "sensors" / "gnss.csv").rename(out / "sensors" / "gnss_good.csv")
    made.bridge_s = bridges
    write(out, made, poses, seed)
canal.write_sensors = sensors
canal.generate(out, sys.argv[3], int(sys.argv[4]), workers=1, weather=float(sys.argv[5]), log=lambda s: None)
"""
_FLOAT_M, _SLOW = 0.35, 0.93  # of the generator: sigma of a floating place, what lasts of an error for 0.2 s
_UP = np.array([1.0, 1.0, 1.6])
_DEGREE_M = 111_320.0
_RIGHT_M = 0.1


def render(generator: Path, python: Path, preset: str, seed: int, weather: float, folder: Path) -> None:
    """A canal with its sensors and poses; depth maps and masks are not kept."""
    words = [str(python), "-c", _RENDER, str(generator.parent), str(folder), preset, str(seed), str(weather)]
    subprocess.run(words, check=True)
    for name in ("depth", "masks"):
        shutil.rmtree(folder / "gt" / name)
    _floating(folder / "sensors" / "gnss_good.csv", folder / "sensors" / "gnss_float.csv", seed)


def _floating(source: Path, target: Path, seed: int) -> None:
    """The places of a receiver with fixed ones, as it would have them floating."""
    rng, bias = np.random.default_rng([seed, 50]), np.zeros(3)
    head, *lines = source.read_text().splitlines()
    rows = [head]
    for line in lines:
        stamp, *place = line.split(",")[:4]
        bias = _SLOW * bias + rng.normal(0, 0.35 * _FLOAT_M, 3)
        east, north, up = bias + rng.normal(0, 0.2 * _FLOAT_M, 3) * _UP
        lat, lon, height = map(float, place)
        lat, lon = lat + north / _DEGREE_M, lon + east / (_DEGREE_M * np.cos(np.radians(lat)))
        rows.append(f"{stamp},{lat:.9f},{lon:.9f},{height + up:.4f},{_FLOAT_M:.3f},{1.6 * _FLOAT_M:.3f},5")
    target.write_text("\n".join(rows) + "\n")


def judged(dataset: datasets.Dataset, out: Path) -> dict[str, Any]:
    """Frames that are off, and what is told, of a finished run."""
    receipts = [json.loads((out / "receipts" / f"{stage}.json").read_text()) for stage in ("sparse", "georef")]
    counts, placed = receipts[0]["counts"], receipts[0]["tables"].get("placement", {"rows": []})["rows"]
    row: dict[str, Any] = {
        **{n: counts.get(n) for n in ("images", "registered", "frames", "models", "matches_explained_percent")},
        "left_out": [r[0] for r in placed], "told": [line for r in receipts for line in r["contradictions"]],
        "notes": [n for n in receipts[0]["notes"] if "frame" in n],
        "cpu_s": round(sum(json.loads(p.read_text()).get("cpu_s") or 0 for p in (out / "receipts").glob("*.json")), 1),
    }  # fmt: skip
    if not (out / "sparse" / SHAPE).exists():
        return {**row, "shape": None}
    scene = Scene.from_json((out / "network" / "scene.json").read_text())
    with np.load(out / "sparse" / SHAPE) as data:
        shape = Shape(**data)
    first = [np.flatnonzero(scene.frame == f)[scene.sensor[scene.frame == f].argmin()] for f in shape.index]
    names = [scene.names[k] for k in first]
    true = np.array([datasets.pose_centre(dataset.cam_from_world[n]) for n in names])
    fit, _ = robust_umeyama(shape.place, true, 0.02)
    row["shape"] = _off(fit(shape.place) - true, fit.scale * shape.sigma, names)
    poses = {i.name: i.projection_center() for i in read_model(out / "sparse" / "0").images.values() if i.has_pose}
    there = np.array([datasets.pose_centre(dataset.cam_from_world[n]) for n in poses])
    row["right"] = int(np.sum(np.linalg.norm(fit(np.array([*poses.values()])) - there, axis=1) < _RIGHT_M))
    world = json.loads((out / "world.json").read_text()) if (out / "world.json").exists() else {}
    if world.get("origin") and world.get("placement_error") and dataset.truth_origin is not None:
        origin = Origin.from_dict(world["origin"])
        there = world_from_geodetic(geodetic_from_world(true, dataset.truth_origin), origin)
        model = read_model(out / "sparse" / "world")
        images = {i.name: i.projection_center() for i in model.images.values() if i.has_pose}
        here, sigma = np.array([images[n] for n in names]), world["scale"] * shape.sigma
        error = PlacementError.from_dict(world["placement_error"])
        sigma = np.hypot(np.linalg.norm(error.sigma(here), axis=1), sigma)
        row["world"] = _off(here - there, sigma, names)
    return row


def _off(error: np.ndarray, sigma: np.ndarray, names: list[str]) -> dict[str, Any]:
    """Frames beyond so many sigmas, the worst z, the root mean squares of errors and sigmas, metres."""
    size = np.linalg.norm(error, axis=1)
    z = size / sigma
    off = {names[k]: [round(float(size[k]), 4), round(float(z[k]), 1)] for k in np.flatnonzero(z > SIGMAS)}
    rms, stated = (float(f"{np.sqrt(np.mean(v**2)):.3g}") for v in (size, sigma))
    return {"frames": len(z), "off": off, "worst_z": round(float(z.max()), 2), "rms_m": rms, "sigma_m": stated}


def main(argv: list[str] | None = None) -> int:
    """One JSON line a case."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--generator", type=Path, required=True)
    parser.add_argument("--python", type=Path, required=True, help="that can run the generator")
    parser.add_argument("--preset", default="tiny")
    parser.add_argument("--seeds", default="1-40", help="FIRST-LAST")
    parser.add_argument("--weather", type=float, default=0.5, help="0: repeated walls are exact copies")
    parser.add_argument("--gnss", nargs="+", default=GNSS, choices=GNSS)
    parser.add_argument("--keep", action="store_true", help="leave runs with frames that are off in the scratch folder")
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("-o", "--output", type=Path, required=True)
    args = parser.parse_args(argv)
    lines = args.output.read_text().splitlines() if args.output.exists() else []
    done = {(r["preset"], r["seed"], r["weather"], r["gnss"]) for r in map(json.loads, lines)}
    first, last = (int(n) for n in args.seeds.split("-"))
    for seed in range(first, last + 1):
        left = [g for g in args.gnss if (args.preset, seed, args.weather, g) not in done]
        if left:
            _cases(args, seed, left)
    return 0


def _cases(args: argparse.Namespace, seed: int, kinds: list[str]) -> None:
    folder = args.work / f"{args.preset}-{seed}-{args.weather:g}"
    shutil.rmtree(folder, ignore_errors=True)
    render(args.generator, args.python, args.preset, seed, args.weather, folder / "canal")
    dataset, bad = datasets.load(f"canal@{folder / 'canal'}", folder), False
    for kind in kinds:
        file = folder / "canal" / "sensors" / ("gnss.csv" if kind == "given" else f"gnss_{kind}.csv")
        out = folder / (kind if kind in ("none", "images") else "out")
        start, given = time.monotonic(), replace(dataset, gnss=file if file.exists() else None)
        given = replace(given, rig=None, times=None) if kind == "images" else given
        error = variants.start(given, out, "georef", {})
        row = {"preset": args.preset, "seed": seed, "weather": args.weather, "gnss": kind, "error": error}
        if not error:
            row |= judged(given, out)
            bad |= bool((row["shape"] or {}).get("off") or row.get("world", {}).get("off"))
        row["wall_s"] = round(time.monotonic() - start, 1)
        with args.output.open("a") as lines:
            lines.write(json.dumps(row) + "\n")
    if not (bad and args.keep):
        shutil.rmtree(folder)


if __name__ == "__main__":
    sys.exit(main())
