"""Glue of masks and refine: the usable pixels of the images for features, and the same corrected by the model."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
from scipy.spatial import cKDTree

from tiegraph import papers
from tiegraph.errors import choose
from tiegraph.geometry.gravity import looking_up, up_vector
from tiegraph.masks import EGO, NAMES, USE, WATER, waterline
from tiegraph.masks.frames import full_size, image_size
from tiegraph.masks.platform import flags, image_quality
from tiegraph.masks.settings import MasksSettings
from tiegraph.masks.skyline import places, without_points
from tiegraph.masks.sources import SOURCES, Camera, MaskSource, explain_source
from tiegraph.masks.tuning import Tuning
from tiegraph.pipeline import files
from tiegraph.plugins import chosen
from tiegraph.project.run import Run
from tiegraph.project.stages import Outcome, write_atomic
from tiegraph.scene.atomic import same_file
from tiegraph.scene.colmapmodel import image_poses
from tiegraph.scene.decoding import opaque
from tiegraph.scene.scene import Scene
from tiegraph.scene.wideviews import lit
from tiegraph.text import csv_text


def masks(run: Run) -> Outcome:
    """One mask an image: learnt from the whole sequence, then applied image by image."""
    scene, settings, tuning = files.scanned(run), run.settings.masks, run.settings.tuning.masks
    source, why = explain_source(scene, settings, tuning)
    run.path("classes").mkdir(parents=True, exist_ok=True)
    prepared: dict[int, Any] = {}
    if any(not files.mask_path(run.folder, n).exists() for n in scene.names):
        prepared = _source(source).prepare(_cameras(scene, run.path("images")), settings, tuning, run.map)
    of = run.folder, run.folder, source, settings, tuning, _known_of(scene, prepared, tuning)
    run.make_missing(_mask_item, scene.names, lambda n: files.mask_path(run.folder, n), *of)
    shares = np.array(run.map(_shares, scene.names, run.folder))  # (N, classes)
    flagged = _flagged(run, scene)
    left_out = {n: why for n, why in flagged.items() if why.split(":")[0] in _LEFT_OUT[settings.leave_out]}
    for name in left_out:
        files.save_png(files.mask_path(run.folder, name), np.zeros_like(files.read_mask(run.folder, name)))
    rows = (
        [name, *("" if np.isnan(s) else f"{100 * s:.1f}" for s in own), flagged.get(name, "")]
        for name, own in zip(scene.names, shares)
    )
    write_atomic(run.path("masks.csv"), csv_text(["image", *(f"{n}_percent" for n in NAMES), "flag"], rows))
    empty = {n: "the mask leaves nothing of it" for n, s in zip(scene.names, shares[:, USE]) if s == 0}
    counts = {"images": len(scene), "used_percent": round(float(100 * shares[:, USE].mean()), 1)}
    notes = [f"source {source}: {why}"]
    # Used of all pixels: more is seen of an object before a backdrop
    if source == "folder" and counts["used_percent"] < 20:
        notes.append("the masks leave little of the images: 255 (or 1) is used, 0 ignored; are they inverted?")
    notes += [f"{s.name}: {n}" for k, s in enumerate(scene.all_sensors) if (n := getattr(prepared.get(k), "note", ""))]
    if flagged:
        kinds = {kind: sum(why.startswith(kind) for why in flagged.values()) for kind in ("blurred", "similar")}
        text = " and ".join(f"{n} {kind}" for kind, n in kinds.items() if n)
        done = f"{len(left_out)} of them left out" if left_out else "kept; masks.leave_out leaves them out"
        notes.append(f"hardly worth keeping: {text} images ({done}); masks.csv names them")
    known = {n: shares[:, k] for k, n in enumerate(NAMES) if np.isfinite(shares[:, k]).any()}
    return Outcome(
        {**counts, "flagged": len(flagged)},
        dropped=tuple((empty | left_out).items()),
        notes=tuple(notes),
        tables={"shares of the images": _by_camera(scene, scene.sensor_key, known)},
    )


def masks_by(source: str, scene: Scene, images: Path, target: Path, tuning: Tuning) -> None:
    """Masks ``target``/<image>.png of all images of a scene by another source with default settings."""
    choose("mask source", source, {n: None for n in (*SOURCES, *papers.MASKS) if n not in _NEED_A_FILE})
    made = _source(source)
    settings = MasksSettings(source=source)  # type: ignore[arg-type]
    prepared = made.prepare(_cameras(scene, images), settings, tuning, map)
    for k, name in enumerate(scene.names):
        keep = made.mask(images / name, prepared[int(scene.sensor_key[k])], settings, tuning, scene.mask_name(k))
        files.save_png(target / f"{name}.png", keep)


_NEED_A_FILE = ("folder", "model")
_LEFT_OUT = {"none": (), "blurred": ("blurred",), "similar": ("similar",), "both": ("blurred", "similar")}


def _source(name: str) -> MaskSource:
    papers.plug_in(papers.MASKS, name, SOURCES)
    return chosen("masks", name, SOURCES)  # type: ignore[no-any-return]


def _cameras(scene: Scene, folder: Path) -> dict[int, Camera]:
    order = np.lexsort((scene.sequence_index[scene.frame], scene.sequence[scene.frame]))
    found = {}
    for key, sensor in enumerate(scene.all_sensors):
        images = tuple(folder / scene.names[k] for k in order if scene.sensor_key[k] == key)
        view = None if sensor.source is None else sensor.source.view
        if images:
            found[key] = Camera(images, sensor.role == "up", "" if view is None else view.name)
    return found


_Prepared = dict[str, tuple[Any, np.ndarray | None, str]]
"""By name of an image what was prepared for its camera, the image circle of its lens (H, W) bool, and how its mask is
named in a folder of the user's."""


def _known_of(scene: Scene, prepared: Mapping[int, Any], tuning: Tuning) -> _Prepared:
    circles = [lit(s, tuning.fisheye_half_deg) for s in scene.all_sensors]
    keys = enumerate(scene.sensor_key.tolist())
    return {scene.names[k]: (prepared.get(key), circles[key], scene.mask_name(k)) for k, key in keys}


def _mask_item(
    name: str, folder: Path, target: Path, source: str, settings: MasksSettings, tuning: Tuning, known: _Prepared
) -> None:
    """Makes the mask of an image of a run folder, in that or another folder."""
    (prepared, lit_there, found), image = known[name], folder / "images" / name
    whole = opaque(image)
    if whole is not None:
        lit_there = whole if lit_there is None else whole & lit_there
    use = _source(source).look(image, prepared, settings, tuning, found)
    if use.dtype != bool:
        classes = use if lit_there is None else np.where(full_size(lit_there, use.shape), use, EGO).astype(np.uint8)
        files.save_png(files.classes_path(target, name), classes)
        use = classes == USE
    keep = full_size(use, image_size(image))
    if lit_there is not None:
        keep = keep & lit_there
    files.save_png(files.mask_path(target, name), keep)


def _shares(name: str, folder: Path) -> np.ndarray:
    """Shares of the classes; of a source without classes only the used one is known, the others are NaN."""
    if not files.classes_path(folder, name).exists():
        return np.array([files.read_mask(folder, name).mean(), *[np.nan] * (len(NAMES) - 1)])
    return files.class_shares(name, folder)


def _flagged(run: Run, scene: Scene) -> dict[str, str]:
    found, tuning = {}, run.settings.tuning.masks
    for camera in _cameras(scene, Path()).values():
        names = [p.as_posix() for p in camera.images]
        quality = run.map(_quality, zip(names, [None, *names[:-1]]), run.folder, tuning)
        found.update({n: why for n, why in zip(names, flags(quality, tuning)) if why})
    return dict(sorted(found.items()))


def _quality(pair: tuple[str, str | None], folder: Path, tuning: Tuning) -> tuple[float, float]:
    name, before = pair
    images = folder / "images"
    other = None if before is None else images / before
    return image_quality(images / name, other, files.read_mask(folder, name), tuning)


def _by_camera(scene: Scene, key: np.ndarray, shares: Mapping[str, np.ndarray]) -> dict:
    """Mean shares of the images of each camera, percent; ``key``, ``shares`` (N,) of images."""
    rows = [
        [sensor.name, *(float(100 * share[key == k].mean()) for share in shares.values())]
        for k, sensor in enumerate(scene.all_sensors)
        if (key == k).any()
    ]
    return {"columns": ["camera", *(f"{name} %" for name in shares)], "rows": rows}


def refine(run: Run) -> Outcome:
    """Final masks: waterline and horizon of the model where a mask knows its classes, the first masks elsewhere."""
    scene = files.checked(run)
    known: dict[str, tuple[np.ndarray, waterline.Lines | None]] = {}
    notes: tuple[str, ...] = ("the first masks are the final ones, by the setting",)
    water: float | None = None
    again: _Prepared = {}
    if run.settings.refine.geometry == "auto":
        notes = ("the first masks do not say what is sky and water: they are the final ones",)
        if any(files.classes_path(run.folder, n).exists() for n in scene.names):
            model = files.load_model(run.path("sparse", "world"))
            known, water, notes = _known(run, scene, model)
            again, which = _upward(run, scene, image_poses(model, scene))
            notes = *which, *notes
    todo = [(n, known.get(n)) for n in scene.names if not files.mask_path(run.path(files.FINAL), n).exists()]
    run.reporter.total(len(scene), len(scene) - len(todo))
    run.map(_final_item, todo, run.folder, again, run.settings.masks, run.settings.tuning.masks)
    used = np.array(run.map(_used, scene.names, run.folder))  # (N, 2): before, now
    changed = int((used[:, 0] != used[:, 1]).sum())
    counts = {"images": len(scene), "changed": changed, "used_percent": round(float(100 * used[:, 1].mean()), 1)}
    counts |= {} if water is None else {"water_height": round(water, 3)}
    return Outcome(counts, notes=notes, tables=_tables(run, scene))


def _known(
    run: Run, scene: Scene, model: pycolmap.Reconstruction
) -> tuple[dict[str, tuple[np.ndarray, waterline.Lines | None]], float | None, tuple[str, ...]]:
    """Data of the model for each registered image: points (K, 2) f4 in it, shares of width and height, also hidden
    ones; its waterline and horizon, None if no ring of cameras defines the vertical. The height of the water in the
    world, and notes."""
    least = run.settings.tuning.masks.witnesses
    points = np.array([p.xyz for p in model.points3D.values() if p.track.length() >= least]).reshape(-1, 3)
    seen = _seen(run, model, points)
    lines, water, notes = _lines(run, scene, model, image_poses(model, scene), points)
    return {n: (seen[n], lines.get(n)) for n in seen}, water, ("no sky where the model has points", *notes)


def _upward(run: Run, scene: Scene, matrices: np.ndarray) -> tuple[_Prepared, list[str]]:
    """New masks of the cameras that look up by the poses (N, 4, 4) of the model, where no rig file had said so: sky is
    anywhere in their images. A note."""
    settings, tuning = run.settings.masks, run.settings.tuning.masks
    source = explain_source(files.scanned(run), settings, tuning)[0]
    posed = np.isfinite(matrices).all(axis=(1, 2)) & scene.of_role("side")
    up, keys = looking_up(matrices, scene.frame), scene.sensor_key
    turned = [k for k in np.unique(keys[posed]).tolist() if np.mean(up[posed & (keys == k)]) > 0.5]
    if source != "learnt" or not turned:
        return {}, []
    cameras = {k: replace(c, upward=True) for k, c in _cameras(scene, run.path("images")).items() if k in turned}
    prepared = _source(source).prepare(cameras, settings, tuning, run.map)
    known = {n: own for n, own in _known_of(scene, prepared, tuning).items() if own[0] is not None}
    names = ", ".join(scene.all_sensors[k].name for k in turned)
    return known, [f"{names} looks up by the model: its masks were made again"]


def _seen(run: Run, model: pycolmap.Reconstruction, points: np.ndarray) -> dict[str, np.ndarray]:
    tuning = run.settings.tuning.masks
    most = 20_000  # the nearest points, which are searched in the sky of an image: a bound of time
    tree = cKDTree(points) if len(points) > most else None
    seen = {}
    for image in model.images.values():
        if not image.has_pose or not files.classes_path(run.folder, image.name).exists():
            continue
        near = points if tree is None else points[tree.query(image.projection_center(), most)[1]]
        seen[image.name] = places(image, model.cameras[image.camera_id], near, tuning)
    return seen


def _lines(
    run: Run, scene: Scene, model: pycolmap.Reconstruction, matrices: np.ndarray, points: np.ndarray
) -> tuple[dict[str, waterline.Lines], float | None, tuple[str, ...]]:
    """Waterline and horizon of each registered image by the model, in which its poses are ``matrices`` (N, 4, 4), the
    height of the water, and notes."""
    side = scene.of_role("side") & ~looking_up(matrices, scene.frame)
    up = up_vector(matrices[side], scene.frame[side], run.settings.tuning.sfm.world.up)
    if up is None or not up.ring:
        return {}, None, ("no ring of cameras defines the vertical: the water stays as it was learnt",)
    views = _views(run, scene, model, matrices)
    tuning = run.settings.tuning.masks
    level = [n for n in views if side[scene.image_index[n]]]
    count = min(240, len(level))  # views whose waterlines measure the water's height
    chosen = [level[k] for k in np.unique(np.linspace(0, len(level) - 1, count).astype(int))]
    first = run.map(files.read_image, [files.classes_path(run.folder, n) for n in chosen])
    water = waterline.find_water(
        [views[n] for n in chosen], [waterline.first_line(c, tuning) for c in first], points, up.direction, tuning
    )
    lines = {name: waterline.lines_of(view, up.direction, water) for name, view in views.items()}
    if water is None:
        return lines, None, ("no sky below the horizon; no water level was found, so the water stays as it was learnt",)
    unit, middle = files.world_unit(run.folder), np.median([v.centre for v in views.values()], axis=0)
    height = float(middle[2] - (middle @ up.direction - water.level) / up.direction[2])
    depth = f"water {water.depth:.3g} {unit} below the cameras (middle half of {water.rays} rays: +-{water.spread:.2g})"
    return lines, height, (f"{depth}, out to the banks of the model; no sky below the horizon",)


def _views(run: Run, scene: Scene, model: pycolmap.Reconstruction, matrices: np.ndarray) -> dict[str, waterline.View]:
    grids: dict[int, np.ndarray] = {}
    ids = {i.name: i.camera_id for i in model.images.values()}
    views = {}
    for k in np.flatnonzero(np.isfinite(matrices).all(axis=(1, 2))):
        name = scene.names[k]
        if not files.classes_path(run.folder, name).exists():
            continue
        camera = ids[name]
        if camera not in grids:
            shape = files.read_image(files.classes_path(run.folder, name)).shape[:2]
            grids[camera] = waterline.camera_rays(model.cameras[camera], shape, run.settings.tuning.masks)
        rotation, shift = matrices[k, :3, :3], matrices[k, :3, 3]
        views[name] = waterline.View(grids[camera] @ rotation, -rotation.T @ shift)
    return views


def _final_item(
    item: tuple[str, tuple[np.ndarray, waterline.Lines | None] | None],
    folder: Path,
    again: _Prepared,
    settings: MasksSettings,
    tuning: Tuning,
) -> None:
    name, known = item
    final = source = folder / files.FINAL
    if name in again and files.read_mask(folder, name).any():
        _mask_item(name, folder, final, "learnt", settings, tuning, again)
    else:
        source = folder
    classes, mask = files.classes_path(source, name), files.mask_path(source, name)
    if known is not None and classes.exists():
        points, lines = known
        first, use = files.read_image(classes), files.read_mask(source, name)
        found = first if lines is None else waterline.final_classes(first, lines, tuning)
        found = without_points(found, points, tuning)
        if use.any() and (found != first).any():
            files.save_png(files.classes_path(final, name), found)
            keep = full_size(found == USE, use.shape)  # type: ignore[arg-type]
            files.save_png(files.mask_path(final, name), keep)
            return
    if source is final:
        return
    if classes.exists():
        same_file(classes, files.classes_path(final, name))
    same_file(mask, files.mask_path(final, name))


def _used(name: str, folder: Path) -> tuple[float, float]:
    return float(files.read_mask(folder, name).mean()), float(files.read_mask(folder / files.FINAL, name).mean())


def _tables(run: Run, scene: Scene) -> dict[str, dict]:
    names = [n for n in scene.names if files.classes_path(run.path(files.FINAL), n).exists()]
    if not names:
        return {}
    before, now = (np.array(run.map(files.class_shares, names, f)) for f in (run.folder, run.path(files.FINAL)))
    key = scene.sensor_key[[scene.image_index[n] for n in names]]
    when = {"before": before, "now": now}
    shares = {f"{NAMES[c]} {name}": found[:, c] for c in (USE, WATER) for name, found in when.items()}
    return {"final masks": _by_camera(scene, key, shares)}
