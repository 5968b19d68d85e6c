"""Stage by stage up to the design on simulated surveys: ``python -m benchmarks.scale.stages --images 4020 100000``.

Of each size a canal is simulated (``benchmarks.network.canalworld``: a ring of five cameras and one that looks up, out
and back, walls that repeat, GNSS with outages). The program's own stages run on it, with all they read and write, each
in a process of its own; what needs pixels is replaced and its time taken off (``standin``). Scan reads as many image
files, each of a few kB.
"""

from __future__ import annotations

import argparse
import cProfile
import json
import pstats
import resource
import shutil
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable, Sequence
from pathlib import Path
from typing import Any

import cv2
import numpy as np

import tiegraph  # noqa: F401  before pycolmap
from benchmarks import run
from benchmarks.network.canalworld import CanalWorld, _visible
from benchmarks.scale.standin import without_pixels
from benchmarks.scale.survey import read_survey, write_survey
from tiegraph.__version__ import __version__
from tiegraph.features.matchblocks import BLOCK_PAIRS, cut
from tiegraph.pipeline import STAGES as TABLE
from tiegraph.pipeline.files import checked, pairs_of
from tiegraph.pipeline.network import candidates, coarse, design, network
from tiegraph.pipeline.scan import scan
from tiegraph.project.inputs import Inputs
from tiegraph.project.run import Run
from tiegraph.project.settings import Settings
from tiegraph.project.stages import Outcome
from tiegraph.scene.atomic import remove
from tiegraph.scene.colmaprows import create_database
from tiegraph.scene.scene import Scene

SIZES = (4020, 12_000, 36_000, 100_000)
USEFUL, FALSE, ASKED = 0.15, 0.02, 600  # shared surface of a pair that ties and of a false one; images judged
FILE = "survey"  # folder of the simulated survey beside the run folder


def _plan(run: Run) -> Outcome:
    """The block graph of matching: COLMAP's rows of images and frames in the database, and the pairs cut in blocks."""
    scene, pairs = checked(run), pairs_of(run, "pairs.npz").kept()
    create_database(run.path("database.db"), scene)
    blocks = cut(pairs, BLOCK_PAIRS)
    return Outcome({"images": len(scene), "blocks": len(blocks), "pairs": len(pairs)})


STAGES: dict[str, Callable[[Run], Outcome]] = {
    "scan": scan,
    "candidates": candidates,
    "coarse": coarse,
    "network": network,
    "design": design,
    "plan": _plan,
}


def one_stage(name: str, folder: Path, profile: Path | None) -> dict[str, Any]:
    """One stage of a simulated survey in this process: seconds, memory, counts."""
    images = folder / ("images" if name == "scan" else FILE)
    run = Run(folder / "out", Inputs(images), Settings(), pool="serial")
    world = read_survey(folder / FILE)
    watch = cProfile.Profile()
    before, began, spent = _peak_mib(), time.process_time(), 0.0
    apart = {}
    if profile is not None:
        watch.enable()
    with without_pixels(world) as standins:
        outcome = STAGES[name](run)
        apart = {k: {"cpu_s": s.cpu_s, "calls": s.calls} for k, s in standins.items() if s.calls}
        spent = sum(s.cpu_s for s in standins.values())
    if profile is not None:
        watch.disable()
        with profile.open("w") as stream:
            for order in ("cumulative", "tottime"):
                pstats.Stats(watch, stream=stream).sort_stats(order).print_stats(45)
    run.close()
    for scratch in next((s.scratch for s in TABLE if s.name == name), ()):
        remove(run.path(scratch))
    return {
        "stage": name,
        "cpu_s": time.process_time() - began - spent,
        "apart": apart,
        "before_mib": before,
        "peak_mib": _peak_mib(),
        "counts": outcome.counts,
        "notes": list(outcome.notes),
    }


def _peak_mib() -> float:
    return resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024


def write_images(folder: Path, scene: Scene) -> None:
    """As many image files as a survey has, each another few hundred bytes."""
    blank = cv2.imencode(".jpg", np.full((480, 640), 128, np.uint8), [cv2.IMWRITE_JPEG_QUALITY, 5])[1].tobytes()
    for k, name in enumerate(scene.names):
        path = folder / name
        path.parent.mkdir(parents=True, exist_ok=True)
        path.write_bytes(blank + f"image {k:08d}".encode())


def judged(folder: Path, world: CanalWorld) -> dict[str, float]:
    """Chosen and candidate pairs of some images against the surface they truly share."""
    run = Run(folder / "out", Inputs(folder), Settings(), pool="serial")
    some = np.unique(np.linspace(0, len(world) - 1, ASKED).round().astype(int))
    found = pairs_of(run, "network.npz").kept()
    seen: dict[int, np.ndarray] = {}

    def points(image: int) -> np.ndarray:
        if image not in seen:
            seen[image] = _visible(world.cam_from_world[image], world.points, world.start_m)[0]
        return seen[image]

    def share(i: int, j: int) -> float:
        both = len(np.intersect1d(points(i), points(j), assume_unique=True))
        return both / max(min(len(points(i)), len(points(j))), 1)

    asked = found.where(np.isin(found.i, some))
    kept = np.array([share(int(i), int(j)) for i, j in zip(asked.i, asked.j)])
    return {"precision": float(np.mean(kept >= USEFUL)), "false": float(np.mean(kept < FALSE))}


# ---------------------------------------------------------------- all sizes


def survey(images: int, folder: Path, given: argparse.Namespace) -> list[dict[str, Any]]:
    """All stages of one size, each in a process of its own."""
    began = time.process_time()
    write_survey(folder / FILE, images, given.seed)
    scene = Scene.from_json((folder / FILE / "scene.json").read_text())
    sys.stderr.write(f"{len(scene)} images simulated in {time.process_time() - began:.0f} CPU s\n")
    rows = []
    for name in given.stages:
        if name == "scan":
            write_images(folder / "images", scene)
        figures = folder / f"{name}.json"
        command = [sys.executable, "-m", "benchmarks.scale.stages", "--one", name, "--folder", str(folder)]
        if given.profile is not None:
            given.profile.mkdir(parents=True, exist_ok=True)
            command += ["--profile", str(given.profile / f"{name}_{images}.txt")]
        ended = subprocess.run(command, stdin=subprocess.DEVNULL, capture_output=True, text=True, check=False)
        if ended.returncode != 0:
            sys.stderr.write(f"{name} of {len(scene)} images ended with {ended.returncode}\n{ended.stderr[-2500:]}\n")
            rows.append({"images": len(scene), "stage": name, "ended": ended.returncode})
            break
        row = {"images": len(scene), **json.loads(figures.read_text())}
        row["made_mib"] = _size_mib(folder / "out", name)
        rows.append(row)
        sys.stderr.write(f"{len(scene)} {name}: {row['cpu_s']:.1f} CPU s, {row['peak_mib']:.0f} MiB {row['counts']}\n")
        if name == "scan":  # what follows is of the simulated survey: the files have no pixels
            shutil.rmtree(folder / "images")
            shutil.rmtree(folder / "out" / "images")
            shutil.copy(folder / FILE / "scene.json", folder / "out" / "scene.json")
    if "network" in given.stages and (folder / "out" / "network.npz").exists():
        rows[-1] |= {"judged": judged(folder, read_survey(folder / FILE))}
    return rows


def _size_mib(out: Path, stage: str) -> dict[str, float]:
    """MiB of the files of a stage by name."""
    own = [p for p in out.rglob("*") if p.is_file() and p.relative_to(out).parts[0].split(".")[0] in (stage, "pairs")]
    own += [out / "scene.json"] if stage == "scan" else []
    return {p.relative_to(out).as_posix(): p.stat().st_size / 2**20 for p in sorted(own) if p.stat().st_size > 2**20}


def markdown(rows: Sequence[dict[str, Any]]) -> str:
    """CPU seconds and peak MiB of each stage and size, and the power between the last two sizes."""
    sizes = sorted({r["images"] for r in rows})
    lines = [
        "| stage | " + " | ".join(f"{n} images: CPU s, peak MiB" for n in sizes) + " | powers of CPU, memory |",
        "| " + " | ".join(["---"] * (len(sizes) + 2)) + " |",
    ]
    for stage in STAGES:
        of = {r["images"]: r for r in rows if r["stage"] == stage and "cpu_s" in r}
        cells = [f"{of[n]['cpu_s']:.1f}, {of[n]['peak_mib']:.0f}" if n in of else "-" for n in sizes]
        lines.append(f"| {stage} | " + " | ".join(cells) + f" | {_powers(of)} |")
    return "\n".join(lines)


def _powers(of: dict[int, dict[str, Any]]) -> str:
    """Of CPU seconds, and of the memory a stage adds, between the last two sizes."""
    if len(of) < 2:
        return "-"
    a, b = sorted(of)[-2:]
    grown = np.log(b / a)
    cpu = np.log(max(of[b]["cpu_s"], 1e-3) / max(of[a]["cpu_s"], 1e-3)) / grown
    added = [max(of[n]["peak_mib"] - of[n]["before_mib"], 1.0) for n in (a, b)]
    return f"{cpu:.2f}, {np.log(added[1] / added[0]) / grown:.2f}"


def main(argv: list[str] | None = None) -> int:
    """All sizes, each stage in a process of its own; prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=int, nargs="+", default=list(SIZES))
    parser.add_argument("--stages", nargs="+", default=list(STAGES), choices=list(STAGES))
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--profile", type=Path, help="folder of cProfile's tables, or the file of one stage")
    parser.add_argument("--note", default="")
    parser.add_argument("--folder", type=Path, help="where to work; a temporary folder by default")
    parser.add_argument("--one", choices=list(STAGES), help=argparse.SUPPRESS)  # the child
    parser.add_argument("-o", "--output", type=Path, help="JSON file of all sizes")
    given = parser.parse_args(argv)
    if given.one is not None:
        found = one_stage(given.one, given.folder, given.profile)
        (given.folder / f"{given.one}.json").write_text(json.dumps(found))
        return 0
    rows: list[dict[str, Any]] = []
    for images in given.images:
        with tempfile.TemporaryDirectory(prefix="tiegraph-scale-", dir=given.folder) as folder:
            rows += survey(images, Path(folder), given)
        if given.output is not None:
            about = {"format": 1, "machine": run._machine(), "tiegraph": __version__, "note": given.note}
            given.output.write_text(json.dumps(run._rounded({**about, "runs": rows}), indent=1) + "\n")
    sys.stdout.write(markdown(rows) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
