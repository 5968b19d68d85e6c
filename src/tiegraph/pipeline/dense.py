"""Glue of dense and cloud: a depth map for every image, all of them fused; undistorted images for colours."""

import json
import logging
from collections import Counter
from collections.abc import Callable, Iterable, Mapping, Sequence
from dataclasses import asdict, dataclass
from functools import cached_property, partial
from pathlib import Path
from typing import Any

import cv2
import numpy as np

from tiegraph.cloud.fuse import Maps, automatic_voxel, fuse
from tiegraph.dense.depth import Consistency, confirmed_map, depth_map, gone
from tiegraph.dense.engine import installed, matched_by, most_volume_bytes
from tiegraph.dense.plan import CameraModel, DensePlan, ImagePlan, ViewPlan, plan_images
from tiegraph.dense.settings import DenseSettings
from tiegraph.dense.shot import plan_hanging
from tiegraph.dense.tuning import Tuning
from tiegraph.dense.undistort import load_view, pinhole
from tiegraph.errors import ReconstructionError
from tiegraph.evaluate.accuracy import in_layers
from tiegraph.geometry.stereo import Pinhole
from tiegraph.pipeline import files
from tiegraph.pipeline.georef import stated
from tiegraph.project.run import Run
from tiegraph.project.stages import Outcome, write_atomic
from tiegraph.scene.atomic import remove, same_file
from tiegraph.scene.cloudfile import write_ply
from tiegraph.scene.colmapmodel import matrix
from tiegraph.scene.composed import carries
from tiegraph.scene.copc import write_copc
from tiegraph.scene.names import inside
from tiegraph.scene.results import LAYERS, Cloud, DepthMap, save_depth

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
    found = Consistency.total(Consistency(**files.load_json(p)) for p in paths) if told else None
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
    """The pairs of images to match, by the model in the world; those of dependent cameras within their frame."""
    settings, tuning = run.settings.dense, run.settings.tuning.dense
    model = files.load_model(run.path("sparse", "world"))
    survey = files.whole(run)
    hanging = {survey.names[k] for k in np.flatnonzero(~carries(survey))}
    passes = dict(zip(survey.names, survey.sequence[survey.frame].tolist()))
    if not hanging:
        return plan_images(model, settings, tuning.partners, passes)
    within = plan_hanging(model, hanging, settings, tuning)
    try:
        plan = plan_images(model, settings, tuning.partners, passes)
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
    masks = folder / files.FINAL / "masks"
    found = depth_map(plans[name], folder / "images", masks, settings, tuning, cv2.getNumThreads())
    save_depth(found, depth_path(folder, name, FIRST))
    return matched_by(settings, tuning)


def _confirm_item(
    name: str, folder: Path, plans: dict[str, ImagePlan], settings: DenseSettings, tuning: Tuning
) -> None:
    load = partial(known_depth, folder=folder, step=FIRST)
    first = files.load_map(depth_path(folder, name, FIRST))
    confirmed, counts = confirmed_map(plans[name], first, load, settings, tuning)
    write_atomic(_counts_path(folder, name), json.dumps(asdict(counts)))
    save_depth(confirmed, depth_path(folder, name))


def _counts_path(folder: Path, name: str) -> Path:
    """Reasons for dropped pixels of a depth map, until the stage is done: written before the map is."""
    return inside(folder / "depth" / FIRST, f"{name}.json")


def _known_pixels(name: str, folder: Path) -> int:
    path = depth_path(folder, name)
    with files.reading(path), np.load(path) as columns:
        return int(np.isfinite(columns["depth_m"]).sum())


def colours(name: str, plans: dict[str, ImagePlan], images: Path, settings: DenseSettings) -> np.ndarray:
    """(H, W, 3) u1 RGB of an undistorted image."""
    return cv2.cvtColor(load_view(plans[name].view, images, None, settings).image_bgr, cv2.COLOR_BGR2RGB)


def read_depth(name: str, folder: Path) -> DepthMap:
    """The finished depth map of an image."""
    return files.load_map(depth_path(folder, name))


def lasting(name: str, folder: Path, plans: dict[str, ImagePlan], settings: DenseSettings, tuning: Tuning) -> DepthMap:
    """The finished depth map of an image without what other passes see through."""
    found, load = read_depth(name, folder), partial(known_depth, folder=folder)
    if plans[name].elsewhen:
        found.depth_m[gone(found, plans[name].elsewhen, load, settings.tolerance_px, tuning.rays)] = np.nan
    return found


def known_depth(name: str, folder: Path, step: str = "") -> DepthMap | None:
    """The depth map of an image, if there is one."""
    path = depth_path(folder, name, step)
    return files.load_map(path) if path.exists() else None


def cloud(run: Run) -> Outcome:
    """One cloud of all depth maps, tile by tile, as LAZ and PLY, without what was there in one pass only; and the
    agreement of two passes, if there are."""
    from tiegraph.pipeline.clouds import write_agreement  # matplotlib, which no worker of this stage needs

    def mapper(function: Callable[[Any], Any], items: Sequence[Any]) -> Iterable[Any]:
        run.reporter.total(len(items))
        return run.map(function, items)

    plans = {n: p for n, p in plan_of(run).images.items() if depth_path(run.folder, n).exists()}
    scratch = run.path(".tiles")
    remove(scratch)
    scratch.mkdir(parents=True)
    drawn = partial(colours, plans=plans, images=run.path("images"), settings=run.settings.dense)
    matched = {"settings": run.settings.dense, "tuning": run.settings.tuning.dense}
    maps = Maps(partial(lasting, folder=run.folder, plans=plans, **matched), drawn)
    settings, tuning, own = run.settings.cloud, run.settings.tuning.cloud, partial(read_depth, folder=run.folder)
    voxel = settings.voxel_size or automatic_voxel(sorted(plans), own, tuning.sampled_maps, run.map)
    settings = settings.model_copy(update={"voxel_size": voxel})
    fused = fuse(sorted(plans), maps, scratch, settings, tuning, files.world_origin(run.folder), mapper)
    sigmas = _sigmas(run, fused.clouds())
    said = accuracy_said(run, sigmas)
    notes = [*write_copc(fused.clouds, run.path(files.CLOUD), fused.voxel, scratch, said)]
    same_file(run.path(files.CLOUD), run.path("cloud.laz"))
    notes += write_ply(fused.clouds(), run.path("cloud.ply"), said)
    agreement = write_agreement(run, scratch, fused.voxel, mapper)
    if agreement is not None and agreement.why_not:
        notes.append(agreement.note())
    counts = {"points": fused.counts["points"], **{k: v for k, v in fused.counts.items() if k != "points"}, **sigmas}
    moved = run.receipts.read("dense")["counts"]["pixels"] - counts["pixels"] - counts["uncertain"]
    if moved and any(p.elsewhen for p in plans.values()):
        notes.append(f"{moved} pixels of the depth maps are left out: other passes see another surface behind them")
    return Outcome({**counts, "voxel": float(f"{fused.voxel:.3g}")}, notes=tuple(dict.fromkeys(notes)))


def _sigmas(run: Run, parts: Iterable[Cloud]) -> dict[str, float]:
    """Median of the points' sigma, and median and 90th percentile of that in the world, if the model is placed: of
    the matching, of the cameras inside the model and of the placement together."""
    error, own, world = files.placement_error(run.folder), [], []
    inside = (files.load_json(run.path("world.json")).get("model_sigma") or {}).get("median", 0.0)
    for part in parts:
        some = part.where(np.arange(0, len(part), 50))  # points of the cloud sampled for its sigma in the world
        own.append(some.sigma_m)
        if error is not None:
            placed = np.linalg.norm(error.sigma(some.xyz_m), axis=1)
            world.append(np.sqrt(placed**2 + inside**2 + np.nan_to_num(some.sigma_m) ** 2))
    asked = {"sigma_median": (own, 50), "world_sigma_median": (world, 50), "world_sigma_p90": (world, 90)}
    there = {name: (np.concatenate(found), share) for name, (found, share) in asked.items() if found}
    known = {n: np.nanpercentile(v, share) for n, (v, share) in there.items() if np.isfinite(v).any()}
    return {f"{name}_m": round(float(value), 4) for name, value in known.items()}


def accuracy_said(run: Run, sigmas: Mapping[str, float]) -> str:
    """The accuracy stated in the files of clouds and rasters: the predicted one, because nothing is measured yet."""
    found = in_layers(stated(run, sigmas), ())
    heads = {name: found.head(layer).predicted for layer, name in LAYERS.items()}
    parts = [f"{name} {value:.3g} {found.unit}" for name, value in heads.items() if np.isfinite(value)]
    how = f"one standard deviation; held in the world by {found.held_by}; what was measured stands in metrics.json"
    return f"accuracy predicted: {', '.join(parts)} ({how})" if parts else ""


_SHARP = 20_000  # longest side of an undistorted image: as large as they come


@dataclass(frozen=True, eq=False)
class Pictures:
    """The images of the model in the world, by name, at their own resolution, undistorted."""

    folder: Path
    plans: Sequence[ViewPlan]
    sharp: DenseSettings

    @staticmethod
    def of(run: Run) -> "Pictures":
        """Those of a run."""
        images = files.load_model(run.path("sparse", "world")).images.values()
        there = sorted((i for i in images if i.has_pose), key=lambda i: i.name)
        plans = [ViewPlan(i.name, CameraModel.of(i.camera), matrix(i.cam_from_world())) for i in there]
        return Pictures(run.folder, plans, run.settings.dense.model_copy(update={"max_image_size": _SHARP}))

    @cached_property
    def views(self) -> list[Pinhole]:
        """The undistorted cameras, without reading an image."""
        return [pinhole(p, self.sharp) for p in self.plans]

    def picture(self, k: int) -> tuple[np.ndarray, np.ndarray]:
        """RGB (H, W, 3) u1 of an image, and which of its pixels may be used (H, W) bool."""
        found = load_view(self.plans[k], self.folder / "images", self.folder / files.FINAL / "masks", self.sharp)
        return cv2.cvtColor(found.image_bgr, cv2.COLOR_BGR2RGB), found.mask
