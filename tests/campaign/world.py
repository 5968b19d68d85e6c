"""The survey of the campaigns: the smallest that goes through all stages, every kind of input, and its clean runs."""

from __future__ import annotations

import hashlib
import json
import os
import shutil
import stat
import time
from dataclasses import dataclass, field
from pathlib import Path

import cv2
import numpy as np

import worlds
from campaign.process import Server
from tiegraph.geometry import transforms
from tiegraph.geometry.geodesy import geodetic_from_world
from tiegraph.pipeline import STAGES
from tiegraph.scan.rigfiles.rigspec import rig_config, write_rig_toml
from tiegraph.scene.atomic import MARK

NAMES = tuple(s.name for s in STAGES)
PATIENCE_S = 400.0  # for a whole run on a machine with other work; a clean one takes half a minute
SIZE, FRAMES = (192, 144), 3


@dataclass(frozen=True)
class World:
    """``inputs``: images/ and every other kind of input; ``clean``: stage -> the run folder as it is after it."""

    root: Path
    inputs: Path
    clean: dict[str, Path]
    seconds: dict[str, float]  # stage -> how long it took
    marks: dict[bytes, str] = field(default_factory=dict)  # the inputs' fingerprint

    def after(self, stage: str, to: Path) -> Path:
        """A copy of the run folder as it is after a stage ("" = an empty folder)."""
        if not stage:
            to.mkdir(parents=True)
            return to
        return Path(shutil.copytree(self.clean[stage], to, symlinks=True))

    def command(self, out: Path, *more: object, inputs: Path | None = None) -> list[str]:
        """The command line of the whole survey; a tenth of the points that it could have are enough."""
        at = inputs or self.inputs
        given = ["--gnss", at / "gnss.csv", "--times", at / "times.csv", "--rig", at / "rig.toml"]
        given += ["--cloud.voxel-size", "0.1"]
        return [str(word) for word in ("run", at / "images", "-o", out, *given, *more)]


def make(root: Path, server: Server, until: str = NAMES[-1]) -> World:
    """The inputs and the clean runs, below ``root``; what is there already is used again."""
    inputs = root / "inputs"
    if not inputs.exists():
        write_inputs(inputs)
    done = root / "seconds.json"
    if not done.exists():
        _clean_runs(root, server, until)
        time.sleep(0.05)
    seconds = json.loads(done.read_text())
    return World(root, inputs, {n: root / "clean" / n for n in seconds}, seconds, fingerprint(inputs))


def _clean_runs(root: Path, server: Server, until: str) -> None:
    """One run, whose folder the server copies after each stage: the next one starts from what the disk has."""
    clean = root / "clean"
    shutil.rmtree(clean, ignore_errors=True)
    clean.mkdir(parents=True)
    out, start = clean / "run", time.time()
    command = World(root, root / "inputs", {}, {}).command(out, "--pool", "serial", "--until", until)
    ended = server.run(command, root / "said", PATIENCE_S, copies=clean)
    if not ended.good:
        raise RuntimeError(f"the clean run failed: {ended}")
    shutil.copytree(out, clean / until, symlinks=True)
    lead = (out / MARK).stat().st_mtime - start  # a command's, whatever its stage
    names = NAMES[: NAMES.index(until) + 1]
    receipts = [json.loads((out / "receipts" / f"{name}.json").read_text()) for name in names]
    shutil.copyfile(root / "said" / "said.txt", clean / "said.txt")
    (root / "seconds.json").write_text(json.dumps({r["stage"]: lead + r["seconds"] for r in receipts}))


def write_inputs(folder: Path) -> None:
    """images/, gnss.csv, times.csv, rig.toml, rig_config.json, trajectory.tum, gcp.csv, gcp_list.txt, pairs.txt,
    masks/, reference.tum, reference.ply, model.toml, video/ and other.jpg (a picture of another size)."""
    survey = worlds.make_survey(folder / "images", frames=FRAMES, size=SIZE)
    worlds.write_gnss(survey, folder / "gnss.csv")
    worlds.write_times(survey, folder / "times.csv")
    write_rig_toml(survey.rig, folder / "rig.toml")
    (folder / "rig_config.json").write_text(rig_config([survey.rig]), encoding="utf-8")
    _write_trajectory(survey, folder / "trajectory.tum")
    shutil.copyfile(folder / "trajectory.tum", folder / "reference.tum")
    _write_control(survey, folder)
    names = sorted(survey.cam_from_world)
    pairs = [f"{a} {b}" for k, a in enumerate(names) for b in names[k + 1 :] if a.split("/")[1] == b.split("/")[1]]
    (folder / "pairs.txt").write_text("\n".join(pairs) + "\n")
    mask = np.full(SIZE[::-1], 255, np.uint8)
    mask[: SIZE[1] // 4] = 0
    for name in names:
        path = folder / "masks" / f"{name}.png"
        path.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(path), mask)
    _write_cloud(folder / "reference.ply")
    (folder / "model.toml").write_text(
        'onnx = "model.onnx"\nsize = [64, 48]\nmean = [0.5, 0.5, 0.5]\ndeviation = [0.2, 0.2, 0.2]\n\n'
        "[classes]\nsky = [0]\nwater = [1]\n"
    )
    (folder / "video").mkdir()
    video = cv2.VideoWriter(str(folder / "video" / "walk.avi"), cv2.VideoWriter.fourcc(*"MJPG"), 4.0, SIZE)
    for name in names[:6]:
        video.write(cv2.imread(str(folder / "images" / name)))
    video.release()


def _write_trajectory(survey: worlds.Survey, path: Path) -> None:
    """TUM: the body frame is that of the reference camera, for the rig file says so."""
    rows = []
    for key in sorted(survey.times_s, key=lambda k: survey.times_s[k]):
        pose = survey.world_from_rig[key]
        numbers = [survey.times_s[key], *pose[:3, 3], *transforms.quaternion_xyzw(pose[:3, :3])]
        rows.append(" ".join(f"{n:.9f}" for n in numbers))
    path.write_text("\n".join(rows) + "\n")


def _write_control(survey: worlds.Survey, folder: Path) -> None:
    """Four points on the walls, marked in every image that has them in its frame (occlusion is not asked)."""
    points = {"p1": (1.0, 3.9, 3.0), "p2": (4.0, -3.9, 3.2), "p3": (3.0, 3.9, 2.8), "p4": (2.0, -3.9, 3.1)}
    rows, listed = ["name,lat,lon,height,image,px,py"], ["EPSG:4326"]
    for label, at in points.items():
        lat, lon, height = geodetic_from_world(np.array(at), worlds.ORIGIN)[0]
        for name, cam_from_world in sorted(survey.cam_from_world.items()):
            camera = survey.rig.sensors[int(name.split("/")[1][-1])].camera
            seen = transforms.apply(cam_from_world, np.array([at]))[0]
            x, y = (camera.calibration_matrix() @ seen)[:2] / seen[2]
            if seen[2] > 0 and 2 < x < SIZE[0] - 2 and 2 < y < SIZE[1] - 2:
                rows.append(f"{label},{lat:.9f},{lon:.9f},{height:.4f},{name},{x:.2f},{y:.2f}")
                listed.append(f"{lon:.9f} {lat:.9f} {height:.4f} {x:.2f} {y:.2f} {name} {label}")
    (folder / "gcp.csv").write_text("\n".join(rows) + "\n")
    (folder / "gcp_list.txt").write_text("\n".join(listed) + "\n")


def _write_cloud(path: Path) -> None:
    """Points of the two walls and the floor, ASCII PLY, local east-north-up metres."""
    x, y, z = np.meshgrid(np.arange(-2.0, 8.0, 0.25), (-4.0, 4.0), np.arange(0.0, 4.0, 0.25))
    points = np.stack([x.ravel(), y.ravel(), z.ravel()], axis=1)
    head = ["ply", "format ascii 1.0", f"element vertex {len(points)}"]
    head += [f"property float {axis}" for axis in "xyz"] + ["end_header"]
    path.write_text("\n".join(head + [f"{a:.3f} {b:.3f} {c:.3f}" for a, b, c in points]) + "\n")


def fingerprint(folder: Path) -> dict[bytes, str]:
    """What every name below a folder is and holds: {path: kind and hash}; links are not followed."""
    out = {}
    for at, folders, files in os.walk(os.fsencode(folder)):
        for name in (*folders, *files):
            path = os.path.join(at, name)
            out[os.path.relpath(path, os.fsencode(folder))] = _content(path)
    return out


def _content(path: bytes) -> str:
    mode = os.lstat(path).st_mode
    if stat.S_ISLNK(mode):
        return f"link {os.fsdecode(os.readlink(path))}"
    if stat.S_ISREG(mode):
        with open(path, "rb") as file:
            return "file " + hashlib.blake2b(file.read(), digest_size=12).hexdigest()
    return f"mode {stat.S_IFMT(mode):o}"
