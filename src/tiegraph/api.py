"""The Python API: ``tiegraph.open(images, ...)`` gives a Project that runs stages and hands out their results."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass, field
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from tiegraph.errors import InputError, ReconstructionError, SettingsError, choose
from tiegraph.pipeline import SHOTS, STAGES, foundrig, table
from tiegraph.pipeline.inputs import check_given
from tiegraph.project import settings as project_settings
from tiegraph.project.folder import SETTINGS, check_format, names_run, write_settings
from tiegraph.project.inputs import FOLLOW, Inputs
from tiegraph.project.progress import Reporter
from tiegraph.project.run import Run, check_run, let_go, run_stages, status, without_inputs
from tiegraph.project.settings import SETTING_OF, Settings
from tiegraph.project.stages import Stage, needed
from tiegraph.project.stores import fetch, place_of, url_of
from tiegraph.scene import results
from tiegraph.scene.atomic import names_file, real_path
from tiegraph.scene.bags import source_of
from tiegraph.scene.colmapmodel import read_model, registration
from tiegraph.scene.names import check_text
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.results import Accuracy, Cloud, DepthMap, Metric, Model
from tiegraph.scene.scene import Scene

if TYPE_CHECKING:  # the drawing of figures loads as slowly as all else together
    from tiegraph.design.coverage import Coverage, CoveredSurface
    from tiegraph.pipeline.plan import Forecast

_NAMED = ("rig", "camera")  # each a file, or words
_PATHS = ("gnss", "trajectory", "start", "times")


@dataclass(eq=False)
class Project:
    """A survey and its run folder. Results are read from the folder; asking for one does not run anything."""

    folder: Path
    inputs: Inputs
    settings: Settings
    preset: str = "default"
    pool: str = "local"
    stores: dict[str, Path] = field(default_factory=dict)  # of the inputs: URLs and the places of their copies

    def __repr__(self) -> str:
        return f"Project({self.inputs.images} -> {self.folder})"

    def run(self, until: str | None = None, reporter: Reporter | None = None) -> Project:
        """Run what is out of date, up to and including a stage; returns itself.

        Where the images give nothing for a stage the report says so; ReconstructionError is raised if that stage was
        asked for. Raises InputError, SettingsError or EngineMissing too; what was finished is kept.
        """
        self._run(table(until), until, reporter)
        return self

    def fetch(self, reporter: Reporter | None = None) -> None:
        """Copy inputs that were given as URLs, or what has changed of them, beside the run folder; ``run`` does it
        itself. Raises InputError and EngineMissing."""
        for url in list(self.stores):
            fetch(url, self.stores[url], reporter or Reporter("quiet"))
            del self.stores[url]

    def doubtful(self, until: str | None = None) -> bool:
        """Whether anything contradicts anything, or nothing came of a stage, up to and including one."""
        return any(self.receipt(s.name).get("contradictions") for s in needed(table(until), until))

    def as_run(self, reporter: Reporter | None = None) -> Run:
        """The project as the stages see it."""
        return Run(self.folder, self.inputs, self.settings, self.pool, reporter)

    def _run(self, stages: tuple[Stage, ...], until: str | None, reporter: Reporter | None) -> None:
        run = self.as_run(reporter)
        check_run(stages, run)
        self.fetch(reporter)
        if not without_inputs(stages, run, until):
            check_given(stages, run)
        run_stages(stages, run, until, self.save)

    def let_go(self) -> int:
        """Remove the depth maps of a finished survey, by far its largest files; the bytes that this freed.

        All else stays up to date; they are made again when a stage or ``export`` needs them."""
        return let_go(STAGES, self.as_run())

    def forecast(self) -> Forecast | None:
        """What a run will need of disk and CPU time; None for videos and bags. Nothing is written."""
        from tiegraph.pipeline.plan import forecast  # loads the engines

        self.fetch()
        return forecast(self.as_run())

    def status(self) -> list[tuple[str, str, dict]]:
        """(stage, why it is out of date or "", its receipt) for every stage, without running."""
        return status(STAGES, self.as_run())

    def save(self) -> Callable[[], None]:
        """Write tiegraph.toml into the run folder if what it says differs from this project; what takes it back.

        A file that somebody else wrote or edited stays, as ``tiegraph.before-<n>.toml``.
        """
        run: dict[str, Any] = {"images": str(self.inputs.images), "preset": self.preset}
        given = {n: getattr(self.inputs, n) for n in (*_NAMED, *_PATHS)}
        run.update({n: None if value is None else str(value) for n, value in given.items()})
        base = project_settings.merged(project_settings.preset(self.preset))
        own = project_settings.changed(self.settings)
        inherited = project_settings.changed(base)
        text = project_settings.file_text(run, _differing(self.settings.model_dump(mode="json"), own, inherited))
        path = self.folder / SETTINGS
        if path.exists() and project_settings.read_file(path) == project_settings.parse(text):
            return lambda: None
        return write_settings(self.folder, text)

    def shots(
        self, near_m: float | None = None, far_m: float | None = None, reporter: Reporter | None = None
    ) -> list[Path]:
        """A cloud for each shot of a calibrated rig, from the calibration alone (paper 004): the PLY files, in the
        frame of the rig's first camera. Raises InputError for a rig that is not fully calibrated, SettingsError for a
        distance that is none."""
        sought = project_settings.merged({"shots": {"near_m": near_m, "far_m": far_m}}).shots
        self.settings = self.settings.model_copy(update={"shots": sought})
        self._run((*STAGES, SHOTS), SHOTS.name, reporter)
        from tiegraph.pipeline.files import whole
        from tiegraph.pipeline.shots import cloud_path  # loads the dense engine

        scene = whole(self.as_run())
        return [cloud_path(self.folder, scene, frame) for frame in range(scene.frames)]

    def posed_shots(self, folder: str | Path, reporter: Reporter | None = None) -> list[Path]:
        """The clouds of ``shots`` whose frames have a pose, as LAZ in the world of the georeferenced model: a new
        folder. A model without scale gets that of the shots. Raises InputError without shots or metres, and for a
        folder that holds something."""
        from tiegraph.pipeline.shots import posed_shots  # loads the engine

        files, said = posed_shots(self.as_run(), Path(folder))
        if reporter is not None and said:
            reporter.say(said)
        return files

    def odometry(self, out: str | Path, reporter: Reporter | None = None) -> tuple[Any, ...]:
        """The path of the cameras from the images alone: a TUM file ``out`` and a CSV beside it, or a folder with a
        pair a pass; what was made of each (``pipeline.odometry.Made``). Masks are used if the settings name a folder.
        Raises InputError for a rig or camera that is not calibrated and files that are there already,
        ReconstructionError if nothing can be followed."""
        from tiegraph.pipeline.odometry import odometry  # loads the engine

        reporter = reporter or Reporter("quiet")
        self._run(STAGES, "scan" if self.settings.masks.folder is None else "masks", reporter)
        return odometry(self.as_run(reporter), Path(out))

    def baseline(
        self, name: str, sample: int, out: str | Path | None = None, reporter: Reporter | None = None
    ) -> dict[str, Any]:
        """This survey's method beside another (``pipeline.baseline.BASELINES``) on a block of about ``sample`` of its
        images, each run by itself to `georef`: tables, and the speed-up at equal registration. ``out`` (default:
        ``<run folder>_block<sample>``) keeps both; again, it goes on there. Raises InputError for a run without a
        model, a name that is none, and an ``out`` that holds something else."""
        from tiegraph.pipeline import baseline as glue  # loads the engine

        choose("baseline", name, dict.fromkeys(glue.BASELINES))
        folder = self.folder.with_name(f"{self.folder.name}_block{sample}") if out is None else Path(out).absolute()
        block = glue.lay_out(self.as_run(), sample, folder)
        # What says what the inputs are, not what is made of them
        scan = self.settings.scan.model_dump(mode="json", exclude_defaults=True)
        control = {"gcp": self.settings.georef.gcp, "marks": self.settings.georef.marks}
        given = {"scan": scan, "georef": {k: v for k, v in control.items() if v is not None}}
        sides: dict[str, tuple[str, Any]] = {"tiegraph": (self.preset, self.settings), name: (name, given)}
        notes = []
        for side, (preset, settings) in sides.items():
            if side == "colmap":
                glue.run_colmap(block, block.side("tiegraph") / "images")
                continue
            # The survey of the block's images; a model to start from is the survey's own method's.
            silent = {*block.silent, *(("start",) if side != "tiegraph" else ())}
            same = {n: getattr(self.inputs, n) for n in (*_NAMED, *_PATHS) if n not in silent}
            how: dict[str, Any] = {"preset": preset, "settings": settings, "pool": self.pool}
            other = block.side(side) != self.folder
            project = open_project(block.images, block.side(side), **how, **same) if other else self
            notes.append(glue.interrupted_note(block, side, STAGES))
            try:
                project.run(glue.UNTIL, reporter)
            except ReconstructionError as error:
                notes.append(f"{side} made no model: {error}")
        return glue.judged(block, name, STAGES, [n for n in notes if n])

    def export(self, folder: str | Path, to: str = "dense", camera: str = "", reporter: Reporter | None = None) -> int:
        """Write a folder for another program, here or at a URL; how many images, poses, cameras, points or (results)
        files it has. ``to``: ``dense``, the depth maps as a dense workspace of COLMAP, or a name of `tiegraph export
        --to`; ``camera``: whose trajectory tum and kitti are of (default: the rig's). Raises InputError for what is
        not there yet, a world that is not on the Earth (geojson, gpkg) and a folder that holds something,
        SettingsError for a name that is none, EngineMissing without the package for a store."""
        from tiegraph.pipeline import export  # loads the engines

        self._needed(*export.needed(to))
        return export.hand_out(self.as_run(reporter), folder, to, camera)

    def rig_file(self, form: str = "rig") -> tuple[str, tuple[str, ...]]:
        """The rig as the model has it, with sigmas, as text of a rig.toml or (``form`` = "rig_config") of COLMAP's
        rig_config.json; and what to say of it. Raises InputError if there is no sparse model, or nothing told metres.
        """
        found = foundrig.rig_file(self.folder, form)
        return found.text, found.said

    def scene(self) -> Scene:
        """The images, frames and rigs (after `network`: with sections and a checked rig)."""
        checked = self.folder / "network" / "scene.json"
        path = checked if checked.exists() else self._needed("scene.json", "scan")
        return Scene.from_json(path.read_text())

    def candidates(self) -> Pairs:
        """The pair table after `network`: every pair that was looked at, and why it was dropped."""
        return self._pairs("network.npz", "network")

    def coverage(self, chosen: bool = False) -> Coverage:
        """Do the candidate pairs hold the survey together, and where are they weak (paper 003's check on site)?
        ``chosen``: those that the design chose to be matched."""
        from tiegraph.pipeline.network import coverage_of  # loads the engine

        self._needed(*(("pairs.npz", "design") if chosen else ("network.npz", "network")))
        return coverage_of(self.as_run(), chosen)

    def surface(self) -> CoveredSurface | None:
        """How well the surface is covered, by the coarse model: by how many images, under which angles, with what
        precision, and where to go again; None if there is no such model."""
        from tiegraph.pipeline.network import surface_of  # loads the engine

        self._needed("network.npz", "network")
        return surface_of(self.as_run())

    def pairs(self) -> Pairs:
        """The pair table of the last stage that made one: `match` (with inliers) or `design`."""
        return self._pairs("match.npz" if (self.folder / "match.npz").exists() else "pairs.npz", "design")

    def model(self) -> Model:
        """The georeferenced model, a ``pycolmap.Reconstruction``."""
        return read_model(self._needed("sparse/world", "georef"))

    def registered(self) -> tuple[str, ...]:
        """Names of the images that see points of the georeferenced model and agree with them; the others of the model
        stand where their rig places them."""
        scene = self.scene()
        found = registration(self.model(), scene, self.settings.tuning.scene.registered).registered
        return tuple(name for name, good in zip(scene.names, found) if good)

    def cloud(self) -> Cloud:
        """The dense cloud in world coordinates, as the model is: those of its files, the CRS's, minus the shift."""
        from tiegraph.scene.cloudfile import read_cloud  # laspy, a tenth of a second

        return read_cloud(self._needed("cloud.laz", "cloud"))

    def depth(self, image: str) -> DepthMap:
        """The depth map of an image, by the name of its file below the images."""
        return results.load_depth(self._needed(f"depth/{image}.npz", "dense"))

    def accuracy(self) -> tuple[Accuracy, dict[str, Metric]]:
        """What is predicted and measured of the world, the shape and the cloud, and all figures of merit by name."""
        return results.read_metrics(self._needed("metrics.json", "evaluate"))

    def products(self) -> dict[str, dict[str, Path]]:
        """The files of each surface, by the names of the surface (map, elevation1, ...) and of the file without its
        ending (dsm, sigma, ortho, dtm, contours, ...); pictures, which have the names of rasters, are left out."""
        folder = self._needed("products", "products")
        rasters = (".tif", ".gpkg", ".geojson")
        there = {p.name: sorted(p.iterdir()) for p in sorted(folder.iterdir()) if (p / "frame.json").exists()}
        return {name: {p.stem: p for p in files if p.suffix in rasters} for name, files in there.items()}

    def mesh(self) -> dict[str, Path]:
        """The files of the textured mesh by their endings: glb, obj, ply; ``json`` leads back to the CRS."""
        self._needed("mesh/mesh.glb", "mesh")
        names = ("mesh.glb", "mesh.obj", "mesh.ply", "offset.json")
        return {name.rpartition(".")[2]: self._needed(f"mesh/{name}", "mesh") for name in names}

    def report(self) -> Path:
        """The HTML report."""
        return self._needed("report.html", "report")

    def receipt(self, stage: str) -> dict:
        """What a stage says of itself: counts, dropped items with reasons, notes, times, settings, versions."""
        return self.as_run().receipts.read(stage)

    def _pairs(self, name: str, stage: str) -> Pairs:
        with np.load(self._needed(name, stage)) as data:
            return Pairs.from_npz(dict(data))

    def _needed(self, name: str, stage: str) -> Path:
        path = self.folder / name
        if not path.exists():
            raise InputError(f"{path} is not there yet: run(until={stage!r}) makes it")
        return path


def open_project(
    images: str | Path | None = None,
    out: str | Path | None = None,
    *,
    preset: str | None = None,
    pool: str = "local",
    settings: dict[str, dict[str, Any]] | Settings | None = None,
    unset: Sequence[str] = (),
    **inputs: str | Path | float | None,
) -> Project:
    """A project over a folder of images, or the one that a run folder remembers (``out``, or in place of ``images``).

    ``inputs``: rig (file or preset), camera (words or file), gnss, trajectory, start, times, gcp, marks, tolerance (m).
    Images and inputs may be URLs of a store (``s3://bucket/survey``): ``Project.fetch`` copies them beside ``out``.
    ``settings``: {section: {name: value}} on top of the preset and of ``out``/tiegraph.toml, or complete Settings.
    ``unset``: inputs and settings ("gnss", "masks.folder") that ``out``/tiegraph.toml no longer holds. ``out`` defaults
    to ``<images>_tiegraph``, for a URL in the present folder.
    Raises InputError and SettingsError.
    """
    known = (*_NAMED, *_PATHS, *SETTING_OF)
    unknown = set(inputs) - set(known)
    if unknown:
        raise SettingsError(f"unknown input {sorted(unknown)[0]!r}: known are {', '.join(known)}")
    _check_texts({"images": images, "out": out, **inputs})
    if out is None and images is not None and names_run(str(images)):
        images, out = None, images
    folder = _folder(images, out)
    stores = {url: place_of(url, folder.parent) for given in (images, *inputs.values()) if (url := url_of(given))}
    images, inputs = stores.get(url_of(images), images), {n: stores.get(url_of(v), v) for n, v in inputs.items()}
    beside = {n: value for n in SETTING_OF if (value := inputs.pop(n, None)) is not None}
    check_format(folder)
    stored = project_settings.without(project_settings.read_file(folder / SETTINGS), unset)
    run = {**stored.pop("run", {}), **{k: str(v) for k, v in inputs.items() if v is not None}}
    if images is None and "images" not in run:
        raise InputError(f"{folder} is not a run folder (no {SETTINGS}): start with `tiegraph run IMAGES`")
    # Absolute, so that the run folder can be used from anywhere.
    found = real_path(images if images is not None else run["images"])
    run.update({n: str(real_path(run[n])) for n in _NAMED if n in run and (names_file(run[n]) or names_run(run[n]))})
    name = preset or run.get("preset", "default")
    if isinstance(settings, Settings):
        complete = settings
    else:
        where = str(folder / SETTINGS) if stored else "settings"
        complete = project_settings.merged(project_settings.preset(name), stored, settings or {}, where=where)
    for input_name, value in beside.items():
        section, key = SETTING_OF[input_name]
        own = {key: value if isinstance(value, int | float) else real_path(value)}
        values = {**getattr(complete, section).model_dump(), **own}
        changed = project_settings.merged({section: values}, where=f"--{input_name}")
        complete = complete.model_copy(update={section: getattr(changed, section)})
    paths = {n: real_path(run[n]) if n in run else None for n in _PATHS}
    if run.get("trajectory") == str(FOLLOW):
        paths["trajectory"] = FOLLOW
    _check_texts({"images": found, **paths})
    given = Inputs(found, run.get("rig"), camera=run.get("camera"), **paths)
    return Project(folder, given, complete, preset=name, pool=pool, stores=stores)


def _check_texts(given: dict[str, Any]) -> None:
    for name, value in given.items():
        check_text("" if value is None else value, name)


def _folder(images: str | Path | None, out: str | Path | None) -> Path:
    if out is not None and (url := url_of(out)):
        raise InputError(
            f"-o {url}: a run works in a folder of this machine; `tiegraph export OUT {url} --to results` then copies "
            "its results there"
        )
    if out is not None:
        return Path(out).absolute()
    if images is None:
        raise InputError("give the folder of the images, or a run folder by out=")
    if url := url_of(images):
        return Path(f"{place_of(url, Path()).name}_tiegraph").absolute()
    path = source_of(real_path(images))
    return path.with_name(path.name + "_tiegraph")


def _differing(values: dict, mine: dict, theirs: dict) -> dict[str, Any]:
    """The values of what stands otherwise in two tables: what a project says beyond its preset. A value set back to the
    default against the preset is said too."""
    out: dict[str, Any] = {}
    for name in sorted(n for n in {*mine, *theirs} if mine.get(n, ...) != theirs.get(n, ...)):
        value = values[name]
        if isinstance(value, dict):
            value = _differing(value, mine.get(name, {}), theirs.get(name, {})) or None
        if value is not None:
            out[name] = value
    return out
