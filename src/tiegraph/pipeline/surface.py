"""Glue of dense and cloud: from the model in the world to depth maps and a point cloud."""

from __future__ import annotations

from collections import Counter
from pathlib import Path

import numpy as np
import pycolmap

from tiegraph.cloud.fuse import fuse
from tiegraph.dense.depth import confirmed_map, depth_map
from tiegraph.dense.neighbours import plan_images
from tiegraph.dense.plan import ImagePlan
from tiegraph.dense.settings import DenseSettings
from tiegraph.pipeline.files import checked, save_npz
from tiegraph.project.run import Run
from tiegraph.project.stages import Outcome, remove
from tiegraph.scene.cloudfile import write_las, write_ply
from tiegraph.scene.results import DepthMap

FIRST = ".first"  # depth maps before they are compared with each other; removed when the stage is done


def depth_path(folder: Path, name: str, step: str = "") -> Path:
    """Where the depth map of an image is."""
    return folder / "depth" / step / f"{name}.npz"


def dense(run: Run) -> Outcome:
    """A depth map of every image that has partners: matched, then compared with its neighbours'."""
    plan = plan_images(pycolmap.Reconstruction(str(run.path("sparse", "world"))), run.settings.dense)
    names = sorted(plan.images)
    args = (run.folder, plan.images, run.settings.dense)
    todo = [n for n in names if not depth_path(run.folder, n).exists()]
    run.reporter.total(2 * len(names), 2 * (len(names) - len(todo)))
    # A map that is confirmed may still be asked for as a witness, so all first maps stay until the end.
    run.map(_first_item, [n for n in names if not depth_path(run.folder, n, FIRST).exists()], *args)
    kept = run.map(_confirm_item, todo, *args)
    remove(run.path("depth", FIRST))
    counts = {"images": len(names), "pixels": sum(k for k, _ in kept), "matched_pixels": sum(b for _, b in kept)}
    refused = {"columns": ["reason", "pairs"], "rows": [[k, n] for k, n in Counter(plan.refused).most_common()]}
    return Outcome(counts, plan.dropped, plan.notes, {"refused stereo pairs": refused})


def _first_item(name: str, folder: Path, plans: dict[str, ImagePlan], settings: DenseSettings) -> None:
    found = depth_map(plans[name], folder / "images", folder / "masks", settings)
    save_npz(depth_path(folder, name, FIRST), **found.to_npz())


def _confirm_item(name: str, folder: Path, plans: dict[str, ImagePlan], settings: DenseSettings) -> tuple[int, int]:
    def load(other: str) -> DepthMap | None:
        path = depth_path(folder, other, FIRST)
        return read_depth(path) if path.exists() else None

    first = load(name)
    assert first is not None
    confirmed, counts = confirmed_map(plans[name], first, load, settings)
    save_npz(depth_path(folder, name), **confirmed.to_npz())
    return counts.kept, counts.before


def read_depth(path: Path) -> DepthMap:
    """A depth map from its file."""
    with np.load(path) as data:
        return DepthMap.from_npz(dict(data))
