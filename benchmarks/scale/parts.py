"""Single parts that hold the whole survey, at sizes up to 100 000 images: ``python -m benchmarks.scale.parts``.

Each part runs in a process of its own on input that is drawn (``loop``: two cameras, GNSS), in seconds: the table of
the scene, COLMAP's rows, the block graph, joining of all blocks, the lattice of two long passes, the book of previews
and the list of pairs.
"""

from __future__ import annotations

import argparse
import json
import subprocess
import sys
import tempfile
import time
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

import tiegraph  # noqa: F401  before pycolmap
from benchmarks.scale.loop import Loop, links, loop
from benchmarks.scale.results import save
from tiegraph.features.preview import PreviewMatch
from tiegraph.network.passes import MatchCache, Pass
from tiegraph.network.scorematrix import score_matrix
from tiegraph.network.tuning import Tuning
from tiegraph.scene.blocks import blocks_of
from tiegraph.scene.colmaprows import create_database
from tiegraph.scene.joining import Poses, join_models
from tiegraph.scene.matches import PreviewMatches
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.rig import Rig, Sensor
from tiegraph.scene.scene import Scene
from tiegraph.scene.tuning import BlocksTuning, JoiningTuning

SIZES = (4020, 12_000, 36_000, 100_000)
PREVIEWS, LISTED, MATCHES = 37, 40, 7  # an image, pairs listed an image, matches of a preview on average
CAMERAS, STRIDE, BAND = 6, 4, 12  # of the lattice: cameras, frames a node, nodes on either side of the path

Measured = Callable[[], dict[str, float]]  # what is timed; figures of it


def scene_file(images: int) -> Measured:
    """``scene.json`` written and read."""
    scene = _world(images).scene

    def run() -> dict[str, float]:
        text = scene.to_json()
        return {"frames": Scene.from_json(text).frames, "file_mib": len(text) / 2**20}

    return run


def database(images: int) -> Measured:
    """COLMAP's rows of cameras, rigs, frames, images and positions."""
    scene = _world(images).scene

    def run() -> dict[str, float]:
        with tempfile.TemporaryDirectory() as folder:
            create_database(Path(folder) / "database.db", scene)
            return {"file_mib": (Path(folder) / "database.db").stat().st_size / 2**20}

    return run


def blocks(images: int) -> Measured:
    """The graph of frames cut into blocks."""
    world = _world(images)
    tied = links(world)

    def run() -> dict[str, float]:
        found = blocks_of(world.scene, tied, BlocksTuning())
        return {"ties": len(tied.i), "blocks": len(found), "largest": max(map(len, found))}

    return run


def joins(images: int) -> Measured:
    """Models of all blocks joined by the images that they share: stretches of 200 frames and 15 on either side."""
    world = _world(images)
    frames = world.scene.frames
    models = [
        Poses(own, world.cam_from_world[own], 15.0)
        for first in range(0, frames, 200)
        for own in [np.unique((2 * (np.arange(first - 15, first + 215) % frames)[:, None] + (0, 1)).ravel())]
    ]

    def run() -> dict[str, float]:
        found = join_models(models, JoiningTuning())
        return {"blocks": len(models), "held": sum(j.holds for j in found.joins)}

    return run


def scores(images: int) -> Measured:
    """Evidence between two long passes of six cameras, smoothed and interpolated to every frame."""
    frames, tuning = images // (2 * CAMERAS), Tuning()
    rig = Rig("ring", tuple(Sensor(f"cam{k}") for k in range(CAMERAS)))
    p, q = (
        Pass(
            name=f"pass {k}", sequence=k, rig_index=0, rig=rig, frames=np.arange(frames),
            images=np.arange(CAMERAS * frames).reshape(CAMERAS, frames) + k * CAMERAS * frames,
        )
        for k in range(2)
    )  # fmt: skip
    made = score_matrix(p, q, STRIDE, np.ones((CAMERAS, CAMERAS), bool), tuning.offsets)
    rng = np.random.default_rng(0)
    count = len(made.columns)
    for a in range(len(made.rows)):
        beside = slice(max(0, count - 1 - a - BAND), max(0, count - a + BAND))
        near = made.inliers[:, :, a, beside]
        distance = np.abs(np.arange(count)[beside] - (count - 1 - a))
        near[:] = rng.poisson(6 + 20 * np.exp(-((distance / 4) ** 2)), near.shape)

    def run() -> dict[str, float]:
        smooth = made.smoothed(12, tuning)
        return {"nodes": made.inliers.size, "pairs": len(made.interpolated(smooth, 12.0, tuning.counts)[0])}

    return run


def previews(images: int) -> Measured:
    """The book of what was previewed, half of it in each of two calls, united and chosen from as stages do."""
    rng = np.random.default_rng(0)
    i, j = _pairs(images, PREVIEWS, rng)
    found = {k: PreviewMatch(k, matches=np.zeros((k, 2), np.uint16)) for k in range(40)}
    counts = np.minimum(rng.poisson(MATCHES, len(i)), 39)
    of = {key: int(n) for key, n in zip((i.astype(np.int64) << 32 | j).tolist(), counts.tolist())}

    def match(pairs: np.ndarray) -> list[PreviewMatch]:
        return [found[of[key]] for key in (pairs[:, 0].astype(np.int64) << 32 | pairs[:, 1]).tolist()]

    cache = MatchCache(match, images)

    def run() -> dict[str, float]:
        for half in (slice(0, None, 2), slice(1, None, 2)):
            cache.measure(i[half], j[half])
        ties = cache.matches()
        good: PreviewMatches = ties.where(ties.counts() >= MATCHES) | ties.where(ties.counts() < MATCHES)
        return {"previews": len(good), "matches": len(good.matches)}

    return run


def pair_list(images: int) -> Measured:
    """``network.csv`` and the pair list of the candidates."""
    i, j = _pairs(images, LISTED, np.random.default_rng(0))
    pairs = Pairs.make(i, j, "offsets", score=np.full(len(i), 21.5), overlap=np.full(len(i), 0.25))
    names = tuple(f"down/cam{k % 6}/{k // 6:06d}.jpg" for k in range(images))

    def run() -> dict[str, float]:
        table, listed = pairs.to_csv(names), pairs.to_text(names)
        return {"pairs": len(pairs), "csv_mib": len(table) / 2**20, "list_mib": len(listed) / 2**20}

    return run


PARTS: dict[str, Callable[[int], Measured]] = {
    "scene file": scene_file,
    "database": database,
    "blocks": blocks,
    "joins": joins,
    "lattice": scores,
    "previews": previews,
    "pair list": pair_list,
}


def _world(images: int) -> Loop:
    return loop(images // 2)


def _pairs(images: int, each: int, rng: np.random.Generator) -> tuple[np.ndarray, np.ndarray]:
    """Pairs i < j (P,) of near images, ``each`` an image or a little fewer."""
    i = np.repeat(np.arange(images), each)
    j = i + rng.integers(1, 5 * each, len(i))
    key = np.unique((i.astype(np.int64) << 32 | j)[j < images])
    return key >> 32, key & 0xFFFFFFFF


def one_part(name: str, images: int) -> dict[str, Any]:
    """One part at one size in this process."""
    run = PARTS[name](images)
    Path("/proc/self/clear_refs").write_text("5")  # from here on the peak is that of the part
    before, began = _peak_mib(), time.process_time()
    figures = run()
    cpu_s = time.process_time() - began
    return {"part": name, "images": images, "cpu_s": cpu_s, "before_mib": before, "peak_mib": _peak_mib(), **figures}


def _peak_mib() -> float:
    lines = Path("/proc/self/status").read_text().splitlines()
    return next(float(line.split()[1]) for line in lines if line.startswith("VmHWM")) / 1024


def markdown(rows: list[dict[str, Any]]) -> str:
    """CPU seconds and the MiB above those before, of each part and size, and the powers of growth."""
    sizes = sorted({r["images"] for r in rows})
    lines = [
        "| part | " + " | ".join(f"{n} images: CPU s, MiB added" for n in sizes) + " | powers |",
        "| " + " | ".join(["---"] * (len(sizes) + 2)) + " |",
    ]
    for name in dict.fromkeys(r["part"] for r in rows):
        own = sorted((r for r in rows if r["part"] == name), key=lambda r: r["images"])
        cells = [f"{r['cpu_s']:.2f}, {r['peak_mib'] - r['before_mib']:.0f}" for r in own]
        powers = "-"
        if len(own) > 1:
            a, b = own[-2:]
            grown = np.log(b["images"] / a["images"])
            values = [(r["cpu_s"], max(r["peak_mib"] - r["before_mib"], 1.0)) for r in (a, b)]
            powers = ", ".join(f"{np.log(max(y, 1e-3) / max(x, 1e-3)) / grown:.2f}" for x, y in zip(*values))
        lines.append(f"| {name} | " + " | ".join(cells) + f" | {powers} |")
    return "\n".join(lines)


def main(argv: list[str] | None = None) -> int:
    """All parts and sizes, each in a process of its own; prints the table."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--images", type=int, nargs="+", default=list(SIZES))
    parser.add_argument("--parts", nargs="+", default=list(PARTS), choices=list(PARTS))
    parser.add_argument("--note", default="")
    parser.add_argument("--one", choices=list(PARTS), help=argparse.SUPPRESS)  # the child
    parser.add_argument("-o", "--output", type=Path, help="JSON file of all")
    given = parser.parse_args(argv)
    if given.one is not None:
        sys.stdout.write(json.dumps(one_part(given.one, given.images[0])) + "\n")
        return 0
    rows = []
    for name in given.parts:
        for images in given.images:
            command = [sys.executable, "-m", "benchmarks.scale.parts", "--one", name, "--images", str(images)]
            ended = subprocess.run(command, capture_output=True, text=True, check=True)
            rows.append(json.loads(ended.stdout.splitlines()[-1]))
            sys.stderr.write(json.dumps(rows[-1]) + "\n")
    if given.output is not None:
        save(given.output, rows, given.note)
    sys.stdout.write(markdown(rows) + "\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
