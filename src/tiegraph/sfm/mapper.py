"""From the verified matches to models: COLMAP's mappers with the rig, in child processes, and an account of all
images."""

import shutil
from dataclasses import dataclass, replace
from pathlib import Path

import numpy as np
import pycolmap

from tiegraph.child import run_in_child
from tiegraph.errors import ChildDied, ReconstructionError
from tiegraph.scene.colmapmodel import Registration, image_poses, read_model, registration
from tiegraph.scene.graph import WeaklyTied
from tiegraph.scene.rig import Rig
from tiegraph.scene.scene import Scene
from tiegraph.scene.tuning import RegisteredTuning
from tiegraph.scene.tuning import Tuning as SceneTuning
from tiegraph.sfm.consistency import MatchSource
from tiegraph.sfm.covariance import PositionSigma
from tiegraph.sfm.database import ViewGraph
from tiegraph.sfm.finish import FinishResult, finish_model
from tiegraph.sfm.mapping import (
    RUN_COLUMNS,
    SCRATCH,
    Account,
    Job,
    Outcome,
    RigsUsed,
    Source,
    believed_cameras,
    map_images,
    ran_off,
)
from tiegraph.sfm.model import registration_tables
from tiegraph.sfm.registrationreport import (
    camera_notes,
    camera_table,
    few_points,
    models_table,
    no_model_text,
    rig_doubts,
    unregistered,
    weakly_constrained,
)
from tiegraph.sfm.rig.rig import DerivedRig, derive_rig, rig_modes, rig_table
from tiegraph.sfm.rig.support import ties_of, unsupported_sensors
from tiegraph.sfm.rigcheck import FinishRequest, Held
from tiegraph.sfm.settings import SparseSettings
from tiegraph.sfm.shape import Shape
from tiegraph.sfm.ties import TEST_COLUMNS, Joining, TieTest, moved
from tiegraph.sfm.tuning import MappingTuning, Tuning
from tiegraph.sfm.tuning.rig import DeriveTuning
from tiegraph.sfm.turning import no_base
from tiegraph.sfm.verified import read_verified

__all__ = ["Model", "Source", "SparseResult", "reconstruct"]


@dataclass(frozen=True)
class Model:
    """One model on disk: its images and its quality as the reconstruction itself reports it."""

    folder: Path
    found: Registration  # its images: which are registered, which only their rig places
    frames: int
    points: int
    reprojection_px: float
    track_length: float

    @property
    def images(self) -> np.ndarray:
        """Scene indices of the images that have a pose."""
        return np.flatnonzero(self.found.placed)

    @property
    def registered(self) -> int:
        """Number of images that see its points and agree with them."""
        return int(self.found.registered.sum())


@dataclass(frozen=True)
class Remarks:
    """The remarks on the models."""

    dropped: tuple[tuple[str, str], ...]  # image name, why it is not in the first model
    notes: tuple[str, ...]
    contradictions: tuple[str, ...]  # between given values and the images


@dataclass(frozen=True)
class SparseResult:
    """The models, most images first, and an account of everything that is not in them."""

    models: tuple[Model, ...]
    mapper: str
    rig: str  # absent, fixed, refined, derived (or several joined by +)
    scene: Scene  # as given, with derived extrinsics filled in
    components: tuple[int, ...]  # images of each connected part of the view graph
    remarks: Remarks
    tables: dict[str, dict]
    counts: dict[str, float]
    sigma: PositionSigma | None  # of the first model's frames, model units
    shape: Shape | None  # the same as modes by which the model may be bent

    def load(self, model: int = 0) -> pycolmap.Reconstruction:
        """Read a model from disk."""
        return read_model(self.models[model].folder)


def reconstruct(
    source: Source,
    out: Path,
    scene: Scene,
    settings: SparseSettings,
    tuning: Tuning,
    shared: SceneTuning,
    log: Path,
) -> SparseResult:
    """Map the images of a database with verified matches; models go to ``out/0``, ``out/1``, ... by size.

    Cameras with hardly any matches are placed by their rig. The extrinsics of unknown rigs are derived from a model
    made without them. Then all images are mapped, starting from separately mapped sections if requested, and the
    models are adjusted and checked. The database is read, never changed. Raises ReconstructionError, with the counts
    and remedies, when no model can be made; SettingsError for a fixed rig without extrinsics.
    """
    job = Job(
        rigs=RigsUsed.known(scene, rig_modes(scene, settings.rig)),
        graph=_view_graph(source, scene, settings, tuning.mapping),
        source=source,
        out=out,
        scene=scene,
        settings=settings,
        tuning=tuning,
        shared=shared,
        log=log,
        account=Account(),
    )
    _remove_models(out)
    try:
        job = _without_unsupported(job)
        job, outcome = _with_unknown_rigs(job)
        if outcome is None:
            job = start_from_sections(job)
            outcome = map_images(job)
        finished = _finish(job, outcome)
        return _account(job, outcome, finished)
    finally:
        shutil.rmtree(out / SCRATCH, ignore_errors=True)


def _view_graph(source: Source, scene: Scene, settings: SparseSettings, tuning: MappingTuning) -> ViewGraph:
    graph = ViewGraph(source.database, scene, settings.min_matches, source.refused)
    if len(graph.pairs) == 0:
        raise ReconstructionError(no_model_text(scene, graph, "no pair of images has enough verified matches"))
    if why := no_base(source.database, graph.pairs, scene, tuning):
        raise ReconstructionError(f"no model: {why}")
    return graph


def _remove_models(out: Path) -> None:
    """Make the folder and remove the models of an earlier run."""
    out.mkdir(parents=True, exist_ok=True)
    for old in (p for p in out.iterdir() if p.is_dir() and p.name.isdigit()):
        shutil.rmtree(old)


def _without_unsupported(job: Job) -> Job:
    """The job without the ties of sensors that have too few of them: their rig places them, if other sensors can be
    mapped."""
    scene, graph, source = job.scene, job.graph, job.source
    alone = unsupported_sensors(scene, graph, job.rigs.modes, job.tuning.rig.support)
    without = (*source.refused, *ties_of(scene, graph, alone))
    if not alone or len(without) - len(source.refused) >= len(graph.pairs):
        return job
    names = ", ".join(scene.all_sensors[k].name for k in alone)
    job.account.notes.append(
        f"{names} has too few ties: it is placed by the rig as given, and its own ties are not used"
    )
    graph = ViewGraph(source.database, scene, job.settings.min_matches, without)
    rigs = replace(job.rigs, unsupported=alone)
    return replace(job, source=replace(source, refused=without), graph=graph, rigs=rigs)


def _with_unknown_rigs(job: Job) -> tuple[Job, Outcome | None]:
    """The job with the extrinsics of unknown rigs, derived from models made without these rigs. Where none could be
    derived, also these models (else None), because nothing needs to be mapped again."""
    unknown = [k for k, mode in job.rigs.modes.items() if mode == "derived"]
    if not unknown:
        return job, None
    outcome = map_images(job, "without the unknown rig")
    derived = _derive(job, unknown, outcome)
    if not derived:
        return job, outcome
    given = {**job.rigs.given, **derived}
    scene = job.scene.with_(rigs=tuple(given.get(k, r) for k, r in enumerate(job.scene.rigs)))
    return replace(job, scene=scene, rigs=replace(job.rigs, given=given)), None


def _derive(job: Job, unknown: list[int], outcome: Outcome) -> dict[int, Rig]:
    models = [read_model(folder) for folder in outcome.folders]
    rigs = {}
    for index in unknown:
        result = derive_rig(job.scene, index, models, job.tuning.rig.derive)
        job.account.notes.append(_derived_note(job.scene.rigs[index], result, job.tuning.rig.derive))
        if result.rig is not None:
            rigs[index] = result.rig
    return rigs


def _derived_note(rig: Rig, result: DerivedRig, tuning: DeriveTuning) -> str:
    lost = "; ".join(f"{name}: {why}" for name, why in result.left_out)
    if result.rig is None:
        return (
            f"rig {rig.name}: its extrinsics could not be determined; the images were mapped without the rig ({lost})"
        )
    held = [s for s in result.scatter if s.rigid(tuning)]
    worst = max(held, key=lambda s: s.scatter_deg)
    return (
        f"rig {rig.name}: extrinsics of {len(held) + 1} of {len(rig.sensors)} cameras found from a model without rig "
        f"and then adjusted; largest scatter over frames {worst.scatter_deg:.2f} deg ({worst.sensor}, {worst.frames} "
        f"frames)" + (f"; left out: {lost}" if lost else "")
    )


def _finish(job: Job, outcome: Outcome) -> FinishResult:
    """Adjust, check, colour and write the models to their folders; returns the findings on the first."""
    out, modes = [], job.rigs.used()
    plain = job.source.rough or not job.tuning.adjust.iterations
    held = Held(
        rigs=() if plain else tuple(modes),
        fixed=tuple(k for k, mode in modes.items() if mode == "fixed"),
        soft=tuple(k for k, mode in modes.items() if mode == "soft"),
        ordered=tuple(modes) if job.settings.rig == "fixed" else (),
        unsupported=job.rigs.unsupported,
        cameras=believed_cameras(job.scene, job.settings),
        lenses_ordered=job.settings.refine_intrinsics == "no",
        readout_ms=job.settings.readout_ms,
    )
    matched = MatchSource(job.source.database, job.source.refused)
    for number, folder in enumerate(outcome.folders):
        request = FinishRequest(
            folder=folder,
            target=job.out / str(number),
            images=job.source.images,
            scene=job.scene.to_json(),
            tuning=job.tuning,
            held=held,
            matched=None if number or plain else matched,
            covariance_frames=0 if number else job.settings.covariance_frames,
            rough=plain,
        )
        out.append(_finished(request, job.log))
    job.account.notes.extend(out[0].notes)
    return out[0]


def _finished(request: FinishRequest, log: Path) -> FinishResult:
    """Finish one model; if that ends its process, keep the model as the mapper left it and say what is missing."""
    try:
        return run_in_child(finish_model, request, log=log, task="final adjustment")
    except ChildDied as error:
        plain = replace(request, matched=None, images=None, covariance_frames=0, rough=True)
        found: FinishResult = run_in_child(finish_model, plain, log=log, task="final adjustment")
        died = str(error).splitlines()[0]
        found.contradictions.append(
            f"the model stays as the mapper made it, without final adjustment, checks, colours and sigmas: {died}"
        )
        return found


def _account(job: Job, outcome: Outcome, finished: FinishResult) -> SparseResult:
    """The account of the images in the models and of all others."""
    scene, tuning = job.scene, job.tuning
    folders = [job.out / str(k) for k in range(len(outcome.folders))]
    models = [_model(read_model(f), f, scene, job.shared.registered) for f in folders]
    first, main = models[0], read_model(folders[0])
    doubts: list[str] = []
    weak: tuple[WeaklyTied, ...] = ()
    weakly: list[str] = []
    if not job.source.rough:
        held = [k for k, mode in rig_modes(scene, job.settings.rig).items() if mode in ("fixed", "soft")]
        doubts = rig_doubts(main, scene, held, first.registered, job.graph.components[0], tuning)
        if off := ran_off(main, scene, tuning.mapping.other_focal):
            doubts.append(
                f"the images make {off}: one of the two is wrong. Images taken straight down over flat ground hardly "
                "determine the focal length; if the given one is right, heights above the ground are wrong by the "
                "same factor. Check heights with control points, or give a calibration (--camera) and set "
                "sparse.refine_intrinsics = no"
            )
        weak = few_points(main, scene, first.found, tuning.registration)
        weakly = weakly_constrained(scene, job.graph, first.found, weak, tuning.registration)
    return SparseResult(
        models=tuple(models),
        mapper=outcome.mapper,
        rig=job.rigs.text(),
        scene=scene,
        components=tuple(job.graph.components),
        remarks=Remarks(
            dropped=tuple(unregistered(scene, job.graph, [m.images for m in models], dict(finished.dropped))),
            notes=(*job.account.notes, *weakly, *camera_notes(main, scene, tuning)),
            contradictions=(*job.account.contradictions, *finished.contradictions, *doubts),
        ),
        tables={
            "models": models_table(models),
            "runs": {"columns": RUN_COLUMNS, "rows": job.account.runs},
            **registration_tables(scene, first.found),
            "cameras": camera_table(main, scene),
            "rig": rig_table(scene, main),
            **finished.tables,
            **job.account.tables,
        },
        counts=_counts(job, models, sum(len(group.frames) for group in weak)) | finished.counts,
        sigma=finished.sigma,
        shape=finished.shape,
    )


def _counts(job: Job, models: list[Model], on_few_points: int) -> dict[str, float]:
    first = models[0]
    return {
        "images": len(job.scene),
        "registered": first.registered,
        "placed_by_rig": len(first.images) - first.registered,
        "frames": first.frames,
        "models": len(models),
        "components": len(job.graph.components),
        "points": first.points,
        "on_few_points": on_few_points,
        "pairs_verified": len(job.graph.pairs),
        "reprojection_px": round(first.reprojection_px, 4),
        "track_length": round(first.track_length, 3),
    }


def _model(reconstruction: pycolmap.Reconstruction, folder: Path, scene: Scene, tuning: RegisteredTuning) -> Model:
    return Model(
        folder=folder,
        found=registration(reconstruction, scene, tuning),
        frames=reconstruction.num_reg_frames(),
        points=reconstruction.num_points3D(),
        reprojection_px=float(reconstruction.compute_mean_reprojection_error()),
        track_length=float(reconstruction.compute_mean_track_length()),
    )


COLUMNS = ["section", "images", *TEST_COLUMNS, "joined"]


def start_from_sections(job: Job) -> Job:
    """The job, starting from the poses of its sections if these are to be mapped separately and joined (paper 001).

    The pairs of images between sections are not used while these are mapped. Afterwards they join the models
    (``ties``), which shows how well the borders hold, and the whole survey starts from the joined poses with all
    pairs.
    """
    scene, source = job.scene, job.source
    if not source.apart:
        return job
    refused = tuple(sorted({*source.refused, *source.apart}))
    graph = ViewGraph(source.database, scene, job.settings.min_matches, refused)
    account = Account(runs=job.account.runs)  # no remark is needed where a section has no pair with another
    alone = replace(job, source=replace(source, refused=refused, apart=()), graph=graph, account=account)
    models = [read_model(folder) for folder in map_images(alone).folders]
    verified = read_verified(source.database, scene, source.refused)
    joining = Joining(scene, verified, job.tuning.placement, models, {0: models[0]})
    while (found := joining.strongest([k for k in range(len(models)) if k not in joining.world])) is not None:
        number, fit, _ = found
        joining.add(number, moved(models[number], fit.first_from_second))
    poses = np.full((len(scene), 4, 4), np.nan)
    for number in sorted(joining.world, reverse=True):  # the larger model decides where two have an image
        own = image_poses(joining.world[number], scene)
        there = np.isfinite(own).all(axis=(1, 2))
        poses[there] = own[there]
    rows = [_row(k, len(m.reg_image_ids()), joining.tests.get(k), k in joining.world) for k, m in enumerate(models)]
    job.account.tables["sections mapped separately"] = {"columns": COLUMNS, "rows": rows}
    job.account.notes.append(
        f"{len(models)} sections were mapped separately and {len(joining.world)} of them joined by the matches "
        "between them; the whole survey starts from these poses"
    )
    return replace(job, source=replace(source, apart=(), preview=poses))


def _row(number: int, images: int, test: TieTest | None, joined: bool) -> list:
    told = [None] * len(TEST_COLUMNS) if test is None else test.cells()
    return [number, images, *told, "yes" if joined else "no"]
