"""Which images tie to which: `python examples/tie_graph.py OUT` makes the tie graph of the example survey.

Runs up to the stage `design`, some minutes: images are reduced, and nothing is matched at full resolution. OUT then
holds `pairs.txt`, a pair list for COLMAP, and `design/map.png`, a picture of the graph.
"""

import sys
from pathlib import Path

import tiegraph

CANAL = Path(__file__).with_name("canal")


def main(out: str) -> None:
    """Print how many pairs each filter left, and where the graph is weak."""
    project = tiegraph.open(
        CANAL / "images",
        out=out,
        rig=CANAL / "rig.toml",
        gnss=CANAL / "gnss.csv",
        times=CANAL / "times.csv",
        settings={"candidates": {"sequence_frames": 3}},
    )
    project.run(until="design")
    for what, count in project.pairs().funnel().items():
        print(f"{what}: {count} pairs")
    chosen = project.pairs().kept()
    fewest = chosen.degree(len(project.scene())).min()
    print(f"every image is in {fewest} of the {len(chosen)} chosen pairs, or more")
    for line in project.coverage().lines:
        print(line)


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "tie_graph_out")
