"""Glue of refine: the first masks, corrected by the model."""

from pathlib import Path

import numpy as np
import pycolmap
from scipy.spatial import cKDTree

from tiegraph.geometry.gravity import up_vector
from tiegraph.masks import NAMES, USE, WATER
from tiegraph.masks.frames import full_size
from tiegraph.masks.skyline import places, without_points
from tiegraph.masks.tuning import Tuning
from tiegraph.masks.waterline import (
    Lines,
    View,
    camera_rays,
    final_classes,
    find_water,
    first_line,
    lines_of,
)
from tiegraph.pipeline.files import (
    FINAL,
    checked,
    class_shares,
    classes_path,
    load_model,
    mask_path,
    read_image,
    read_mask,
    save_png,
    world_unit,
)
from tiegraph.project.run import Run
from tiegraph.project.stages import Outcome
from tiegraph.scene.atomic import same_file
from tiegraph.scene.colmapmodel import matrix
from tiegraph.scene.scene import Scene


def refine(run: Run) -> Outcome:
    """Final masks: waterline and horizon of the model where a mask knows its classes, the first masks elsewhere."""
    scene = checked(run)
    known: dict[str, tuple[np.ndarray, Lines | None]] = {}
    notes: tuple[str, ...] = ("the first masks are the final ones, by the setting",)
    if run.settings.refine.geometry == "auto":
        known, notes = _known(run, scene)
    todo = [(n, known.get(n)) for n in scene.names if not mask_path(run.path(FINAL), n).exists()]
    run.reporter.total(len(scene), len(scene) - len(todo))
    run.map(_final_item, todo, run.folder, run.settings.tuning.masks)
    used = np.array(run.map(_used, scene.names, run.folder))  # (N, 2): before, now
    changed = int((used[:, 0] != used[:, 1]).sum())
    counts = {"images": len(scene), "changed": changed, "used_percent": round(float(100 * used[:, 1].mean()), 1)}
    return Outcome(counts, notes=notes, tables=_tables(run, scene))


def _known(run: Run, scene: Scene) -> tuple[dict[str, tuple[np.ndarray, Lines | None]], tuple[str, ...]]:
    """Data of the model for each registered image: points (K, 2) f4 in it, shares of width and height, also hidden
    ones; its waterline and horizon, None if no ring of cameras defines the vertical. And notes."""
    if not any(classes_path(run.folder, n).exists() for n in scene.names):
        return {}, ("the first masks do not say what is sky and water: they are the final ones",)
    model = load_model(run.path("sparse", "world"))
    least = run.settings.tuning.masks.refine.least_track
    points = np.array([p.xyz for p in model.points3D.values() if p.track.length() >= least]).reshape(-1, 3)
    seen = _seen(run, model, points)
    lines, notes = _lines(run, scene, model, points)
    return {n: (seen[n], lines.get(n)) for n in seen}, ("no sky where the model has points", *notes)


def _seen(run: Run, model: pycolmap.Reconstruction, points: np.ndarray) -> dict[str, np.ndarray]:
    tuning = run.settings.tuning.masks
    most = tuning.refine.most_points
    tree = cKDTree(points) if len(points) > most else None
    seen = {}
    for image in model.images.values():
        if not image.has_pose or not classes_path(run.folder, image.name).exists():
            continue
        near = points if tree is None else points[tree.query(image.projection_center(), most)[1]]
        seen[image.name] = places(image, model.cameras[image.camera_id], near, tuning.sky_points)
    return seen


def _lines(
    run: Run, scene: Scene, model: pycolmap.Reconstruction, points: np.ndarray
) -> tuple[dict[str, Lines], tuple[str, ...]]:
    """Waterline and horizon of each registered image by the model, with notes."""
    poses = {i.name: i.cam_from_world() for i in model.images.values() if i.has_pose}
    matrices = np.full((len(scene), 4, 4), np.nan)
    for k, name in enumerate(scene.names):
        if name in poses:
            matrices[k] = matrix(poses[name])
    side = scene.of_role("side")
    up = up_vector(matrices[side], scene.frame[side], run.settings.tuning.sfm.world.up)
    if up is None or not up.ring:
        return {}, ("no ring of cameras defines the vertical: the water stays as it was learnt",)
    views = _views(run, scene, model, matrices)
    tuning = run.settings.tuning.masks.waterline
    level = [n for n in views if scene.sensor_of(scene.image_index[n]).role == "side"]
    count = min(run.settings.tuning.masks.refine.most_views, len(level))
    chosen = [level[k] for k in np.unique(np.linspace(0, len(level) - 1, count).astype(int))]
    first = run.map(read_image, [classes_path(run.folder, n) for n in chosen])
    water = find_water([views[n] for n in chosen], [first_line(c, tuning) for c in first], points, up.direction, tuning)
    lines = {name: lines_of(view, up.direction, water) for name, view in views.items()}
    if water is None:
        return lines, ("no sky below the horizon; no water level was found, so the water stays as it was learnt",)
    unit = world_unit(run.folder)
    return lines, (
        f"water {water.depth:.3g} {unit} below the cameras (middle half of {water.rays} rays: +-{water.spread:.2g}), "
        "out to the banks of the model; no sky below the horizon",
    )


def _views(run: Run, scene: Scene, model: pycolmap.Reconstruction, matrices: np.ndarray) -> dict[str, View]:
    grids: dict[int, np.ndarray] = {}
    ids = {i.name: i.camera_id for i in model.images.values()}
    views = {}
    for k in np.flatnonzero(np.isfinite(matrices).all(axis=(1, 2))):
        name = scene.names[k]
        if not classes_path(run.folder, name).exists():
            continue
        camera = ids[name]
        if camera not in grids:
            shape = read_image(classes_path(run.folder, name)).shape[:2]
            grids[camera] = camera_rays(model.cameras[camera], shape, run.settings.tuning.masks.waterline)
        rotation, shift = matrices[k, :3, :3], matrices[k, :3, 3]
        views[name] = View(grids[camera] @ rotation, -rotation.T @ shift)
    return views


def _final_item(item: tuple[str, tuple[np.ndarray, Lines | None] | None], folder: Path, tuning: Tuning) -> None:
    name, known = item
    final = folder / FINAL
    classes, mask = classes_path(folder, name), mask_path(folder, name)
    if known is not None and classes.exists():
        points, lines = known
        first, use = read_image(classes), read_mask(folder, name)
        found = first if lines is None else final_classes(first, lines, tuning.waterline)
        found = without_points(found, points, tuning.sky_points)
        if use.any() and (found != first).any():
            save_png(classes_path(final, name), found)
            keep = full_size(found == USE, use.shape)  # type: ignore[arg-type]
            save_png(mask_path(final, name), keep)
            return
    if classes.exists():
        same_file(classes, classes_path(final, name))
    same_file(mask, mask_path(final, name))


def _used(name: str, folder: Path) -> tuple[float, float]:
    return float(read_mask(folder, name).mean()), float(read_mask(folder / FINAL, name).mean())


def _tables(run: Run, scene: Scene) -> dict[str, dict]:
    names = [n for n in scene.names if classes_path(run.path(FINAL), n).exists()]
    if not names:
        return {}
    before, now = (np.array(run.map(class_shares, names, f)) for f in (run.folder, run.path(FINAL)))
    key = scene.sensor_key[[scene.image_index[n] for n in names]]
    rows = [
        [s.name, *(float(100 * x[key == k][:, c].mean()) for c in (USE, WATER) for x in (before, now))]
        for k, s in enumerate(scene.all_sensors)
        if (key == k).any()
    ]
    heads = [f"{NAMES[c]} {when} %" for c in (USE, WATER) for when in ("before", "now")]
    return {"final masks": {"columns": ["camera", *heads], "rows": rows}}
