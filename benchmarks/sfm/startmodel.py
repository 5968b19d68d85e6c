"""Runs that go on from a model (``--start``) beside one that does not: images, trajectory error, pairs, CPU.

    TIEGRAPH_DATA=... .venv/bin/python -m benchmarks.sfm.startmodel --set canal_demo --rig ladybug5 --work DIR -o FILE
    TIEGRAPH_DATA=... .venv/bin/python -m benchmarks.sfm.startmodel --set fountain-P11 --start MODEL --work DIR -o FILE

Variants: ``without``; ``started`` from MODEL (default: the model of ``without``); from the same with half of its images
turned by 20 degrees about the first of them (``turned``), three times as far from it (``stretched``), and with the
poses of all images exchanged (``shuffled``). The set's GNSS and calibration are not given. Runs are kept in DIR; one
that is finished is only measured. ``covisible``: of the pairs that share at least 15 points in MODEL, the share that
stage candidates kept, whatever their source, and that source ``poses`` alone proposed.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
from itertools import combinations
from pathlib import Path
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

import tiegraph  # noqa: F401  before pycolmap
from benchmarks import datasets
from benchmarks.accuracy import evaluate
from tiegraph.pipeline import STAGES
from tiegraph.scan.priors.startmodel import read_start
from tiegraph.scene.colmapmodel import read_model
from tiegraph.scene.namedposes import find_start
from tiegraph.scene.pairs import Pairs, source_bit
from tiegraph.scene.scene import Scene

VARIANTS = ("without", "started", "turned", "stretched", "shuffled")
_TURN_DEG, _STRETCH, _SHARED = 20.0, 3.0, 15
_UNTIL = [s.name for s in STAGES].index("georef") + 1


def spoiled(poses: dict[str, np.ndarray], how: str) -> dict[str, np.ndarray]:
    """Poses (4, 4) world_from_camera by image, the second half of the names (frames, in each folder) spoiled."""
    names = sorted(poses)
    array = np.array([poses[n] for n in names])
    number = np.array([int("0" + "".join(c for c in Path(n).stem if c.isdigit())) for n in names])
    half = number >= np.median(number)
    pivot = array[half][0, :3, 3].copy()
    if how == "turned":
        up = -array[:, :3, 1].mean(axis=0)
        turn = Rotation.from_rotvec(np.radians(_TURN_DEG) * up / np.linalg.norm(up)).as_matrix()
        array[half, :3, 3] = (array[half, :3, 3] - pivot) @ turn.T + pivot
        array[half, :3, :3] = turn @ array[half, :3, :3]
    elif how == "stretched":
        array[half, :3, 3] = pivot + _STRETCH * (array[half, :3, 3] - pivot)
    elif how == "shuffled":
        array = array[np.random.default_rng(0).permutation(len(array))]
    return dict(zip(names, array))


def write_transforms(poses: dict[str, np.ndarray], path: Path) -> Path:
    """nerfstudio's transforms.json without cameras."""
    to_opengl = np.diag([1.0, -1.0, -1.0, 1.0])
    frames = [{"file_path": n, "transform_matrix": (p @ to_opengl).tolist()} for n, p in poses.items()]
    path.write_text(json.dumps({"frames": frames}))
    return path


def run(images: Path, out: Path, more: list[str]) -> None:
    """``tiegraph run`` up to georef."""
    command = [sys.executable, "-m", "tiegraph", "run", str(images), "-o", str(out), "--until", "georef", *more]
    subprocess.run(command, check=True, stdin=subprocess.DEVNULL, stdout=sys.stderr)


def figures(out: Path, dataset: datasets.Dataset, model: Path) -> dict[str, Any]:
    """Figures of a finished run; ``model``: the COLMAP model that others start from."""
    told = {s.name: json.loads((out / "receipts" / f"{s.name}.json").read_text()) for s in STAGES[:_UNTIL]}
    models = sorted((p for p in (out / "sparse").iterdir() if p.name.isdigit()), key=lambda p: int(p.name))
    found = evaluate(models, dataset)
    return {
        **{n: found[n] for n in ("images", "registered", "placed_by_rig", "components", "ate_m")},
        "cpu_s": round(sum(r["cpu_s"] for r in told.values()), 1),
        "candidates": told["candidates"]["counts"]["kept"],
        "pairs": told["match"]["counts"]["asked"],
        "verified": told["match"]["counts"]["verified"],
        "covisible": covisible(out, model),
        "contradictions": told["sparse"]["contradictions"],
        "said": [n for s in ("scan", "candidates", "sparse") for n in told[s]["notes"] if "start" in n or "prior" in n],
    }


def covisible(out: Path, model: Path) -> dict[str, float]:
    """Of the pairs that share points in a model, the share that candidates kept, and that ``poses`` proposed."""
    scene = Scene.from_json((out / "scene.json").read_text())
    index = {scene.source_name(k): k for k in range(len(scene))}
    shared: dict[tuple[int, int], int] = {}
    read = read_model(model)
    for point in read.points3D.values():
        seen = {index.get(read.images[e.image_id].name) for e in point.track.elements} - {None}
        for pair in combinations(sorted(k for k in seen if k is not None), 2):
            shared[pair] = shared.get(pair, 0) + 1
    wanted = {pair for pair, count in shared.items() if count >= _SHARED}
    with np.load(out / "candidates.npz") as data:
        pairs = Pairs.from_npz(dict(data))
    kept = pairs.where(pairs.dropped == 0)
    of_poses = kept.where((kept.source & source_bit("poses")) > 0)
    both = {n: set(zip(p.i.tolist(), p.j.tolist())) for n, p in (("kept", kept), ("poses", of_poses))}
    return {"pairs": len(wanted), **{n: round(len(wanted & p) / len(wanted), 4) for n, p in both.items()}}


def main(argv: list[str] | None = None) -> int:
    """Run what is not finished, measure, one JSON line a variant."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--set", required=True, choices=sorted(datasets.LOADERS))
    parser.add_argument("--rig", help="of tiegraph run")
    parser.add_argument("--start", type=Path, help="a COLMAP model (default: that of the run without)")
    parser.add_argument("--variants", nargs="+", default=VARIANTS, choices=VARIANTS)
    parser.add_argument("--work", type=Path, required=True)
    parser.add_argument("-o", "--output", type=Path, required=True)
    args = parser.parse_args(argv)
    dataset, work = datasets.load(args.set, args.work), args.work / f"{args.set}-start"
    work.mkdir(parents=True, exist_ok=True)
    given = ["--rig", args.rig] if args.rig else []
    rows = json.loads(args.output.read_text())["runs"] if args.output.exists() else []
    for variant in args.variants:
        model = find_start(args.start or work / "without")[1] if variant != "without" or args.start else None
        start = model
        if variant not in VARIANTS[:2]:
            assert model is not None
            start = write_transforms(spoiled(read_start(model).poses, variant), work / f"{variant}.json")
        run(dataset.images, work / variant, [*given, *(["--start", str(start)] if variant != "without" else [])])
        row = {"set": args.set, "variant": variant}
        row |= figures(work / variant, dataset, model or find_start(work / "without")[1])
        text = json.dumps(row).replace(str(work.resolve()), "DIR").replace(str(args.work.resolve()), "DIR")
        rows = [r for r in rows if (r["set"], r["variant"]) != (args.set, variant)] + [json.loads(text)]
        args.output.write_text(json.dumps({"runs": rows}, indent=1) + "\n")
        sys.stdout.write(text + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
