"""The rolling shutter that the first models of finished runs show; a set without times as SET@SECONDS, a frame.

python -m benchmarks.sfm.shutter canal=RUN kitti_stereo@0.1=RUN pandaset=RUN -o FILE
"""

from __future__ import annotations

from pathlib import Path
from typing import Any

import tiegraph  # noqa: F401  before pycolmap
from benchmarks.sfm.finished import arguments, each_run
from tiegraph.pipeline.files import load_model, load_scene
from tiegraph.sfm.finish import find_readout
from tiegraph.sfm.tuning import Tuning


def measure(name: str, folder: Path, scratch: Path) -> dict[str, Any]:
    """Readout, sigma and gain of a run's first model, and whether it would be told or used."""
    scene, tuning = load_scene(folder / "network" / "scene.json"), Tuning()
    set_name, _, interval_s = name.partition("@")
    if interval_s:
        scene = scene.with_(time_s=scene.sequence_index * float(interval_s))
    fixed = [k + 1 for k, rig in enumerate(scene.rigs) if rig.measured()]
    found = find_readout(load_model(folder / "sparse" / "0"), scene, fixed, tuning)
    if found is None:
        return {"set": set_name, "readout_ms": None}
    there = found.there(tuning.shutter)
    return {
        "set": set_name, "readout_ms": round(1000 * found.seconds, 2), "sigma_ms": round(1000 * found.sigma, 2),
        "gain": round(found.gain, 5), "told": there, "used": there and found.clear(tuning),
    }  # fmt: skip


if __name__ == "__main__":
    each_run(arguments(__doc__).parse_args(), measure)
