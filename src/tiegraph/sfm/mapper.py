"""From the verified matches to models: COLMAP's mappers with the rig, in child processes, and an account of all
images."""

import shutil
from dataclasses import dataclass, replace
from functools import cache
from pathlib import Path

import numpy as np
import pycolmap

from tiegraph.child import run_in_child
from tiegraph.errors import ChildDied, ReconstructionError
from tiegraph.scene.colmapmodel import Registration, image_poses, read_model, registration
from tiegraph.scene.graph import WeaklyTied
from tiegraph.scene.scene import Scene
from tiegraph.scene.tuning import RegisteredTuning
from tiegraph.scene.tuning import Tuning as SceneTuning
from tiegraph.sfm.covariance import PositionSigma
from tiegraph.sfm.finish import FinishResult, finish_model
from tiegraph.sfm.focal import with_focal_lengths
from tiegraph.sfm.mapping import (
    RUN_COLUMNS,
    SCRATCH,
    Account,
    Job,
    Outcome,
    Source,
    believed_cameras,
    map_images,
    others_told,
    run_once,
    share_of_matches,
    start_from_sections,
    with_others,
)
from tiegraph.sfm.model import Findings
from tiegraph.sfm.registrationreport import (
    camera_notes,
    few_points,
    models_table,
    no_base,
    no_model_text,
    ran_off,
    rig_doubts,
    unregistered,
    weakly_constrained,
)
from tiegraph.sfm.rig.rig import derive_rig, rig_modes, ties_of, unsupported_sensors
from tiegraph.sfm.rigcheck import FinishRequest, Held
from tiegraph.sfm.settings import SparseSettings
from tiegraph.sfm.shape import Shape
from tiegraph.sfm.tuning import MappingTuning, Tuning
from tiegraph.sfm.verified import VerifiedMatches, ViewGraph

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
class SparseResult:
    """The models, most images first, and an account of everything that is not in them."""

    models: tuple[Model, ...]
    mapper: str
    rig: str  # absent, fixed, refined, derived (or several joined by +)
    scene: Scene  # as given, with derived extrinsics filled in
    components: tuple[int, ...]  # images of each connected part of the view graph
    remarks: Findings  # why images are not in the first model, notes, contradictions
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
    modes, account = rig_modes(scene, settings.rig), Account()
    graph = _view_graph(source, scene, settings, tuning.mapping)
    if source.preview is None:  # else the rough model has determined them
        scene, account.notes = with_focal_lengths(scene, source.database, source.refused, tuning.focal)
    job = Job(
        modes={k: mode for k, mode in modes.items() if mode != "derived"},
        graph=graph,
        source=source,
        out=out,
        scene=scene,
        settings=settings,
        tuning=tuning,
        shared=shared,
        log=log,
        account=account,
    )
    out.mkdir(parents=True, exist_ok=True)
    for old in (p for p in out.iterdir() if p.is_dir() and p.name.isdigit()):  # models of an earlier run
        shutil.rmtree(old)
    try:
        job = _without_unsupported(job)
        job, outcome = _with_unknown_rigs(job, [k for k, mode in modes.items() if mode == "derived"])
        account.notes += others_told(job, outcome)
        return _account(job, outcome, _finish(job, outcome))
    finally:
        shutil.rmtree(out / SCRATCH, ignore_errors=True)


def _view_graph(source: Source, scene: Scene, settings: SparseSettings, tuning: MappingTuning) -> ViewGraph:
    graph = ViewGraph(source.database, scene, settings.min_matches, source.refused)
    if len(graph.pairs) == 0:
        raise ReconstructionError(no_model_text(scene, graph, "no pair of images has enough verified matches"))
    if why := no_base(source.database, graph.pairs, scene, tuning):
        raise ReconstructionError(f"no model: {why}")
    return graph


def _without_unsupported(job: Job) -> Job:
    """The job without the ties of sensors that have too few of them: their rig places them, if other sensors can be
    mapped."""
    scene, graph, source = job.scene, job.graph, job.source
    alone = unsupported_sensors(scene, graph, job.modes, job.tuning.rig.support)
    without = (*source.refused, *ties_of(scene, graph, alone))
    if not alone or len(without) - len(source.refused) >= len(graph.pairs):
        return job
    names = ", ".join(scene.all_sensors[k].name for k in alone)
    job.account.notes.append(
        f"{names} has too few ties: it is placed by the rig as given, and its own ties are not used"
    )
    graph = ViewGraph(source.database, scene, job.settings.min_matches, without)
    return replace(job, source=replace(source, refused=without, unsupported=alone), graph=graph)


def _with_unknown_rigs(job: Job, unknown: list[int]) -> tuple[Job, Outcome]:
    """The job with the extrinsics of unknown rigs, derived from the coarse model or from models made without these
    rigs, and its models. Where none could be derived, or the models made with them explain clearly fewer matches, the
    job as it was and the models without. A camera that a first model does not show together with others may be mounted
    by the model made with the others."""
    if not unknown:
        job = start_from_sections(job)
        return job, map_images(job)
    said, notes = dict.fromkeys(unknown, ""), job.account.notes
    job, started = _with_rigs_of_the_start(job, said)
    outcome = started or map_images(job, "without the unknown rig")
    without = None if started else outcome
    while (known := _derived(job, [image_poses(read_model(f), job.scene) for f in outcome.folders], said)) is not None:
        least = job.tuning.mapping.clearly_fewer * share_of_matches(job, outcome)
        try:
            made = _mapped_with_rigs(known, least)
        except (ReconstructionError, ChildDied) as error:
            first = str(error).splitlines()[0]
            notes.append(f"there is no model with the rig that was found, it is not used: {first}")
            break
        if (share := share_of_matches(known, made)) < least:
            notes.append(
                f"with the rig that was found the model explains {100 * share:.0f} % of the matches, without it "
                f"{100 * share_of_matches(job, outcome):.0f} %: the rig is not used"
            )
            break
        job, outcome = known, made
    notes += said.values()
    return job, with_others(job, outcome) if outcome is without else outcome


def _mapped_with_rigs(known: Job, least: float) -> Outcome:
    """Models with derived rigs: from the poses that these were derived from, if they explain the ``least`` share of the
    matches then; else, and where those poses are torn, mapped anew."""
    known = start_from_sections(known)
    if known.source.preview is not None and known.settings.mapper == "auto":
        made = run_once(known, "preview", "with the rig that was found")
        if made.folders and share_of_matches(known, made) >= least:
            return with_others(known, made)
    return map_images(replace(known, source=replace(known.source, preview=None)))


def _with_rigs_of_the_start(job: Job, said: dict[int, str]) -> tuple[Job, Outcome | None]:
    """The job with the extrinsics of unknown rigs that the coarse model tells, and its models from there; the job as it
    was, and None, if it tells none, or if that model fails its acceptance test."""
    poses, told = job.source.preview, dict.fromkeys(said, "")
    if poses is None or job.source.apart or job.settings.mapper != "auto":
        return job, None
    known = _derived(job, [poses], told)
    outcome = None if known is None else run_once(known, "preview", "with the rig of the coarse model")
    if known is None or outcome is None or outcome.refused or not outcome.folders:
        return job, None
    said |= told
    return known, with_others(known, outcome)


def _derived(job: Job, models: list[np.ndarray], said: dict[int, str]) -> Job | None:
    """The job with more extrinsics of rigs, which models tell by the poses (N, 4, 4) of their images; None = no more.
    It starts from the poses of the first model, unless that is torn, or a rough one is wanted, which a mapper makes
    faster. ``said``: of each rig that was unknown the remark on them, which is brought up to date."""
    rigs, whole = list(job.scene.rigs), not job.source.rough

    @cache
    def matched() -> VerifiedMatches:
        return job.matches().read(job.scene)

    for index in said:
        rig, remark, torn = derive_rig(job.scene, index, models, matched, job.tuning.rig.derive)
        if not said[index] or (rig is not None and rig.mounted > rigs[index].mounted):
            rigs[index], said[index], whole = rig or rigs[index], remark, whole and not torn
    new = {k: "derived" for k in said if rigs[k] is not job.scene.rigs[k]}
    source = replace(job.source, preview=models[0] if whole else None)
    known = replace(job, scene=job.scene.with_(rigs=tuple(rigs)), modes={**job.modes, **new}, source=source)
    return known if new else None


def _finish(job: Job, outcome: Outcome) -> FinishResult:
    """Adjust, check, colour and write the models to their folders; returns the findings on the first."""
    out, settings = [], job.settings
    plain = job.source.rough or not job.tuning.adjust.iterations
    held = Held(
        modes=job.modes,
        ordered=settings.rig == "fixed",
        unsupported=job.source.unsupported,
        cameras=believed_cameras(job.scene, settings),
        lenses_ordered=settings.refine_intrinsics == "no",
        readout_ms=settings.readout_ms,
    )
    for number, folder in enumerate(outcome.folders):
        request = FinishRequest(
            folder=folder,
            target=job.out / str(number),
            images=job.source.images,
            scene=job.scene,
            tuning=job.tuning,
            held=held,
            matched=None if number or plain else job.matches(),
            covariance_frames=0 if number else settings.covariance_frames,
            rough=plain,
        )
        out.append(_finished(request, job.log))
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
    if not first.registered:
        for folder in folders:
            shutil.rmtree(folder)
        why = _nothing_sure(first, finished, job.shared.registered)
        raise ReconstructionError(no_model_text(scene, job.graph, why))
    doubts: list[str] = []
    weak: tuple[WeaklyTied, ...] = ()
    weakly: list[str] = []
    if not job.source.rough:
        held = [k for k, mode in job.modes.items() if mode in ("fixed", "soft")]
        doubts = rig_doubts(main, scene, held, first.registered, job.graph.components[0], tuning)
        if off := ran_off(main, scene, tuning.mapping.other_focal):
            doubts.append(
                f"{off}, one of the two is wrong. Images taken straight down over flat ground hardly "
                "determine the focal length; if the given one is right, heights above the ground are wrong by the "
                "same factor. Check heights with control points, or give a calibration (--camera) and set "
                "sparse.refine_intrinsics = no"
            )
        weak = few_points(main, scene, first.found, tuning.adjust.enough_seen)
        weakly = weakly_constrained(scene, job.graph, first.found, weak, tuning.adjust.enough_seen)
    return SparseResult(
        models=tuple(models),
        mapper=outcome.mapper,
        rig=job.rigs_text(),
        scene=scene,
        components=tuple(job.graph.components),
        remarks=Findings(
            dropped=unregistered(scene, job.graph, [m.images for m in models], dict(finished.dropped)),
            notes=[*job.account.notes, *finished.notes, *weakly, *camera_notes(main, scene, tuning)],
            contradictions=[*job.account.contradictions, *finished.contradictions, *doubts],
        ),
        tables={
            "models": models_table(models),
            "runs": {"columns": RUN_COLUMNS, "rows": job.account.runs},
            **finished.tables,
            **job.account.tables,
        },
        counts=_counts(job, models, sum(len(group.frames) for group in weak)) | finished.counts,
        sigma=finished.sigma,
        shape=finished.shape,
    )


def _nothing_sure(model: Model, finished: FinishResult, tuning: RegisteredTuning) -> str:
    explained = finished.counts.get("matches_explained_percent")
    agree = "" if explained is None else f", and {explained:.0f} % of the verified matches agree with it"
    return (
        f"the images were mapped, but none sees {tuning.min_points} points of the result ({model.points} points in "
        f"all{agree}): the matches contradict each other"
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
