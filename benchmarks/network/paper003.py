"""Paper 003's table on real sets: pairs by prior poses against all pairs (pairs searched, matching time, points).

    python benchmarks/network/paper003.py --sets canal_demo kitti_stereo --work WORK -o benchmarks/results/paper003.json

Trajectories as a user would have them: ``canal`` and ``canal_demo`` their drifting odometry, one file a pass, laid
on GNSS, with the nominal rig in the axes of the same body (x forward, y left, z up); KITTI and PandaSet their poses
(GNSS/INS) as one TUM file. Both rows of a set run in one folder, so masks, previews and features are made once and
are the same. Dense points are left out (paper 003 found them equal); the points are those of the sparse model.
"""

from __future__ import annotations

import argparse
import json
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np

from benchmarks import datasets, run
from benchmarks.network.measure import add_row, run_tiegraph
from tiegraph.geometry import transforms
from tiegraph.scan.priors.trajectory import write_tum

SETS = ("canal_demo", "kitti_stereo", "pandaset")
SOURCES = ("exhaustive", "poses")
REFERENCE = {"kitti_stereo": "image_l", "pandaset": "front_camera"}  # the camera whose pose is the rig's
PAPER = (  # paper 003, table 2: set, pairs exhaustive, pairs by poses, image matching s, s, points, points
    ("paper ID 1", 10440, 2864, 1344, 318, 6_044_488, 6_033_970),
    ("paper ID 2", 4656, 369, 559, 42, 3_135_355, 3_427_755),
    ("paper ID 3", 3240, 374, 357, 47, 2_329_981, 2_119_187),
    ("paper ID 4", 24753, 7512, 2469, 775, 10_104_306, 9_766_795),
    ("paper ID 5", 6903, 1378, 716, 161, 1_990_045, 2_982_274),
    ("paper ID 6", 6441, 1440, 696, 167, 6_928_877, 6_231_082),
)


def with_trajectory(dataset: datasets.Dataset, work: Path) -> datasets.Dataset:
    """The set with its trajectory: its own odometry where it has some, else the poses of the reference camera."""
    odometry = dataset.images.parent / "sensors"
    if list(odometry.glob("vo_*.tum")):
        rig = _body_rig(odometry / "rig_nominal.json", work / "rig_body.toml")
        return replace(dataset, trajectory=odometry, rig=rig)
    names = sorted(n for n in dataset.cam_from_world if n.startswith(f"{REFERENCE[dataset.name]}/"))
    poses = np.stack([transforms.invert(dataset.cam_from_world[n]) for n in names])
    times = np.arange(len(names), dtype=float)
    if dataset.times is not None:
        rows = [line.split(",") for line in dataset.times.read_text().splitlines()[1:]]
        stamp = {name: float(t) for name, t in rows}
        times = np.array([stamp[n] for n in names])
    path = work / "trajectory.tum"
    write_tum(path, times, poses)
    return replace(dataset, trajectory=path, gnss=None)


def _body_rig(nominal: Path, path: Path) -> Path:
    """The nominal rig in the axes of the body that the odometry follows: else its poses are read as those of cam0."""
    lines = ['name = "ring"', 'axes = "flu"', "nominal = true"]
    for name, pose in sorted(json.loads(nominal.read_text()).items()):
        body = transforms.invert(
            transforms.from_quaternion_wxyz(np.array(pose["cam_from_body_qwxyz"]), pose["cam_from_body_t"])
        )
        lines += ["", "[[sensors]]", f'name = "{name}"', f'role = "{"up" if name == "cam5" else "side"}"']
        lines.append(f"body_from_sensor = {body[:3].tolist()}")
    path.write_text("\n".join(lines) + "\n")
    return path


def every_nth(dataset: datasets.Dataset, step: int, work: Path) -> datasets.Dataset:
    """The set with every ``step``-th frame of each camera only (links); for sets of one pass."""
    if step == 1:
        return dataset
    images = work / "images"
    kept = {}
    for camera in sorted({n.partition("/")[0] for n in dataset.cam_from_world}):
        (images / camera).mkdir(parents=True, exist_ok=True)
        own = sorted(n for n in dataset.cam_from_world if n.startswith(f"{camera}/"))[::step]
        for name in own:
            kept[name] = dataset.cam_from_world[name]
            if not (images / name).exists():
                (images / name).symlink_to((dataset.images / name).resolve())
    times = dataset.times
    if times is not None:
        rows = [r for r in times.read_text().splitlines() if r == "image,time" or r.partition(",")[0] in kept]
        times = work / "times.csv"
        times.write_text("\n".join(rows) + "\n")
    return replace(dataset, images=images, cam_from_world=kept, times=times)


def one_run(dataset: datasets.Dataset, source: str, folder: Path) -> dict[str, Any]:
    """A run up to the sparse model with one pair source; what the paper's table needs of the receipts."""
    options = ["--until", "sparse", "--candidates.sources", source, "--coarse.method", "off", "--design.method", "all"]
    said = run_tiegraph(dataset, folder, options)
    row: dict[str, Any] = {"set": dataset.name, "source": source, "images": len(dataset.cam_from_world)}
    if said["returncode"] != 0:
        return {**row, "status": "failed"}
    stage = {s["stage"]: s for s in said["stages"]}
    sparse = stage["sparse"]["counts"]
    return {
        **row,
        "status": "done",
        "pairs": stage["match"]["counts"]["asked"],
        "verified": stage["match"]["counts"]["verified"],
        "kept": stage["filter"]["counts"]["kept"],
        "network_cpu_s": stage["preview"]["cpu_s"] + stage["network"]["cpu_s"],
        "match_cpu_s": stage["match"]["cpu_s"],
        "sparse_cpu_s": stage["sparse"]["cpu_s"],
        "registered": sparse["registered"],
        "points": sparse["points"],
        "prior": _about_prior(folder / "out"),
    }


def _about_prior(out: Path) -> list[str]:
    """What the run says of its prior: by previews, whether it was believed."""
    notes = json.loads((out / "receipts" / "network.json").read_text())["notes"]
    return [n for n in notes if "prior" in n]


def table(rows: list[dict[str, Any]]) -> str:
    """Markdown in the paper's shape: all pairs / pairs by poses."""
    out = ["| set | searched pairs | matching s | choosing the pairs s | points | images registered |"]
    out += ["|" + "---|" * 6]
    for name, pairs_a, pairs_b, time_a, time_b, points_a, points_b in PAPER:
        out.append(
            f"| {name} (wall s, dense points) | {pairs_a} / {pairs_b} | {time_a} / {time_b} | below 1 | "
            f"{points_a} / {points_b} | |"
        )
    for name in dict.fromkeys(r["set"] for r in rows):
        both = {r["source"]: r for r in rows if r["set"] == name and r["status"] == "done"}
        a, b = both.get("exhaustive"), both.get("poses")
        if a is None or b is None:
            continue
        out.append(
            f"| {name} (CPU s, sparse points) | {a['pairs']} / {b['pairs']} | {a['match_cpu_s']:.0f} / "
            f"{b['match_cpu_s']:.0f} | {b['network_cpu_s']:.0f} | {a['points']} / {b['points']} | "
            f"{a['registered']} / {b['registered']} of {a['images']} |"
        )
    return "\n".join(out)


def main(argv: list[str] | None = None) -> int:
    """Run the sets that are named, add to the results and print the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sets", nargs="+", default=list(SETS), choices=("canal", *SETS), metavar="SET")
    parser.add_argument("--every", type=int, default=1, metavar="N", help="every N-th frame of kitti_stereo, pandaset")
    parser.add_argument("--sources", nargs="+", default=list(reversed(SOURCES)), choices=SOURCES, metavar="SOURCE")
    parser.add_argument("--work", type=Path, required=True, help="work folder; what is there is continued")
    parser.add_argument("--note", default="", help="said in the JSON, for instance what else the machine was doing")
    parser.add_argument("-o", "--output", type=Path, required=True, help="JSON file; runs are added to it")
    args = parser.parse_args(argv)
    results = run._load(args.output, args.note)
    for name in args.sets:
        (args.work / name).mkdir(parents=True, exist_ok=True)
        dataset = datasets.load(name, args.work / "inputs")
        if name in REFERENCE:
            dataset = every_nth(dataset, args.every, args.work / name)
        dataset = with_trajectory(dataset, args.work / name)
        for source in args.sources:
            row = one_run(dataset, source, args.work / name)
            if name in REFERENCE:
                row["every"] = args.every
            add_row(results, row, ("set", "source"), args.output)
            sys.stderr.write(f"{name} {source}: {row}\n")
    sys.stdout.write(table(results["runs"]) + "\n")
    return int(any(r["status"] != "done" for r in results["runs"]))


if __name__ == "__main__":
    sys.exit(main())
