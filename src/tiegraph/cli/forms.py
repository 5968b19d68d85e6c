"""Stages that have another form too: `masks --compare`, `network --coverage`, `evaluate OUT POSES` or of two clouds,
`report --pdf`."""

import json
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any

import tyro

from tiegraph.api import Project, open_project
from tiegraph.cli import run
from tiegraph.cli.options import options_of
from tiegraph.cli.output import say, show_table
from tiegraph.design.coverage import Coverage
from tiegraph.errors import InputError
from tiegraph.evaluate.clouds.judge import Question, Register
from tiegraph.masks.folder import compare, compare_classes, table_text
from tiegraph.project.folder import SETTINGS
from tiegraph.project.settings import read_settings, read_tunings
from tiegraph.report.html import find_browser, print_pdf
from tiegraph.scene.atomic import scratch_folder
from tiegraph.scene.cloudchunks import CLOUD_ENDINGS
from tiegraph.scene.scene import Scene

_ROWS = 20  # weak links shown; the report has all


@dataclass(frozen=True)
class _Masks(run.Common):
    compare: Path | None = None  # masks takes it
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


def masks(arguments: list[str]) -> int:
    """The stage for a run folder; with ``--compare`` the comparison of its masks with true ones."""
    if not any(a == "--compare" or a.startswith("--compare=") for a in arguments):
        return run.main_stage("masks", arguments, _Masks)
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
        from tiegraph.pipeline.masks import masks_by

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


@dataclass(frozen=True)
class _Network(run.Common):
    coverage: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False  # network takes it
    """Say what the tie graph leaves weak, on site: images without ties, what hangs on a single tie, which camera, pass
    or section is tied to the others by fewer than two; of all candidate pairs and of those that the design chose; exit
    code 1 if anything is. And how the surface is covered: by how many images, from which angles, how precisely. A
    folder of images instead of OUT is run up to the design first, with the options of `tiegraph run`."""


def network(arguments: list[str]) -> int:
    """The stage for a run folder; with ``--coverage`` also what is weak: exit code 1 if anything is."""
    if "--coverage" not in arguments:
        return run.main_stage("network", arguments, _Network)
    rest = [a for a in arguments if a != "--coverage"]
    folder, known = run.preparsed(rest)
    if folder is None:
        return run.main_stage("network", rest, _Network)
    if (folder / "scene.json").exists():
        run.main_stage("design", rest)
        return _show_coverage(open_project(None, folder), "--json" in rest)
    run.main([*rest, "--until", "design"])
    return _show_coverage(open_project(folder, known.out), "--json" in rest)


def _show_coverage(project: Project, as_json: bool) -> int:
    found, chosen, surface = project.coverage(), project.coverage(chosen=True), project.surface()
    sound = found.sound and chosen.sound
    if as_json:
        covered = None if surface is None else {**surface.cells.shares(), "places": surface.table()}
        say(json.dumps({**_told(found), "sound": sound, "chosen": _told(chosen), "surface": covered}))
        return 0 if sound else 1
    for what, one in (("candidate pairs", found), ("pairs that the design chose", chosen)):
        for line in one.lines:
            say(f"{what}: {line}")
        rows = one.table["rows"]
        if rows:
            show_table(one.table["columns"], rows[:_ROWS], f"weak links of the {what}")
        if len(rows) > _ROWS:
            say(f"... and {len(rows) - _ROWS} more: the report has all")
    if surface is not None:
        for line in surface.lines():
            say(line)
        table = surface.table()
        if table["rows"]:
            show_table(table["columns"], table["rows"][:_ROWS], "where to go again")
    return 0 if sound else 1


def _told(found: Coverage) -> dict[str, Any]:
    return {"sound": found.sound, **found.counts, "weak_links": found.table}


_OTHERS = (
    "\n\nOr the poses of a run to georef, without its cloud: tiegraph evaluate OUT POSES. Or two point clouds: "
    "tiegraph evaluate CLOUD REFERENCE (.laz, .las, .ply, .e57). --help after them."
)


@dataclass(frozen=True)
class _Poses:
    """How near the poses of a run are to reference poses; it needs no cloud, and nothing is written."""

    run: tyro.conf.Positional[Path]
    """A run folder with a model in the world (to the stage georef)."""
    poses: tyro.conf.Positional[Path]
    """Reference poses as --evaluate.reference takes them: a COLMAP model, a TUM file, a folder of them."""
    reference_origin: tuple[float, float, float] | None = None
    """Latitude, longitude (degrees) and ellipsoidal height (m) of the origin of the reference's east, north, up;
    without it only errors after an alignment are stated."""


@dataclass(frozen=True)
class _Clouds:
    """How near a point cloud is to a reference cloud; of any size, tile by tile."""

    cloud: tyro.conf.Positional[Path]
    """The cloud to judge (.laz, .las, .copc.laz, .ply or .e57)."""
    reference: tyro.conf.Positional[Path]
    """The cloud that counts as true; brought into the CRS of the other where both headers name one."""
    distances_m: tuple[float, ...] = ()
    """Distances in metres at which accuracy, completeness and F-score are stated (default: four that fit the cloud's
    spacing)."""
    register: Register = "none"
    """Lay the cloud on the reference first, by ICP: as a rigid motion or with its scale. What was found is part of the
    result."""
    coarse: bool = False
    """The cloud is far off or turned: start the registration by the shapes of both."""
    out: Annotated[Path | None, tyro.conf.arg(aliases=["-o"])] = None
    """Folder for metrics.json, the map of differences and both clouds with their distances."""
    tuning: Path | None = None
    """A file with other constants: the table [tuning.evaluate]."""


def evaluate(arguments: list[str]) -> int:
    """The stage for a run folder, the comparison of its poses, or of two cloud files."""
    files = [a for a in arguments if not a.startswith("-")]
    if files and Path(files[0]).suffix.lower() in CLOUD_ENDINGS and not Path(files[0]).is_dir():
        from tiegraph.pipeline.clouds import evaluate_clouds

        clouds = options_of(_Clouds, "tiegraph evaluate", arguments)  # says so if the other is missing, or no cloud
        question = Question(distances_m=clouds.distances_m, register=clouds.register, coarse=clouds.coarse)
        tuning = read_tunings(clouds.tuning).evaluate
        result = evaluate_clouds((clouds.cloud, clouds.reference), clouds.out, question, tuning)
    elif len(arguments) >= 2 and Path(arguments[0]).is_dir() and not arguments[1].startswith("-"):
        from tiegraph.pipeline.evaluate import evaluate_poses

        asked = options_of(_Poses, "tiegraph evaluate OUT POSES", arguments)
        result = evaluate_poses(open_project(None, asked.run).as_run(), asked.poses, asked.reference_origin)
    else:
        return run.main_stage("evaluate", arguments, about=_OTHERS)
    for metric in result["metrics"]:
        value = "-" if metric["value"] is None else f"{metric['value']:.4g}"
        say(f"{metric['name']:<24} {value} {metric['unit']}")
    for name, content in result["tables"].items():
        show_table(content["columns"], content["rows"], name, ".3g")
    for note in result["notes"]:
        say(note)
    for text in result.get("contradictions", ()):
        say(f"contradiction: {text}")
    return 0


@dataclass(frozen=True)
class _Report(run.Common):
    pdf: Annotated[bool, tyro.conf.FlagCreatePairsOff] = False  # report takes it
    """Print report.html to report.pdf beside it, by a browser of the Chromium family."""
    language: str | None = None  # report takes it
    """Language of the report: en or ja (sets report.language)."""


def report(arguments: list[str]) -> int:
    """The stage for a run folder; with ``--pdf`` also printed."""
    # --language is the setting of the stage
    rest = [f"--report.{a[2:]}" if a.partition("=")[0] == "--language" else a for a in arguments if a != "--pdf"]
    folder, _ = run.preparsed(rest)
    if len(rest) == len(arguments) or folder is None:
        return run.main_stage("report", rest, _Report)
    find_browser()  # what is missing is said before the work
    code = run.main_stage("report", rest, _Report)
    target = folder / "report.pdf"
    print_pdf(folder / "report.html", target)
    if "--quiet" not in rest and "--json" not in rest:
        say(f"printed: {target}")
    return code
