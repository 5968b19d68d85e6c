"""`tiegraph masks OUT` (the stage) and `tiegraph masks OUT --compare FOLDER` (how good the masks are)."""

import json
from dataclasses import dataclass
from pathlib import Path

import tyro

from tiegraph.cli.options import options_of
from tiegraph.cli.output import say
from tiegraph.cli.run import Common, main_stage
from tiegraph.errors import InputError
from tiegraph.masks.folder import compare, compare_classes, table_text
from tiegraph.pipeline.masks import masks_by
from tiegraph.project.folder import SETTINGS
from tiegraph.project.settings import read_settings
from tiegraph.scene.atomic import scratch_folder
from tiegraph.scene.scene import Scene


@dataclass(frozen=True)
class _Options(Common):
    compare: Path | None = None  # main takes it
    """Judge the masks of OUT by the true ones in this folder, and run nothing; `tiegraph masks OUT --compare FOLDER
    --help` shows the options of that."""


@dataclass(frozen=True)
class _Compare:
    """How good the masks of a run are: pixel accuracy, IoU, useful area lost, by camera."""

    out: tyro.conf.Positional[Path]
    """The run folder."""
    compare: Path
    """Folder of true masks, named as masks.folder describes: 0 = ignore; or of class labels."""
    keep_labels: tuple[int, ...] = ()
    """The useful labels, if the folder holds class labels."""
    classes: tuple[str, ...] = ()
    """True labels of the classes, such as sky=0 water=1 platform=2: IoU of each."""
    first: bool = False
    """Judge the first masks, even if there are final ones."""
    beside: tuple[str, ...] = ()
    """Other sources to make masks of the same images by and judge beside, such as meguro2024 meguro2025."""
    json: bool = False
    """Print JSON."""


def main(arguments: list[str]) -> int:
    """The stage for a run folder; with ``--compare`` the comparison of its masks with true ones."""
    if not any(a == "--compare" or a.startswith("--compare=") for a in arguments):
        return main_stage("masks", arguments, _Options)
    asked = options_of(_Compare, "tiegraph masks", arguments)
    tables = _tables(asked)
    if asked.json:
        say(json.dumps(tables))
    else:
        say("\n\n".join(f"{name}\n{table_text(table)}" for name, table in tables.items()))
    return 0


def _tables(asked: _Compare) -> dict[str, dict]:
    out = asked.out
    folder = out / "refine" if (out / "refine" / "masks").is_dir() and not asked.first else out
    if not (folder / "masks").is_dir() or not (out / "scene.json").is_file():
        raise InputError(f"{out}: no masks here; run `tiegraph masks` first")
    scene = Scene.from_json((out / "scene.json").read_text())
    cameras = {n: sensor for n, (_, sensor) in zip(scene.names, scene.image_label())}
    which = "final masks" if folder != out else "first masks"

    def compared(masks: Path) -> dict:
        found = compare(masks, asked.compare, cameras, asked.keep_labels)
        if found.unfit:
            raise InputError(found.unfit[0])
        return found.table()

    tables = {which: compared(folder / "masks")}
    if asked.beside:
        rows = [["this run", *tables[which]["rows"][-1][1:]]]
        tuning = read_settings(out / SETTINGS).tuning.masks
        for source in asked.beside:
            with scratch_folder() as scratch:
                masks_by(source, scene, out / "images", scratch / "masks", tuning)
                rows.append([source, *compared(scratch / "masks")["rows"][-1][1:]])
        tables["beside"] = {"columns": ["source", *tables[which]["columns"][1:]], "rows": rows}
    if asked.classes:
        tables["classes"] = compare_classes(folder / "classes", asked.compare, _labels(asked.classes), cameras).table()
    return tables


def _labels(classes: tuple[str, ...]) -> dict[str, int]:
    try:
        return {name: int(label) for name, label in (c.split("=") for c in classes)}
    except ValueError:
        raise InputError(f"--classes {' '.join(classes)}: give name=label, such as sky=0 water=1 platform=2") from None
