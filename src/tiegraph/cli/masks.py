"""`tiegraph masks OUT` (the stage) and `tiegraph masks OUT --compare FOLDER` (how good the masks are)."""

from __future__ import annotations

import json
from dataclasses import dataclass
from pathlib import Path
from tempfile import TemporaryDirectory

import tyro

from tiegraph.cli.options import options_of
from tiegraph.cli.output import say
from tiegraph.cli.run import Common, main_stage
from tiegraph.errors import InputError
from tiegraph.masks.compare import compare, compare_classes, table_text
from tiegraph.pipeline.masks import masks_by
from tiegraph.scene.scene import Scene


@dataclass(frozen=True)
class _Options(Common):
    compare: Path | None = None  # main takes it
    """Judge the masks of OUT by the true ones in this folder, and run nothing; `tiegraph masks OUT --compare FOLDER
    --help` shows the options of that."""


def main(arguments: list[str]) -> int:
    """The stage for a run folder; with ``--compare`` the comparison of its masks with true ones."""
    if not any(a == "--compare" or a.startswith("--compare=") for a in arguments):
        return main_stage("masks", arguments, _Options)

    def masks(
        out: tyro.conf.Positional[Path],
        compare: Path,
        keep_labels: tuple[int, ...] = (),
        classes: tuple[str, ...] = (),
        first: bool = False,
        beside: tuple[str, ...] = (),
        json: bool = False,
    ) -> dict:
        """How good the masks of a run are: pixel accuracy, IoU, useful area lost, by camera.

        Args:
            out: The run folder.
            compare: Folder of true masks, named as masks.folder describes: 0 = ignore; or of class labels.
            keep_labels: The useful labels, if the folder holds class labels.
            classes: True labels of the classes, such as sky=0 water=1 platform=2: IoU of each.
            first: Judge the first masks, even if there are final ones.
            beside: Other sources to make masks of the same images by and judge beside, such as meguro2024 meguro2025.
            json: Print JSON.
        """
        return locals()

    given = options_of(masks, "tiegraph masks", arguments)
    as_json = given.pop("json")
    tables = _tables(**given)
    if as_json:
        say(json.dumps(tables))
    else:
        say("\n\n".join(f"{name}\n{table_text(table)}" for name, table in tables.items()))
    return 0


def _tables(
    out: Path,
    compare: Path,
    keep_labels: tuple[int, ...],
    classes: tuple[str, ...],
    first: bool,
    beside: tuple[str, ...],
) -> dict[str, dict]:
    folder = out / "refine" if (out / "refine" / "masks").is_dir() and not first else out
    if not (folder / "masks").is_dir() or not (out / "scene.json").is_file():
        raise InputError(f"{out}: no masks here; run `tiegraph masks` first")
    scene = Scene.from_json((out / "scene.json").read_text())
    cameras = {n: sensor for n, (_, sensor) in zip(scene.names, scene.image_label())}
    which = "final masks" if folder != out else "first masks"
    tables = {which: _compared(folder, compare, cameras, keep_labels)}
    if beside:
        rows = [["this run", *tables[which]["rows"][-1][1:]]]
        for source in beside:
            with TemporaryDirectory() as scratch:
                masks_by(source, scene, out / "images", Path(scratch) / "masks")
                rows.append([source, *_compared(Path(scratch), compare, cameras, keep_labels)["rows"][-1][1:]])
        tables["beside"] = {"columns": ["source", *tables[which]["columns"][1:]], "rows": rows}
    if classes:
        tables["classes"] = compare_classes(folder / "classes", compare, _labels(classes), cameras).table()
    return tables


def _compared(folder: Path, truth: Path, cameras: dict[str, str], keep_labels: tuple[int, ...]) -> dict:
    return compare(folder / "masks", truth, cameras, keep_labels).table()


def _labels(classes: tuple[str, ...]) -> dict[str, int]:
    try:
        return {name: int(label) for name, label in (c.split("=") for c in classes)}
    except ValueError:
        raise InputError(f"--classes {' '.join(classes)}: give name=label, such as sky=0 water=1 platform=2") from None
