"""The command line that all competitors share; loads nothing, for what it loads counts as theirs."""

from __future__ import annotations

import argparse
from pathlib import Path


def arguments(description: str) -> argparse.Namespace:
    """The command line every competitor has; it ignores what it has no use for."""
    parser = argparse.ArgumentParser(description=description)
    parser.add_argument("--images", type=Path, required=True)
    parser.add_argument("--out", type=Path, required=True, help="empty work folder")
    parser.add_argument("--json", type=Path, required=True, help="where the figures go")
    parser.add_argument("--cameras", type=Path, help="JSON: image folder -> COLMAP camera; default: guessed by COLMAP")
    for name in ("rig", "gnss", "trajectory", "times", "gcp"):
        parser.add_argument(f"--{name}")
    parser.add_argument("--until", default="georef")
    parser.add_argument("--hold-rig", action="store_true", help="the extrinsics of the rig are not refined")
    parser.add_argument("--seed", type=int, default=0, help="of the mapper's random choices")
    parser.add_argument("--base", type=Path, help="folder of the same with another seed: only mapped anew")
    parser.add_argument("options", nargs="*", help="passed on to the competitor as they are")
    return parser.parse_args()
