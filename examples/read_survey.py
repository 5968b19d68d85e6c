"""What is in a folder of images: `python examples/read_survey.py OUT` reads the example survey into the run folder OUT.

Only the first stage runs, which takes seconds: no image is matched.
"""

import sys
from pathlib import Path

import numpy as np

import tiegraph

CANAL = Path(__file__).with_name("canal")


def main(out: str) -> None:
    """Print cameras, frames and positions of the survey, and what the stage has to say."""
    project = tiegraph.open(
        CANAL / "images", out=out, rig=CANAL / "rig.toml", gnss=CANAL / "gnss.csv", times=CANAL / "times.csv"
    )
    scene = project.run(until="scan").scene()
    print(f"{len(scene)} images in {scene.frames} frames")
    for sensor in scene.all_sensors:
        camera = sensor.camera
        print(
            f"  {sensor.name}: {camera.model_name} {camera.width} x {camera.height}" if camera else f"  {sensor.name}"
        )
    known = np.isfinite(scene.world_from_rig[:, :3, 3]).all(axis=1)
    print(f"{np.count_nonzero(known)} frames have a position")
    for note in project.receipt("scan")["notes"]:
        print(f"  note: {note}")


if __name__ == "__main__":
    main(sys.argv[1] if len(sys.argv) > 1 else "read_survey_out")
