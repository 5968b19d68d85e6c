"""What of a run folder its rigs are read from: the models, the receipts, the constants they were made with."""

from __future__ import annotations

from dataclasses import dataclass, field, replace
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap

from tiegraph.errors import InputError, SettingsError, UnreadableArtefact
from tiegraph.pipeline.files import load_json, load_model, load_scene
from tiegraph.project.folder import SETTINGS, check_format, names_run
from tiegraph.project.receipts import Receipts
from tiegraph.project.settings import Tunings, merged, read_settings
from tiegraph.scene.rig import Rig
from tiegraph.scene.scene import Scene


@dataclass(frozen=True)
class Metres:
    """What a unit of ``sparse/0`` is in metres (NaN = nothing told), the sigma of that (a share), and who told."""

    scale: float = np.nan
    sigma: float = np.nan
    source: str = "none"


@dataclass
class FoundRun:
    """What of a run folder the rigs are read from; ``said`` and ``unscaled`` are added to."""

    folder: Path
    scene: Scene
    receipt: dict[str, Any]  # of sparse
    mapped: pycolmap.Reconstruction  # as sparse left it
    world: pycolmap.Reconstruction  # as georef left it; the same without
    metres: Metres
    antenna_m: tuple[float, float, float] | None
    tuning: Tunings
    said: list[str] = field(default_factory=list)
    unscaled: list[str] = field(default_factory=list)  # rigs whose lengths are in units of the model

    def drawn(self, index: int) -> Rig:
        """A rig as candidates left it, before the coarse model turned cameras."""
        return load_scene(self.folder / "candidates" / "scene.json").rigs[index]

    def rows(self, table: str) -> list[list]:
        """Rows of a table of the receipt of sparse."""
        return list(self.receipt.get("tables", {}).get(table, {}).get("rows", ()))


def found_run(folder: Path) -> FoundRun:
    """The models of a run folder and what is said of them. Raises InputError for a folder that is no run, has no sparse
    model, or whose cameras are views; UnreadableArtefact for what is damaged; SettingsError for its tiegraph.toml."""
    if not names_run(str(folder)):
        raise InputError(f"{folder} is no run folder: give one that `tiegraph run IMAGES -o FOLDER` made")
    check_format(folder)
    receipts = Receipts(folder)
    receipt, placed = receipts.read("sparse"), receipts.read("georef")
    first, world = folder / "sparse" / "0", folder / "sparse" / "world"
    if not receipt.get("finished") or not (first / "cameras.bin").exists():
        raise InputError(f"{folder}: this run has no sparse model yet; `tiegraph sparse {folder}` makes it")
    scene = load_scene(folder / "network" / "scene.json")
    if any(s.source is not None and s.source.panorama for s in scene.all_sensors):
        raise InputError(f"{folder}: its cameras are views of panoramas, which need no rig file: give --rig panorama")
    if any(s.source is not None and s.source.view is not None for s in scene.all_sensors):
        raise InputError(
            f"{folder}: its cameras are views of fisheye images, whose lenses it used as they were given: give the rig "
            "file of that run, or calibrate them in a run with --scan.fisheye whole"
        )
    mapped = load_model(first)
    run = FoundRun(
        folder=folder,
        scene=scene,
        receipt=receipt,
        mapped=mapped,
        world=mapped,
        metres=Metres(),
        antenna_m=None,
        tuning=_constants(folder, receipts),
    )
    current = placed.get("finished") and placed.get("from", {}).get("sparse") == receipt.get("made")
    if not current or not (world / "cameras.bin").exists():
        return run
    told = load_json(folder / "world.json")
    scale = float("nan") if told["scale_source"] == "none" else float(told["scale"])
    sigma = told.get("sigma", {}).get("scale", receipt.get("counts", {}).get("scale_sigma", 0.0))
    arm = told.get("antenna_m")
    return replace(
        run,
        world=load_model(world),
        metres=Metres(scale, sigma, told["scale_source"]),
        antenna_m=None if arm is None else tuple(arm),
    )


def _constants(folder: Path, receipts: Receipts) -> Tunings:
    """Those that scan read the rig and sparse made the model with; before them count those of tiegraph.toml."""
    made: dict[str, Any] = {}
    for stage in ("scan", "sparse"):
        own = receipts.read(stage).get("tuning", {})
        try:
            merged({"tuning": own})
        except SettingsError as error:
            raise UnreadableArtefact(receipts.path(stage), error) from None
        made |= own
    return read_settings(folder / SETTINGS, {"tuning": made}).tuning
