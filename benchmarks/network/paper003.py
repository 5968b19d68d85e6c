"""Paper 003's table on real sets: pairs by prior poses against all pairs (pairs searched, matching time, points).

    python benchmarks/network/paper003.py --sets canal_demo kitti_stereo --work WORK -o benchmarks/results/paper003.json

Trajectories as a user would have them: ``canal`` and ``canal_demo`` their drifting odometry, one file a pass, laid
on GNSS; KITTI and PandaSet their poses (GNSS/INS) as one TUM file. Features and mapping are the same for both. Dense
points are left out (paper 003 found them equal); the points are those of the sparse model.
"""

from __future__ import annotations

import argparse
import sys
from dataclasses import replace
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np

from benchmarks import datasets, run
from benchmarks.network.measure import add_row, run_tiegraph
from tiegraph.geometry import transforms
from tiegraph.scan.trajectory import write_tum

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
        return replace(dataset, trajectory=odometry)
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


def one_run(dataset: datasets.Dataset, source: str, folder: Path) -> dict[str, Any]:
    """A run up to the sparse model with one pair source; what the paper's table needs of the receipts."""
    options = ["--until", "sparse", "--network.sources", source, "--network.no-model", "--design.method", "all"]
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
        "kept": stage["verify"]["counts"]["kept"],
        "network_cpu_s": stage["preview"]["cpu_s"] + stage["network"]["cpu_s"],
        "match_cpu_s": stage["match"]["cpu_s"],
        "sparse_cpu_s": stage["sparse"]["cpu_s"],
        "registered": sparse["registered"],
        "points": sparse["points"],
    }


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
    parser.add_argument("--work", type=Path, required=True, help="work folder; what is there is continued")
    parser.add_argument("--note", default="", help="said in the JSON, for instance what else the machine was doing")
    parser.add_argument("-o", "--output", type=Path, required=True, help="JSON file; runs are added to it")
    args = parser.parse_args(argv)
    results = run._load(args.output, args.note)
    for name in args.sets:
        (args.work / name).mkdir(parents=True, exist_ok=True)
        dataset = with_trajectory(datasets.load(name, args.work / "inputs"), args.work / name)
        for source in reversed(SOURCES):
            row = one_run(dataset, source, args.work / name / source)
            add_row(results, row, ("set", "source"), args.output)
            sys.stderr.write(f"{name} {source}: {row}\n")
    sys.stdout.write(table(results["runs"]) + "\n")
    return int(any(r["status"] != "done" for r in results["runs"]))


if __name__ == "__main__":
    sys.exit(main())
