"""Glue of dense: a depth map for every image."""

import json
import logging
from collections import Counter
from collections.abc import Callable
from dataclasses import asdict
from functools import partial
from pathlib import Path

import cv2
import numpy as np

from tiegraph.dense.depth import Consistency, confirmed_map, depth_map
from tiegraph.dense.engine import installed, matched_by, most_volume_bytes
from tiegraph.dense.plan import DensePlan, ImagePlan, plan_images
from tiegraph.dense.settings import DenseSettings
from tiegraph.dense.shot import plan_hanging
from tiegraph.dense.tuning import Tuning
from tiegraph.dense.undistort import load_view, pinhole, write_workspace
from tiegraph.errors import InputError, ReconstructionError, TiegraphError
from tiegraph.limits import explained
from tiegraph.pipeline.files import FINAL, load_json, load_map, load_model, whole
from tiegraph.project.run import Run
from tiegraph.project.stages import Outcome, write_atomic
from tiegraph.scene.atomic import remove
from tiegraph.scene.composed import carries
from tiegraph.scene.names import inside
from tiegraph.scene.results import DepthMap, save_depth

_log = logging.getLogger(__name__)
FIRST = ".first"  # depth maps before they are compared with each other; removed when the stage is done


def depth_path(folder: Path, name: str, step: str = "") -> Path:
    """The file of an image's depth map."""
    return inside(folder / "depth" / step, f"{name}.npz")


def dense(run: Run) -> Outcome:
    """A depth map of every image that has partners: matched, then compared with its neighbours'."""
    plan = plan_of(run)
    names = sorted(plan.images)
    settings, tuning = run.settings.dense, run.settings.tuning.dense
    args = (run.folder, plan.images, settings, tuning)
    todo = [n for n in names if not depth_path(run.folder, n).exists()]
    if todo:  # then the first maps of all are made, so that those with lost reasons for dropped pixels are made again
        todo = [n for n in names if n in set(todo) or not _counts_path(run.folder, n).exists()]
    first = [n for n in names if not depth_path(run.folder, n, FIRST).exists()] if todo else []
    sizes = _sizes(plan.images, settings, tuning)
    _log.info("%d images; %s", len(names), "; ".join(sizes))
    run.reporter.total(2 * len(names), 2 * len(names) - len(first) - len(todo))
    kernels = Counter(run.map(_first_item, first, *args))
    run.map(_confirm_item, todo, *args)
    paths = [_counts_path(run.folder, n) for n in names]
    told = all(p.exists() for p in paths)  # else there was nothing left to do
    found = Consistency.total(Consistency(**load_json(p)) for p in paths) if told else None
    # The first form of a confirmed map may still be needed as a witness, so all of them stay until the end.
    remove(run.path("depth", FIRST))
    pixels = run.map(_known_pixels, names, run.folder)
    refused = {"columns": ["reason", "stereo pairs"], "rows": [[k, n] for k, n in plan.refused.items()]}
    tables = {"refused stereo pairs": refused, **({} if found is None else {"comparison of depth maps": found.table()})}
    counts: dict[str, float] = {"images": len(names), "pixels": int(sum(pixels)), "images_without": len(plan.dropped)}
    remark = installed(settings.engine)[1]
    matched = [f"{n} images matched by {kernel}" for kernel, n in sorted(kernels.items())]
    notes = (*plan.notes, *sizes, *matched, *([remark] if remark else []))
    return Outcome(counts=counts, dropped=plan.dropped, notes=notes, tables=tables)


def plan_of(run: Run) -> DensePlan:
    """The pairs of images to match, by the model in the world; those of dependent cameras, which see none of
    its points, within their frame."""
    settings, tuning, model = run.settings.dense, run.settings.tuning.dense, load_model(run.path("sparse", "world"))
    survey = whole(run)
    hanging = {survey.names[k] for k in np.flatnonzero(~carries(survey))}
    if not hanging:
        return plan_images(model, settings, tuning.partners)
    within = plan_hanging(model, hanging, settings, tuning)
    try:
        plan = plan_images(model, settings, tuning.partners)
    except ReconstructionError:
        if not within.images:
            raise
        plan = DensePlan({})  # images that cannot be matched between stations are matched within each
    return DensePlan(
        images=plan.images | within.images,
        dropped=(*(row for row in plan.dropped if row[0] not in hanging), *within.dropped),
        notes=(*plan.notes, f"{len(within.images)} images with poses by their rig are matched within their frame"),
        refused=dict(Counter(plan.refused) + Counter(within.refused)),
    )


def _sizes(plans: dict[str, ImagePlan], settings: DenseSettings, tuning: Tuning) -> list[str]:
    """The reduced images, and the largest memory of the matcher; known before it starts."""
    sizes = {plan.view.camera: pinhole(plan.view, settings).size for plan in plans.values()}
    reduced = {
        f"depth maps of {size[0]} x {size[1]} pixels, of images of {camera.width} x {camera.height} "
        "(dense.max_image_size)"
        for camera, size in sizes.items()
        if max(size) == settings.max_image_size < max(camera.width, camera.height)
    }
    most = max((most_volume_bytes(size, tuning) for size in sizes.values()), default=0)
    return [*sorted(reduced)[:3], f"cost volumes of a pair: at most {most / 1e6:.0f} MB in each worker"]


def _first_item(name: str, folder: Path, plans: dict[str, ImagePlan], settings: DenseSettings, tuning: Tuning) -> str:
    """Saves the depth map of an image before it is compared with others; the matcher of its pairs."""
    masks = folder / FINAL / "masks"
    found = depth_map(plans[name], folder / "images", masks, settings, tuning, cv2.getNumThreads())
    save_depth(found, depth_path(folder, name, FIRST))
    return matched_by(settings, tuning)


def _confirm_item(
    name: str, folder: Path, plans: dict[str, ImagePlan], settings: DenseSettings, tuning: Tuning
) -> None:
    load = partial(_known_map, folder=folder, step=FIRST)
    first = load_map(depth_path(folder, name, FIRST))
    confirmed, counts = confirmed_map(plans[name], first, load, settings, tuning)
    write_atomic(_counts_path(folder, name), json.dumps(asdict(counts)))
    save_depth(confirmed, depth_path(folder, name))


def _counts_path(folder: Path, name: str) -> Path:
    """Reasons for dropped pixels of a depth map, until the stage is done: written before the map is."""
    return inside(folder / "depth" / FIRST, f"{name}.json")


def _known_pixels(name: str, folder: Path) -> int:
    return int(np.isfinite(load_map(depth_path(folder, name)).depth_m).sum())


def hand_over(run: Run, target: Path) -> int:
    """The depth maps as a dense workspace of COLMAP below ``target``; their number. Raises InputError for a folder that
    is not empty."""
    if target.exists() and (not target.is_dir() or any(target.iterdir())):
        raise InputError(f"{target} exists and is not empty: give a new folder for the workspace")
    model, load = load_model(run.path("sparse", "world")), partial(_known_map, folder=run.folder)
    try:
        return write_workspace(target, model, run.path("images"), load, run.settings.dense)
    except (OSError, RuntimeError) as error:
        told = explained(error, target) or InputError(f"{target}: cannot be written: {error}; choose another folder")
        raise error if isinstance(error, TiegraphError) else told from error


def coloured(plans: dict[str, ImagePlan], images: Path, settings: DenseSettings) -> Callable[[str], np.ndarray]:
    """Colours (H, W, 3) u1 RGB of the undistorted images by name."""
    return partial(_colours, plans=plans, images=images, settings=settings)


def _colours(name: str, plans: dict[str, ImagePlan], images: Path, settings: DenseSettings) -> np.ndarray:
    return cv2.cvtColor(load_view(plans[name].view, images, None, settings).image_bgr, cv2.COLOR_BGR2RGB)


def read_depth(name: str, folder: Path) -> DepthMap:
    """The finished depth map of an image."""
    return load_map(depth_path(folder, name))


def _known_map(name: str, folder: Path, step: str = "") -> DepthMap | None:
    path = depth_path(folder, name, step)
    return load_map(path) if path.exists() else None
