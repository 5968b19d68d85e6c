"""Paper 003's table on real sets: pairs by prior poses against exhaustive matching (pairs, matching time, points).

    python -m benchmarks.network.paper003 kitti_stereo pandaset oppaiyama --work WORK

The trajectory of KITTI and PandaSet is their own ground truth or INS, written as a user would have it; Oppaiyama has
the GPS of its EXIF. Feature extraction and mapping are the same for both; dense points are left out (paper 003 found
them equal), the points counted are those of the sparse model.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import time
from pathlib import Path

import numpy as np

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import datasets

from tiegraph.geometry import transforms
from tiegraph.scene.trajectory import write_tum

SETS = ("kitti_stereo", "pandaset", "oppaiyama")
REFERENCE = {"kitti_stereo": "image_l", "pandaset": "front_camera"}  # the camera whose pose is the rig's
PAPER = (  # paper 003, table 2: set, pairs exhaustive, pairs by poses, image matching s, s, points, points
    ("paper ID 1", 10440, 2864, 1344, 318, 6_044_488, 6_033_970),
    ("paper ID 2", 4656, 369, 559, 42, 3_135_355, 3_427_755),
    ("paper ID 3", 3240, 374, 357, 47, 2_329_981, 2_119_187),
    ("paper ID 4", 24753, 7512, 2469, 775, 10_104_306, 9_766_795),
    ("paper ID 5", 6903, 1378, 716, 161, 1_990_045, 2_982_274),
    ("paper ID 6", 6441, 1440, 696, 167, 6_928_877, 6_231_082),
)


def trajectory_of(dataset: datasets.Dataset, work: Path) -> Path | None:
    """TUM file of the reference camera's poses, one a frame; None where the images hold their own positions."""
    camera = REFERENCE.get(dataset.name)
    if camera is None:
        return None
    names = sorted(n for n in dataset.cam_from_world if n.startswith(f"{camera}/"))
    poses = np.stack([transforms.invert(dataset.cam_from_world[n]) for n in names])
    times = np.arange(len(names), dtype=float)
    if dataset.times is not None:
        rows = [line.split(",") for line in dataset.times.read_text().splitlines()[1:]]
        stamp = {name: float(t) for name, t in rows}
        times = np.array([stamp[n] for n in names])
    path = work / "trajectory.tum"
    write_tum(path, times, poses)
    return path


def run_one(dataset: datasets.Dataset, source: str, out: Path, trajectory: Path | None) -> dict[str, float]:
    """Run up to the sparse model with one pair source; what the paper's table needs of the receipts."""
    command = ["tiegraph", "run", str(dataset.images), "-o", str(out), "--until", "sparse"]
    command += ["--network.sources", source, "--network.no-model", "--design.method", "all"]
    if dataset.rig is not None:
        command += ["--rig", str(dataset.rig)]
    if dataset.times is not None:
        command += ["--times", str(dataset.times)]
    if trajectory is not None:
        command += ["--trajectory", str(trajectory)]
    start = time.perf_counter()
    subprocess.run(command, check=True)
    receipt = {s: json.loads((out / "receipts" / f"{s}.json").read_text()) for s in ("match", "network", "sparse")}
    return {
        "pairs": receipt["match"]["counts"]["asked"],
        "verified": receipt["match"]["counts"]["verified"],
        "match_s": receipt["match"]["seconds"],
        "network_s": receipt["network"]["seconds"],
        "images": receipt["sparse"]["counts"].get("images", 0),
        "points": receipt["sparse"]["counts"].get("points", 0),
        "total_s": time.perf_counter() - start,
    }


def table(rows: dict[str, dict[str, dict[str, float]]]) -> str:
    """Markdown in the paper's shape: conventional | proposed."""
    out = ["| set | searched pairs | image matching s | points | images |", "|---|---|---|---|---|"]
    for name, pairs_a, pairs_b, time_a, time_b, points_a, points_b in PAPER:
        out.append(
            f"| {name} (dense points) | {pairs_a} / {pairs_b} | {time_a} / {time_b} | {points_a} / {points_b} | |"
        )
    for name, both in rows.items():
        a, b = both["exhaustive"], both["poses"]
        out.append(
            f"| {name} | {a['pairs']:.0f} / {b['pairs']:.0f} | {a['match_s']:.1f} / {b['match_s']:.1f} (+ network "
            f"{b['network_s']:.1f}) | {a['points']:.0f} / {b['points']:.0f} | {a['images']:.0f} / {b['images']:.0f} |"
        )
    return "\n".join(out)


def main() -> None:
    """Run the sets that are named, write results.json and print the table."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("sets", nargs="*", default=SETS)
    parser.add_argument("--work", type=Path, required=True)
    arguments = parser.parse_args()
    rows: dict[str, dict[str, dict[str, float]]] = {}
    for name in arguments.sets:
        dataset = datasets.load(name, arguments.work / "user")
        trajectory = trajectory_of(dataset, arguments.work / "user" / name)
        rows[name] = {
            source: run_one(dataset, source, arguments.work / f"{name}_{source}", trajectory)
            for source in ("exhaustive", "poses")
        }
        (arguments.work / "paper003.json").write_text(json.dumps(rows, indent=1))
    sys.stdout.write(table(rows) + "\n")


if __name__ == "__main__":
    main()
