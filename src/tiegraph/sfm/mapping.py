"""The choice of the mapper, and what is tried when it loses images."""

from __future__ import annotations

import logging
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field, replace
from pathlib import Path

import numpy as np

from tiegraph.child import run_in_child
from tiegraph.errors import ChildDied, ReconstructionError
from tiegraph.scene.colmapmodel import image_poses, observations, read_model
from tiegraph.scene.rig import calibrated
from tiegraph.scene.scene import Scene
from tiegraph.scene.tuning import Tuning as SceneTuning
from tiegraph.sfm.model import Findings, frame_poses
from tiegraph.sfm.registrationreport import no_model_text
from tiegraph.sfm.rig.rig import held_by_mapper
from tiegraph.sfm.run import MappingResult, Method, Request, RigsUsed, run_mapper
from tiegraph.sfm.settings import SparseSettings
from tiegraph.sfm.start import length_of_path
from tiegraph.sfm.ties import TEST_COLUMNS, Joining, moved
from tiegraph.sfm.tuning import Tuning
from tiegraph.sfm.verified import MatchSource, ViewGraph, share_explained

SCRATCH = ".run"
"""Folder, beside the models, in which mappers work."""
RUN_COLUMNS = ["mapper", "rig", "priors", "", "models", "images seeing points", "points", "seconds"]
_OTHER = {"global": "incremental", "incremental": "global"}

_log = logging.getLogger(__name__)

Progress = Callable[[int, int], None]


@dataclass(frozen=True)
class Source:
    """The input of a mapping: a database with verified matches, the image folder (None: points get no colours), pairs
    (scene indices) not to use; ``rough``: poses good to 0.1 degrees suffice, which takes a fifth of the time."""

    database: Path
    images: Path | None
    refused: tuple[tuple[int, int], ...] = ()
    rough: bool = False
    apart: tuple[tuple[int, int], ...] = ()  # pairs between sections that are mapped apart first (``mapper``)
    unsupported: tuple[int, ...] = ()  # keys of sensors whose pairs are refused: the rig places them as given
    preview: np.ndarray | None = None  # (N, 4, 4) cam_from_world of the images in an accepted rough model
    on_progress: Progress = lambda registered, total: None  # counts images


@dataclass
class Account(Findings):
    """The runs of a reconstruction and the remarks on them."""

    runs: list[list] = field(default_factory=list)  # rows of ``RUN_COLUMNS``


@dataclass(frozen=True)
class Job:
    """The common input of all runs of one reconstruction."""

    source: Source
    out: Path
    scene: Scene
    settings: SparseSettings
    tuning: Tuning
    shared: SceneTuning
    log: Path
    graph: ViewGraph
    account: Account
    modes: Mapping[int, str]  # how each rig that the mappers are given is used (``rig_modes``)

    def rigs_text(self) -> str:
        """How the rigs are used, several ways joined by +."""
        return "+".join(sorted(set(self.modes.values()))) or "absent"

    def held_rigs(self) -> tuple[int, ...]:
        """The rigs whose extrinsics a mapper keeps."""
        return held_by_mapper(self.scene, self.modes, self.tuning.rig)

    def matches(self, only: np.ndarray | None = None) -> MatchSource:
        """The verified matches, of some images only if these are named."""
        source = self.source
        return MatchSource(source.database, source.refused, least=self.settings.min_matches, only=only)


@dataclass(frozen=True)
class Outcome:
    """The result of one run of a mapper."""

    mapper: str
    folders: list[Path]
    registered: int  # images of the first model that see its points
    refused: str = ""  # why there is no model, or why it is in doubt
    died: bool = False  # there is no model because its process ended


def choose_mapper(job: Job) -> str:
    """The mapper of the setting; for "auto", global with a rig or from 60 images, else incremental.

    Measured on canal_demo (120 images, nominal rig, 1500 verified pairs): trajectory error 0.09 m in 51 s global, 2.4 m
    in 589 s incremental, whose first adjustments of few images bend an uncertain rig. Below some tens of images the
    incremental mapper is as fast, and it can use position priors (PYCOLMAP section 4).
    """
    if job.settings.mapper in ("incremental", "global"):
        return job.settings.mapper
    large = len(job.scene) >= job.tuning.mapping.global_from_images
    return "global" if job.modes or large else "incremental"


def believed_cameras(scene: Scene, settings: SparseSettings) -> tuple[int, ...]:
    """COLMAP ids of the cameras whose intrinsics stay as given: under "auto" the calibrated ones.

    Free intrinsics diverge where a vehicle drives straight on: PandaSet's focal lengths by 8 %, KITTI's principal
    point by 30 px. A focal length from EXIF is no calibration: its principal point is simply the middle of the image.
    """
    if settings.refine_intrinsics == "yes":
        return ()
    out = []
    for first, rig in scene.keyed_rigs:
        for key, sensor in enumerate(rig.sensors, start=first + 1):
            camera = sensor.camera
            stated = camera is not None and rig.fixed and camera.has_prior_focal_length
            believed = (stated or (camera is not None and calibrated(camera))) and not sensor.camera_sigma_px
            if settings.refine_intrinsics == "no" or believed:
                out.append(key)
    return tuple(out)


def map_images(job: Job, label: str = "") -> Outcome:
    """Start from the coarse model unless a certain mapper is requested. Without a coarse model, or if the result
    fails the acceptance test, run a mapper. Where repeats are among the verified pairs, any right model contradicts
    them: of a start that fails for that and the mapper's model the one that explains more matches is kept.

    The start takes a half or a third of the CPU time of mapping from nothing and is as accurate (benchmarks/sfm).
    """
    asked, notes, doubted = job.settings.mapper == "auto" and not label, job.account.notes, None
    if asked and job.source.preview is not None:
        outcome = doubted = run_once(job, "preview", label)
        if not outcome.refused and outcome.folders:
            return with_others(job, outcome)
        notes.append(
            f"the model could not start from the coarse model: {outcome.refused}; the images were mapped without "
            "initial poses"
        )
    outcome = _as_long_as_its_rig(job, _mapped(job, label))
    if doubted is not None and doubted.folders:
        outcome = _clearer(job, outcome, doubted)
    return outcome if label else with_others(job, outcome)  # a step of several: its caller looks at the rest


def _as_long_as_its_rig(job: Job, outcome: Outcome) -> Outcome:
    """Map again from the poses found if the length of their path differs clearly from what a fixed rig gives.

    Cameras that look away from each other hardly determine this length; PandaSet's coarse model was 16 times too
    large.
    """
    held, tuning = job.held_rigs(), job.tuning
    if not held:
        return outcome
    poses = image_poses(read_model(outcome.folders[0]), job.scene)
    frames, verified = frame_poses(poses, job.scene), job.matches().read(job.scene)
    length = length_of_path(frames, job.scene, held, verified, tuning)
    most = tuning.start.scale.near
    if length is None or not np.isfinite(length[0]) or 1 / most < length[0] < most:
        return outcome
    job_from_poses = replace(job, source=replace(job.source, preview=poses))
    again = run_once(job_from_poses, "preview", "with the path scaled to the rig")
    fewer = again.registered < tuning.mapping.clearly_fewer * outcome.registered
    if fewer or (again.refused and again.registered <= outcome.registered):
        job.account.notes.append(
            f"the path of the model should be {length[0]:.3g} times as long to agree with its rig, by {length[1]}; "
            f"with that length fewer images could be placed ({again.registered} of {outcome.registered}), so it was "
            f"not changed; {again.refused}"
        )
        return outcome
    return again


def with_others(job: Job, outcome: Outcome) -> Outcome:
    """With models of the images that nothing ties to the first model, such as a second survey in the folder.

    A start from poses makes one model only; a mapper has made its other models already.
    """
    rest = np.flatnonzero(_untied(job, outcome) >= 0)
    if outcome.mapper != "preview" or len(rest) < job.tuning.adjust.min_images:
        return outcome
    other = run_once(job, choose_mapper(job), "of the images not tied to it", only=rest)
    both = sorted([*outcome.folders, *other.folders], key=lambda f: -read_model(f).num_reg_images())
    return replace(outcome, folders=both)


def _untied(job: Job, outcome: Outcome) -> np.ndarray:
    """(N,) component of the images with verified pairs that no pair ties to the first model; -1 = the others."""
    first = np.isfinite(image_poses(read_model(outcome.folders[0]), job.scene)).all(axis=(1, 2))
    component = job.graph.component
    return np.where(np.isin(component, np.unique(component[first])), -1, component)


def others_told(job: Job, outcome: Outcome) -> list[str]:
    """A remark on each group of images that nothing ties to the first model."""
    there = [np.isfinite(image_poses(read_model(f), job.scene)).all(axis=(1, 2)) for f in outcome.folders]
    untied, frame, out = _untied(job, outcome), job.scene.frame, []
    for number in np.unique(untied[untied >= 0]):
        own = untied == number
        if own.sum() < job.tuning.adjust.min_images:
            continue
        why = "another survey, or overlap too little"
        if np.isin(frame[own], frame[there[0]]).all():
            why = "of a camera that sees nothing of what the others see: a rig file (--rig) would place them"
        names, mapped = [job.scene.names[k] for k in np.flatnonzero(own)], np.any(there, axis=0)[own].any()
        out.append(
            f"{len(names)} images ({names[0]} .. {names[-1]}) have no verified pair with the first model: they are "
            f"{why}; {'they were mapped separately, see the table of models' if mapped else 'they make no model'}"
        )
    return out


def _mapped(job: Job, label: str) -> Outcome:
    """Run the chosen mapper. If its process ends, or under "auto" clearly fewer images than possible are placed, run
    it again with another seed (one start in a dozen fell apart on the example), then run the other mapper. Of a
    small survey both mappers make a model. The one that explains most matches is kept.

    The incremental mapper starts with two images. If these are near each other, a second relative pose explains them
    nearly as well, and the model grows from it: of a car that drove off (PandaSet's front camera) to a drive along a
    plane, rotated by 16 deg in the end, with 0.38 px instead of 0.28. The global mapper weighs all pairs at once.
    """
    first = choose_mapper(job)
    auto, rough = job.settings.mapper == "auto", job.source.rough
    reachable, tuning = job.graph.components[0], job.tuning.mapping
    enough = (tuning.roughly_fewer if rough else tuning.clearly_fewer) * reachable if auto else 0
    both = auto and first == "incremental"
    outcome = run_once(job, first, label)
    for mapper, seed in ((first, 1), (_OTHER[first], 0)):
        few, other = outcome.died or outcome.registered < enough, mapper != first
        if not (both and other) and (not few or (rough and other)):  # a rough model needs no slow mapper
            continue
        second = run_once(job, mapper, label, seed)
        outcome = _clearer(job, outcome, second, label)
    if not outcome.folders:
        why = outcome.refused or "the mapper found no two images to start from, or its models fell apart"
        error = ChildDied if outcome.died else ReconstructionError
        raise error(no_model_text(job.scene, job.graph, why))
    if job.settings.mapper not in ("auto", outcome.mapper):
        text = f"{first} mapping was requested, but its process ended: {outcome.mapper} mapping made the model"
        job.account.contradictions.append(text)
    return outcome


def _clearer(job: Job, first: Outcome, second: Outcome, label: str = "") -> Outcome:
    """Of two outcomes the one whose first model explains more matches, the first of equals, with a remark."""
    share = [share_of_matches(job, one) for one in (first, second)]
    kept = second if share[1] > share[0] else first
    job.account.notes.append(
        f"{' '.join([first.mapper, 'mapping', *label.split()])} placed {first.registered} of "
        f"{job.graph.components[0]} connected images and "
        f"explains {100 * share[0]:.0f} % of the matches, {second.mapper} mapping {second.registered} and "
        f"{100 * share[1]:.0f} %: the {kept.mapper} model is kept"
    )
    return kept


def share_of_matches(job: Job, outcome: Outcome) -> float:
    """Share of all verified matches that the first model of an outcome explains."""
    if not outcome.folders:
        return 0.0
    model, verified = read_model(outcome.folders[0]), job.matches().read(job.scene)
    return share_explained(model, job.scene, verified, job.tuning.placement.agreement)


def _request(job: Job, mapper: str, seed: int = 0, only: np.ndarray | None = None) -> Request:
    method = Method(
        mapper=mapper,
        seed=job.settings.seed + seed,
        rough=job.source.rough,
        positions=mapper == "incremental" and job.settings.use_positions and job.scene.has_positions(),
        poses=job.source.preview if mapper == "preview" else None,
    )
    return Request(
        method=method,
        matches=job.matches(only),
        rigs=RigsUsed(tuple(job.modes), job.held_rigs(), believed_cameras(job.scene, job.settings)),
        images=job.source.images,
        folder=job.out / SCRATCH / f"{len(job.account.runs)}-{mapper}",
        scene=job.scene,
        tuning=job.tuning,
    )


def run_once(job: Job, mapper: str, label: str, seed: int = 0, only: np.ndarray | None = None) -> Outcome:
    """One run of a mapper, of some images only if these are named; ``label`` says in the table of runs what for."""
    scene, request = job.scene, _request(job, mapper, seed, only)
    total = len(scene)
    per_frame = total / max(scene.frames, 1) if job.modes else 1.0
    job.source.on_progress(0, total)
    start, died = time.monotonic(), ""
    try:
        mapped: MappingResult = run_in_child(
            run_mapper,
            request,
            log=job.log,
            on_message=lambda frames: job.source.on_progress(min(total, round(frames * per_frame)), total),
            task=f"{mapper} mapping",
        )
    except ChildDied as error:
        died = str(error).splitlines()[0]
        mapped = MappingResult([], (died,), died)
    seconds = time.monotonic() - start
    folders = mapped.folders
    job.account.notes.extend(f"{mapper} model: {note}" for note in mapped.notes)
    registered, points = _seeing(folders[0], scene, job.tuning.adjust.min_points) if folders else (0, 0)
    rig, held = job.rigs_text(), "positions" if request.method.positions else "none"
    job.account.runs.append([mapper, rig, held, label, len(folders), registered, points, round(seconds, 1)])
    _log.info("%s mapping, rig %s: %d images in the first of %d models", mapper, rig, registered, len(folders))
    return Outcome(mapper=mapper, folders=folders, registered=registered, refused=mapped.refused, died=bool(died))


def _seeing(folder: Path, scene: Scene, least: int) -> tuple[int, int]:
    reconstruction = read_model(folder)
    return int(np.sum(observations(reconstruction, scene) >= least)), reconstruction.num_points3D()


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
    joining = Joining(scene, job.matches().read(scene), job.tuning.placement, models, {0: models[0]})
    while (found := joining.strongest([k for k in range(len(models)) if k not in joining.world])) is not None:
        number, fit, _ = found
        joining.add(number, moved(models[number], fit.first_from_second))
    poses = np.full((len(scene), 4, 4), np.nan)
    for number in sorted(joining.world, reverse=True):  # the larger model decides where two have an image
        own = image_poses(joining.world[number], scene)
        there = np.isfinite(own).all(axis=(1, 2))
        poses[there] = own[there]
    none = [None] * len(TEST_COLUMNS)
    rows = [
        [
            k,
            len(m.reg_image_ids()),
            *(joining.tests[k].cells() if k in joining.tests else none),
            "yes" if k in joining.world else "no",
        ]
        for k, m in enumerate(models)
    ]
    columns = ["section", "images", *TEST_COLUMNS, "joined"]
    job.account.tables["sections mapped separately"] = {"columns": columns, "rows": rows}
    job.account.notes.append(
        f"{len(models)} sections were mapped separately and {len(joining.world)} of them joined by the matches "
        "between them; the whole survey starts from these poses"
    )
    return replace(job, source=replace(source, apart=(), preview=poses))
