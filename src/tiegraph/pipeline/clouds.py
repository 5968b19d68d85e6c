"""Glue of comparisons of clouds: two files; two surveys of one place (`compare --epochs`); two passes of one run
(`compare --passes`), each fused of the depth maps of its own images.

The stage ``cloud`` compares some depth maps for the report. To keep that cheap (5.7 CPU s on the example survey, 37 and
36 depth maps), the passes are not filtered, which M3C2 does not need (mean places in cylinders are hardly affected by
3 % of strays), their voxels are those of the cloud, and 5000 core points are enough. Half of the depth maps would leave
one of the example's sections without any.
"""

from collections.abc import Callable, Iterable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import asdict, dataclass
from functools import partial
from pathlib import Path
from typing import Any, Literal

import numpy as np

from tiegraph.cloud.fuse import FusionResult, Maps, fuse
from tiegraph.cloud.settings import CloudSettings
from tiegraph.errors import InputError, ReconstructionError
from tiegraph.evaluate.clouds import judge
from tiegraph.evaluate.clouds.m3c2 import Changes, Differences, Sigma, changes, cylinders_of, m3c2_tiled
from tiegraph.evaluate.clouds.nearest import Cameras, meeting
from tiegraph.evaluate.clouds.register import Registration, registered
from tiegraph.evaluate.clouds.tiles import tile_clouds
from tiegraph.evaluate.reference import to_world
from tiegraph.evaluate.tuning import Tuning
from tiegraph.geometry.geodesy import ENU, Origin
from tiegraph.geometry.transforms import PlacementError, centre
from tiegraph.pipeline.dense import depth_path, read_depth
from tiegraph.pipeline.evaluate import PASSES, measured, write_judgement
from tiegraph.pipeline.files import checked, load_model, placement_error, world_origin, world_unit
from tiegraph.project.folder import SETTINGS, check_format
from tiegraph.project.run import Run
from tiegraph.project.settings import read_settings
from tiegraph.project.stages import save_json, write_atomic
from tiegraph.scene.atomic import must_be_new, replacing, scratch_folder
from tiegraph.scene.cloudchunks import Points, PointSource, open_cloud, write_measured
from tiegraph.scene.cloudfile import shift_of
from tiegraph.scene.colmapmodel import matrix, model_centres
from tiegraph.scene.results import metrics_to_dict
from tiegraph.scene.scene import Scene
from tiegraph.text import command, csv_text


def evaluate_clouds(
    files: tuple[Path, Path], out: Path | None, question: judge.Question, tuning: Tuning
) -> dict[str, Any]:
    """Compare the first of two cloud files with the second; the content of metrics.json. ``out``: a folder for it, a
    map and clouds.

    Raises InputError for files that are no clouds or do not overlap, and for an existing folder.
    """
    for distance in question.distances_m:
        if not 0 < distance < np.inf:
            raise InputError(f"--distances-m {distance:g}: give metres above 0")
    refuse_coarse_alone(question.register, question.coarse, "--register rigid or --register similarity")
    own, truth = (open_cloud(path) for path in files)
    notes = [] if out is None else [f"written: {out}"]
    if own.crs and truth.crs and own.crs != truth.crs:
        notes.append(f"the reference was brought from {truth.crs} into {own.crs}; heights are taken as ellipsoidal")
    elif own.crs != truth.crs:
        notes.append(f"only one of both names a CRS ({own.crs or truth.crs}): they are compared without conversion")
    notes += [f"{cloud.name}: {cloud.note}" for cloud in (own, truth) if cloud.note and own.note != truth.note]
    with new_folder(out) as folder, scratch_folder(folder) as scratch:
        if own.crs and truth.crs and own.crs != truth.crs:
            frames = _place(truth.crs), _place(own.crs)
            truth = truth.moved(lambda xyz: to_world(xyz, *frames), own.crs)
        found = judge.judge_cloud(own, truth, scratch, question, tuning)
        result = metrics_to_dict(found.metrics(), found.tables(), [found.notes(), *notes])
        if folder is not None:
            write_judgement(found, folder, _place(own.crs))
            save_json(folder / "metrics.json", result)
    return result


def refuse_coarse_alone(register: str, coarse: bool, remedy: str) -> None:
    """Raise InputError for a coarse start without registration."""
    if coarse and register == "none":
        raise InputError(f"--coarse starts a registration: add {remedy}")


def _place(crs: str | None) -> Origin:
    """A world that is the CRS itself."""
    return Origin(lat_deg=0.0, lon_deg=0.0, height_m=0.0, crs=crs or ENU)


@contextmanager
def new_folder(out: Path | None) -> Iterator[Path | None]:
    """A folder that appears as a whole once all in it is made. Raises InputError if it exists before."""
    if out is None:
        yield None
        return
    must_be_new(out)
    with replacing(out) as folder:
        folder.mkdir()
        yield folder


@dataclass(frozen=True)
class _Epoch:
    """A run: its cloud in its own world, the place of that, and its accuracy."""

    folder: Path
    cloud: PointSource
    origin: Origin | None
    error: PlacementError | None


@dataclass(frozen=True)
class Pair:
    """Two clouds in one world, their common frame and its description; ``cameras`` are the first's."""

    first: PointSource
    second: PointSource
    cameras: Cameras
    origin: Origin | None
    held: str
    sigma: Sigma | None = None
    fitted: Registration | None = None


def compare_epochs(
    folders: tuple[Path, Path],
    out: Path,
    register: Literal["none", "rigid"] = "none",
    coarse: bool = False,
    depth_m: float | None = None,
) -> dict[str, Any]:
    """Compare the clouds of two runs; writes changes.json, changes.csv, changes.png and changes.laz into a new folder.

    The constants are those of the first run (``[tuning.evaluate]``). Raises InputError for runs without a cloud, or
    without a common world, for clouds that do not overlap, and for a coarse start without registration.
    """
    refuse_coarse_alone(register, coarse, "--register rigid")
    tuning = read_settings(folders[0] / SETTINGS).tuning.evaluate
    first, second = (_read(folder) for folder in folders)
    other = _in_world_of(first, second, register)
    centres = model_centres(load_model(first.folder / "sparse" / "world"))
    cameras = Cameras(centres, ("",) * len(centres))
    common: dict[str, Any] = {"first": first.cloud, "cameras": cameras, "origin": first.origin}
    if register == "none":
        held = "by the georeference of both surveys, with both their sigmas"
        pair = Pair(**common, second=other, held=held, sigma=_placed(first, second))
    else:
        with judge.told_of(other.name):
            fitted = registered(other, first.cloud, tuning.registration, False, coarse)
        moved, along = other.moved(fitted.fit), fitted.sigma_along
        held = "by ICP from a start by their shapes" if coarse else "by ICP"
        pair = Pair(**common, second=moved, held=held, sigma=along, fitted=fitted)
    return differences_of(pair, out, tuning, depth_m)


def differences_of(pair: Pair, out: Path, tuning: Tuning, depth_m: float | None) -> dict[str, Any]:
    """What changed from the first cloud to the second, written into a new folder.

    Raises InputError if they do not overlap, or the folder exists.
    """
    with new_folder(out) as folder, scratch_folder(folder) as scratch:
        assert folder is not None
        found = m3c2_of(pair, scratch, tuning, depth_m)
        changed = changes(found)
        result = _result(found, changed, pair)
        save_json(folder / "changes.json", result)
        table = changed.table(shift_of(pair.origin), len(changed.listed))
        write_atomic(folder / "changes.csv", csv_text(table["columns"], table["rows"]))
        write_atomic(folder / "changes.png", judge.difference_map(found, "second minus first", only_significant=True))
        write_measured([measured(found)], folder / "changes.laz", pair.origin, found.cylinders.cores_m)
    return result


def m3c2_of(
    pair: Pair, scratch: Path, tuning: Tuning, depth_m: float | None = None, most: int | None = None
) -> Differences:
    """The second cloud minus the first, at about ``most`` core points. Raises InputError if they do not overlap."""
    clouds = tile_clouds(pair.first, pair.second, scratch, tuning.cloud)
    with judge.told_of(pair.second.name):
        meeting(clouds)
        cylinders = cylinders_of(clouds, tuning.m3c2, depth_m)
    return m3c2_tiled(clouds, cylinders, tuning.m3c2, pair.cameras, pair.sigma, most)


def _read(folder: Path) -> _Epoch:
    check_format(folder)
    path = folder / "cloud.laz"
    if not path.exists():
        raise InputError(f"{folder}: it has no cloud.laz: run it to the stage cloud ({command('cloud', folder)})")
    if world_unit(folder) != "m":
        raise InputError(f"{folder}: its scale is unknown, so differences have no unit: give positions or a rig")
    origin = world_origin(folder)
    cloud = open_cloud(path).moved(lambda xyz: xyz - shift_of(origin))
    return _Epoch(folder=folder, cloud=cloud, origin=origin, error=placement_error(folder))


def _in_world_of(first: _Epoch, second: _Epoch, register: str) -> PointSource:
    for epoch in (first, second):
        if register == "none" and (epoch.origin is None or epoch.error is None):
            raise InputError(
                f"{epoch.folder}: its place on the Earth is not known, so it cannot be compared with another epoch: "
                "give positions or control points, or --register rigid to register the clouds to each other"
            )
    a, b = first.origin, second.origin
    if a is None or b is None or a == b:
        return second.cloud
    return second.cloud.moved(lambda xyz: to_world(xyz, b, a))


def _placed(first: _Epoch, second: _Epoch) -> Sigma:
    """Uncertainty of both georeferences along a normal; the errors of both surveys are taken as independent."""

    def sigma(xyz: np.ndarray, normal: np.ndarray) -> np.ndarray:
        assert first.error is not None and second.error is not None and first.origin and second.origin
        there = xyz if first.origin == second.origin else to_world(xyz, first.origin, second.origin)
        variance = first.error.sigma(xyz) ** 2 + second.error.sigma(there) ** 2
        return np.asarray(np.sqrt(np.sum(variance * normal**2, axis=1)))

    return sigma


def _result(found: Differences, changed: Changes, pair: Pair) -> dict[str, Any]:
    return {
        "differences": {k: float(f"{v:.6g}") for k, v in found.summary().items()},
        "areas_and_volumes": {k: float(f"{v:.6g}") for k, v in changed.totals().items()},
        "changes": changed.table(shift_of(pair.origin), 50),  # changes in the table, the largest first
        "cylinders": asdict(found.cylinders),
        "registration": None if pair.fitted is None else pair.fitted.table(),
        "crs": None if pair.origin is None else pair.origin.crs,
        "notes": [
            f"Second minus first along the first's normal, towards its cameras; compared {pair.held}. Significant: "
            "larger than the level of detection at 95 %, so about 5 % of unchanged points are too; a change is listed "
            "where enough significant points of one sign lie together. Differences beyond the cylinders are not found."
        ],
    }


Mapper = Callable[[Callable[[Any], Any], Sequence[Any]], Iterable[Any]]


@dataclass(frozen=True)
class _Pass:
    """A pass: its images that have depth maps, in the order of its path, and their positions (N, 3)."""

    name: str
    images: tuple[str, ...]
    centres: np.ndarray

    def where(self, rows: np.ndarray) -> "_Pass":
        return _Pass(self.name, tuple(self.images[k] for k in rows), self.centres[rows])


def compare_passes(run: Run, out: Path, depth_m: float | None = None) -> dict[str, Any]:
    """Compare the two passes with the most depth maps; writes what ``compare_epochs`` writes.

    Raises InputError for a run without depth maps of two passes.
    """
    scene = checked(run)
    found = _two_largest(run, scene)
    if len(found) < 2:
        raise InputError(
            f"{run.folder}: depth maps of {len(found)} passes, but two are needed: run it to the stage dense, with "
            "images of each pass in a folder of its own"
        )
    with scratch_folder() as scratch:
        pair = _pair(run, scene, found, scratch, run.settings.cloud, map)
        return differences_of(pair, out, run.settings.tuning.evaluate, depth_m)


def write_agreement(run: Run, scratch: Path, voxel_m: float, mapper: Mapper) -> judge.PassAgreement | None:
    """Compare depth maps of the two largest passes, all of few and else some near places along the path, and write
    agreement.json, differences.png and differences.laz into the folder ``passes``; None for one pass.

    ``voxel_m``: of the cloud of both.
    """
    scene, tuning = checked(run), run.settings.tuning.evaluate
    there = _two_largest(run, scene)
    if len(there) < 2:
        return None
    rows = judge.near_places(there[0].centres, there[1].centres, tuning.passes)
    used = [one.where(k) for one, k in zip(there, rows)]
    of: dict[str, Any] = {
        "passes": (used[0].name, used[1].name),
        "maps": (len(used[0].images), len(used[1].images)),
        "there": (len(there[0].images), len(there[1].images)),
    }
    folder = run.path(PASSES)
    try:
        pair = _pair(run, scene, used, scratch, run.settings.cloud.unfiltered(voxel_m), mapper)
        (scratch / "tiles").mkdir()
        found = m3c2_of(pair, scratch / "tiles", tuning, most=tuning.passes.cores)
    except (InputError, ReconstructionError) as error:
        agreement = judge.PassAgreement(**of, found={}, why_not=str(error))
    else:
        agreement = judge.PassAgreement(**of, found=judge.by_section(found, pair.cameras))
        title = f"{used[1].name} minus {used[0].name}"
        write_atomic(folder / "differences.png", judge.difference_map(found, title))
        write_measured([measured(found)], folder / "differences.laz", pair.origin, found.cylinders.cores_m)
    save_json(folder / "agreement.json", asdict(agreement))
    return agreement


def _two_largest(run: Run, scene: Scene) -> list[_Pass]:
    """The two passes with the most depth maps, the largest first; fewer if there are fewer."""
    model = load_model(run.path("sparse", "world"))
    centres = {i.name: centre(matrix(i.cam_from_world())) for i in model.images.values() if i.has_pose}
    by_pass: dict[int, list[str]] = {}
    for k in np.lexsort((np.arange(len(scene)), scene.sequence_index[scene.frame])):
        name, sequence = scene.names[k], int(scene.sequence[scene.frame[k]])
        if sequence >= 0 and name in centres and depth_path(run.folder, name).exists():
            by_pass.setdefault(sequence, []).append(name)
    found = [_Pass(scene.sequences[s], tuple(n), np.array([centres[k] for k in n])) for s, n in by_pass.items()]
    return sorted(found, key=lambda one: (-len(one.images), one.name))[:2]


def _pair(
    run: Run, scene: Scene, passes: Sequence[_Pass], scratch: Path, settings: CloudSettings, mapper: Mapper
) -> Pair:
    """The clouds of two passes, fused of their depth maps. Raises ReconstructionError for empty ones."""
    clouds: list[PointSource] = []
    maps = Maps(partial(read_depth, folder=run.folder))
    for one in passes:
        folder = scratch / str(len(clouds))
        folder.mkdir()
        tuning = run.settings.tuning.cloud
        fused = fuse(sorted(one.images), maps, folder, settings, tuning, world_origin(run.folder), mapper)
        clouds.append(PointSource(f"pass {one.name}", partial(_parts, fused)))
    sections = [int(scene.section[scene.frame[scene.image_index[n]]]) for n in passes[0].images]
    return Pair(
        first=clouds[0],
        second=clouds[1],
        cameras=Cameras(passes[0].centres, tuple(f"{s}" if s >= 0 else "(none)" for s in sections)),
        origin=world_origin(run.folder),
        held=f"in one model, pass {passes[1].name} minus pass {passes[0].name}: common errors of both do not show",
    )


def _parts(fused: FusionResult) -> Iterator[Points]:
    for part in fused.clouds():
        yield Points(part.xyz_m, part.sigma_m.astype(float))
