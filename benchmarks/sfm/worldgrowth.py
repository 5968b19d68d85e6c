"""How the stage georef grows with a corridor: ``python -m benchmarks.sfm.worldgrowth --images 400 1600``.

``--antenna estimated``: the lever arm is an unknown of the adjustment, as where the positions tell one.

Simulated ring surveys (``corridor.py``) of so many images with RTK positions of 2 cm and an eighth of the way without;
the model is adjusted without positions before, and CPU time and the error in the world are those of what follows.
"""

from __future__ import annotations

import argparse
import sys
import time

import numpy as np

from benchmarks.sfm.corridor import Corridor, corridor
from tiegraph.scene.colmapmodel import image_poses
from tiegraph.scene.scene import Scene
from tiegraph.sfm.adjustment.adjust import final_adjustment
from tiegraph.sfm.model import frame_poses
from tiegraph.sfm.settings import GeorefSettings
from tiegraph.sfm.tuning import Tuning
from tiegraph.sfm.world.georeferencing import georeference_model

STEP_M, SIGMA_M = 2.0, 0.02


def placed(made: Corridor) -> tuple[Scene, np.ndarray]:
    """The scene with positions of the reference camera, and the frames (F,) without one."""
    frames = len(made.truth)
    gap = np.arange(frames) // max(frames // 8, 1) == 3
    pose = np.full((frames, 4, 4), np.nan)
    noise = SIGMA_M * np.random.default_rng(1).standard_normal((frames, 3))
    pose[~gap, :3, 3] = (made.truth[:, :3, 3] + noise)[~gap]
    sigma = np.full((frames, 3), SIGMA_M)
    return made.scene.with_(world_from_rig=pose, position_sigma_m=sigma, prior="gnss"), gap


def run(images: int, antenna: str) -> dict[str, float]:
    """Figures of one size."""
    made = corridor(STEP_M * images / 4, STEP_M)
    scene, gap = placed(made)
    model = final_adjustment(made.model, tuning=Tuning().adjust).model
    start = time.process_time()
    found, world = georeference_model(model, scene, GeorefSettings(antenna=antenna), Tuning())
    cpu = time.process_time() - start
    away = np.linalg.norm(frame_poses(image_poses(world, scene), scene)[:, :3, 3] - made.truth[:, :3, 3], axis=1)
    return {
        "images": len(scene),
        "observations": model.compute_num_observations(),
        "cpu_s": round(cpu, 1),
        "adjusted": found.adjusted,
        "error_mm": round(1000 * float(np.sqrt(np.mean(away[~gap] ** 2))), 1),
        "without_positions_mm": round(1000 * float(np.sqrt(np.mean(away[gap] ** 2))), 1),
    }


def main() -> None:
    """Print the figures of each size, and how the time grows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=int, nargs="+", default=[400, 1600])
    parser.add_argument("--antenna", choices=("ignored", "estimated"), default="ignored")
    asked, rows = parser.parse_args(), []
    for images in asked.images:
        rows.append(run(images, asked.antenna))
        sys.stdout.write(f"{rows[-1]}\n")
        sys.stdout.flush()
    if len(rows) > 1:
        power = np.polyfit(np.log([r["images"] for r in rows]), np.log([r["cpu_s"] for r in rows]), 1)[0]
        sys.stdout.write(f"CPU time grows with the images to the power of {power:.2f}\n")


if __name__ == "__main__":
    main()
