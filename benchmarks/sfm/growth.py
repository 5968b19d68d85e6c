"""How the sparse stage grows with a corridor: CPU time and memory of the start from rough poses and of what follows.

    python -m benchmarks.sfm.growth --images 300 1000 2000

Simulated ring surveys (``corridor.py``) of so many images; verified matches are the true ones between near frames, with
half a pixel of noise; the poses to start from drift as those of a coarse model do. Each size runs in a process of its
own, one thread, and is compared with the truth after a similarity.
"""

from __future__ import annotations

import argparse
import json
import resource
import subprocess
import sys
import tempfile
import time
from pathlib import Path

import numpy as np

import tiegraph  # noqa: F401  before pycolmap

import pycolmap  # isort: skip

from benchmarks.sfm.corridor import camera_of, drifted, path_of, pinhole, sights
from tiegraph.geometry import transforms
from tiegraph.geometry.align import umeyama
from tiegraph.scene.colmapmodel import image_poses
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene, simple_scene
from tiegraph.sfm.finish import finish_model
from tiegraph.sfm.rigcheck import FinishRequest, Held
from tiegraph.sfm.run import Method, Request, RigsUsed, run_mapper
from tiegraph.sfm.tuning import Tuning
from tiegraph.sfm.verified import MatchSource

STEP_M, POINTS_PER_M = 2.0, 30.0
APART = (1, 2, 3, 4, 6, 9)  # frames: pairs that are matched
LEAST = 15


def survey(frames: int, database: Path) -> tuple[Scene, np.ndarray, np.ndarray]:
    """Scene, true cam_from_world (N, 4, 4) and the drifted ones; writes the database of true matches."""
    rng = np.random.default_rng(0)
    s = STEP_M * np.arange(frames)
    truth, cameras = path_of(s), [camera_of(k) for k in range(4)]
    count = int(POINTS_PER_M * s[-1])
    base = path_of(rng.uniform(-10, s[-1] + 10, count))
    side = rng.choice([-1.0, 1.0], count)
    offset = np.stack([side * rng.uniform(9, 14, count), -rng.uniform(-1, 6, count), np.zeros(count)], axis=1)
    xyz = np.einsum("nij,nj->ni", base[:, :3, :3], offset) + base[:, :3, 3]
    seen = sights(truth, cameras, xyz, 0.0, rng)
    rig = Rig("ring", tuple(Sensor(f"cam{c}", pinhole(c + 1), p, folder=f"cam{c}") for c, p in enumerate(cameras)),
              nominal=True)  # fmt: skip
    names = [f"cam{c}/{k:05d}.jpg" for k in range(frames) for c in range(4)]
    order = np.argsort(names, kind="stable")
    frame, sensor = np.repeat(np.arange(frames), 4)[order], np.tile(np.arange(4), frames)[order]
    scene = simple_scene(rig, [names[k] for k in order], frame, sensor, np.zeros(frames), sequences=("up",))
    _write(database, scene, [seen[k] for k in order])
    place = np.stack(cameras)[sensor]
    return scene, *(place @ transforms.invert(p[frame]) for p in (truth, drifted(truth, rng)))


def _write(path: Path, scene: Scene, seen: list) -> None:
    image_at = {(int(f), int(s)): k for k, (f, s) in enumerate(zip(scene.frame, scene.sensor))}
    point = [np.array([p for p, _ in rows], int) for rows in seen]
    with pycolmap.Database.open(path) as database, pycolmap.DatabaseTransaction(database):
        for c in range(4):
            database.write_camera(pinhole(c + 1), use_camera_id=True)
        for k, rows in enumerate(seen):
            image = pycolmap.Image(name=scene.names[k], camera_id=int(scene.sensor[k]) + 1, image_id=k + 1)
            database.write_image(image, use_image_id=True)
            database.write_keypoints(k + 1, np.array([xy for _, xy in rows], np.float32).reshape(-1, 2))
        for (f, _), k in image_at.items():
            for j in (image_at.get((f + d, c), -1) for d in APART for c in range(4)):
                if j < 0:
                    continue
                _, a, b = np.intersect1d(point[k], point[j], assume_unique=True, return_indices=True)
                if len(a) >= LEAST:
                    geometry = pycolmap.TwoViewGeometry(
                        config=pycolmap.TwoViewGeometryConfiguration.CALIBRATED,
                        inlier_matches=np.stack([a, b], axis=1).astype(np.uint32),
                    )
                    database.write_two_view_geometry(k + 1, j + 1, geometry)


def run(images: int, torn: bool = False) -> dict[str, float]:
    """Figures of one size; ``torn``: the third sixth of the frames starts 8 m off along the way."""
    with tempfile.TemporaryDirectory() as name:
        folder = Path(name)
        scene, truth, rough = survey(images // 4, folder / "database.db")
        if torn:
            moved = scene.frame * 6 // scene.frames == 2
            ahead = np.ptp(transforms.centre(truth[moved]), axis=0)  # north-east there
            rough[moved] = rough[moved] @ transforms.rigid(np.eye(3), -8 * ahead / np.linalg.norm(ahead))
        clock = [time.process_time()]
        request = Request(
            method=Method("preview", poses=rough), matches=MatchSource(folder / "database.db", least=LEAST),
            rigs=RigsUsed((0,)), images=None, folder=folder / "run", scene=scene, tuning=Tuning(),
        )  # fmt: skip
        mapped = run_mapper(request, lambda frames: None)
        clock.append(time.process_time())
        if mapped.refused:
            raise SystemExit(mapped.refused)
        finish = FinishRequest(
            folder=mapped.folders[0], target=folder / "0", scene=scene, tuning=Tuning(), held=Held({0: "refined"}),
            matched=MatchSource(folder / "database.db"),
        )  # fmt: skip
        finish_model(finish, lambda message: None)
        clock.append(time.process_time())
        model = pycolmap.Reconstruction(folder / "0")
        found, true = transforms.centre(image_poses(model, scene)), transforms.centre(truth)
        there = np.isfinite(found).all(axis=1)
        error = np.linalg.norm(umeyama(found[there], true[there])(found[there]) - true[there], axis=1)
        start = np.linalg.norm(umeyama(transforms.centre(rough), true)(transforms.centre(rough)) - true, axis=1)
        return {
            "images": len(scene), "registered": int(there.sum()), "observations": int(model.compute_num_observations()),
            "start_cpu_s": round(clock[1] - clock[0], 1), "finish_cpu_s": round(clock[2] - clock[1], 1),
            "peak_mib": resource.getrusage(resource.RUSAGE_SELF).ru_maxrss // 1024,
            "rough_error_m": round(float(np.sqrt(np.mean(start**2))), 3),
            "error_m": round(float(np.sqrt(np.mean(error**2))), 3), "largest_m": round(float(error.max()), 3),
        }  # fmt: skip


def main(argv: list[str] | None = None) -> int:
    """Run the sizes and say how the time grows."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=int, nargs="+", default=[300, 1000, 2000])
    parser.add_argument("--torn", action="store_true", help="a sixth of the frames starts 8 m off along the way")
    parser.add_argument("--one", type=int, help=argparse.SUPPRESS)
    args = parser.parse_args(argv)
    pycolmap.logging.minloglevel = 2
    if args.one:
        sys.stdout.write(json.dumps(run(args.one, args.torn)) + "\n")
        return 0
    rows = []
    for images in args.images:
        command = [sys.executable, "-m", "benchmarks.sfm.growth", "--one", str(images), *["--torn"] * args.torn]
        done = subprocess.run(command, check=True, stdout=subprocess.PIPE, text=True)
        rows.append(json.loads(done.stdout.splitlines()[-1]))
        sys.stdout.write(json.dumps(rows[-1]) + "\n")
    size = np.log([r["images"] for r in rows])
    for key in ("start_cpu_s", "finish_cpu_s", "peak_mib") if len(rows) > 1 else ():
        power = np.polyfit(size, np.log([r[key] for r in rows]), 1)[0]
        sys.stdout.write(f"{key}: grows with the images to the power of {power:.2f}\n")
    return 0


if __name__ == "__main__":
    raise SystemExit(main())
