"""Glue of masks: from images to the usable pixels for features."""

from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tiegraph import papers
from tiegraph.errors import choose
from tiegraph.masks import EGO, NAMES, USE
from tiegraph.masks.frames import full_size, image_size
from tiegraph.masks.platform import flags, image_quality
from tiegraph.masks.settings import MasksSettings
from tiegraph.masks.sources import SOURCES, Camera, MaskSource, explain_source
from tiegraph.masks.tuning import Tuning
from tiegraph.pipeline.files import class_shares, classes_path, mask_path, read_mask, save_png, scanned
from tiegraph.plugins import chosen
from tiegraph.project.run import Run
from tiegraph.project.stages import Outcome, write_atomic
from tiegraph.scene.decoding import opaque
from tiegraph.scene.scene import Scene
from tiegraph.scene.wideviews import lit
from tiegraph.text import csv_text


def masks(run: Run) -> Outcome:
    """One mask an image: learnt from the whole sequence, then applied image by image."""
    scene, settings, tuning = scanned(run), run.settings.masks, run.settings.tuning.masks
    source, why = explain_source(scene, settings, tuning)
    run.path("classes").mkdir(parents=True, exist_ok=True)
    prepared: dict[int, Any] = {}
    if any(not mask_path(run.folder, n).exists() for n in scene.names):
        prepared = _source(source).prepare(_cameras(scene, run.path("images")), settings, tuning, run.map)
    keyed = {n: (int(scene.sensor_key[k]), scene.mask_name(k)) for k, n in enumerate(scene.names)}
    seen = {k: lit(s, tuning.fisheye_half_deg) for k, s in enumerate(scene.all_sensors)}
    how = _How(folder=run.folder, source=source, settings=settings, tuning=tuning, lit=seen)
    run.make_missing(_mask_item, scene.names, lambda n: mask_path(run.folder, n), how, prepared, keyed)
    shares = np.array(run.map(_shares, scene.names, run.folder))  # (N, classes)
    flagged = _flagged(run, scene)
    left_out = {n: why for n, why in flagged.items() if why.split(":")[0] in _LEFT_OUT[settings.leave_out]}
    for name in left_out:
        save_png(mask_path(run.folder, name), np.zeros_like(read_mask(run.folder, name)))
    rows = (
        [name, *("" if np.isnan(s) else f"{100 * s:.1f}" for s in own), flagged.get(name, "")]
        for name, own in zip(scene.names, shares)
    )
    write_atomic(run.path("masks.csv"), csv_text(["image", *(f"{n}_percent" for n in NAMES), "flag"], rows))
    empty = {n: "the mask leaves nothing of it" for n, s in zip(scene.names, shares[:, USE]) if s == 0}
    flags_said = []
    if flagged:
        kinds = {kind: sum(why.startswith(kind) for why in flagged.values()) for kind in ("blurred", "similar")}
        text = " and ".join(f"{n} {kind}" for kind, n in kinds.items() if n)
        done = f"{len(left_out)} of them left out" if left_out else "kept; masks.leave_out leaves them out"
        flags_said.append(f"hardly worth keeping: {text} images ({done}); masks.csv names them")
    learnt = [f"{s.name}: {n}" for k, s in enumerate(scene.all_sensors) if (n := getattr(prepared.get(k), "note", ""))]
    counts = {"images": len(scene), "used_percent": round(float(100 * shares[:, USE].mean()), 1)}
    inverted = []
    # Used of all pixels: more is seen of an object before a backdrop
    if source == "folder" and counts["used_percent"] < 20:
        inverted.append("the masks leave little of the images: 255 (or 1) is used, 0 ignored; are they inverted?")
    return Outcome(
        {**counts, "flagged": len(flagged)},
        dropped=tuple((empty | left_out).items()),
        notes=(f"source {source}: {why}", *inverted, *learnt, *flags_said),
        tables={"shares of the images": _by_camera(scene, shares)},
    )


def masks_by(source: str, scene: Scene, images: Path, target: Path, tuning: Tuning) -> None:
    """Masks ``target``/<image>.png of all images of a scene by another source with default settings, one after
    another."""
    choose("mask source", source, {n: None for n in (*SOURCES, *papers.MASKS) if n not in _NEED_A_FILE})
    made = _source(source)
    settings = MasksSettings(source=source)  # type: ignore[arg-type]
    prepared = made.prepare(_cameras(scene, images), settings, tuning, map)
    for k, name in enumerate(scene.names):
        keep = made.mask(images / name, prepared[int(scene.sensor_key[k])], settings, tuning, scene.mask_name(k))
        save_png(target / f"{name}.png", keep)


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


@dataclass(frozen=True)
class _How:
    """The common data of the masks of all images."""

    folder: Path
    source: str
    settings: MasksSettings
    tuning: Tuning
    lit: Mapping[int, np.ndarray | None]  # of the cameras: (H, W) bool, image circle of their lenses


def _mask_item(name: str, how: _How, prepared: dict[int, Any], keyed: dict[str, tuple[int, str]]) -> None:
    key, found = keyed[name]
    made, image, lit_there = _source(how.source), how.folder / "images" / name, how.lit[key]
    whole = opaque(image)
    if whole is not None:
        lit_there = whole if lit_there is None else whole & lit_there
    use = made.look(image, prepared[key], how.settings, how.tuning, found)
    if use.dtype != bool:
        classes = use if lit_there is None else np.where(full_size(lit_there, use.shape), use, EGO).astype(np.uint8)
        save_png(classes_path(how.folder, name), classes)
        use = classes == USE
    keep = full_size(use, image_size(image))
    if lit_there is not None:
        keep = keep & lit_there
    save_png(mask_path(how.folder, name), keep)


def _shares(name: str, folder: Path) -> np.ndarray:
    """Shares of the classes; of a source without classes only the used one is known, the others are NaN."""
    if not classes_path(folder, name).exists():
        return np.array([read_mask(folder, name).mean(), *[np.nan] * (len(NAMES) - 1)])
    return class_shares(name, folder)


def _flagged(run: Run, scene: Scene) -> dict[str, str]:
    """Images hardly worth keeping, with the reason."""
    found, tuning = {}, run.settings.tuning.masks
    for camera in _cameras(scene, Path()).values():
        names = [p.as_posix() for p in camera.images]
        quality = run.map(_quality, zip(names, [None, *names[:-1]]), run.folder, tuning)
        found.update({n: why for n, why in zip(names, flags(quality, tuning.quality)) if why})
    return dict(sorted(found.items()))


def _quality(pair: tuple[str, str | None], folder: Path, tuning: Tuning) -> tuple[float, float]:
    name, before = pair
    images = folder / "images"
    other = None if before is None else images / before
    return image_quality(images / name, other, read_mask(folder, name), tuning)


def _by_camera(scene: Scene, shares: np.ndarray) -> dict:
    known = [k for k in range(len(NAMES)) if np.isfinite(shares[:, k]).any()]
    rows = [
        [sensor.name, *(float(100 * shares[scene.sensor_key == key][:, k].mean()) for k in known)]
        for key, sensor in enumerate(scene.all_sensors)
        if (scene.sensor_key == key).any()
    ]
    return {"columns": ["camera", *(f"{NAMES[k]} %" for k in known)], "rows": rows}
