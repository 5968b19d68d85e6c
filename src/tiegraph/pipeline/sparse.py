"""Glue of sparse: the verified pairs become models."""

import numpy as np

from tiegraph.errors import ReconstructionError
from tiegraph.geometry import transforms
from tiegraph.pipeline.features import dim_images, with_contrast
from tiegraph.pipeline.files import (
    checked,
    load_model,
    load_scene,
    pairs_of,
    save_npz,
    trusted_poses,
)
from tiegraph.project.run import Run
from tiegraph.project.stages import Outcome
from tiegraph.scan.priors.startmodel import read_start
from tiegraph.scan.priors.trajectory import images_by_name
from tiegraph.scene.colmapmodel import image_poses, tracks
from tiegraph.sfm.mapper import Source, reconstruct
from tiegraph.sfm.shape import SHAPE
from tiegraph.sfm.start import check_start, start_told


def sparse(run: Run) -> Outcome:
    """The models, with the rig, by COLMAP's mappers."""

    def progress(registered: int, total: int) -> None:
        run.reporter.total(total, registered)

    scene, apart = checked(run), ()
    if run.settings.network.sections == "split":  # pairs between sections, which are mapped separately
        pairs, of_image = pairs_of(run, "match.npz"), scene.section[scene.frame]
        across = of_image[pairs.i] != of_image[pairs.j]
        apart = tuple(sorted(zip(pairs.i[across].tolist(), pairs.j[across].tolist())))
    source = Source(
        run.path("database.db"),
        run.path("images"),
        apart=apart,
        preview=trusted_poses(run.folder),
        on_progress=progress,
    )
    try:
        made = reconstruct(
            source,
            run.path("sparse"),
            scene.measured(),
            run.settings.sparse,
            run.settings.tuning.sfm,
            run.settings.tuning.scene,
            run.log,
        )
    except ReconstructionError as error:
        raise with_contrast(error, run, scene) from None
    counts = dict(made.counts)
    if made.shape is not None:
        save_npz(run.path("sparse", SHAPE), **vars(made.shape))
    if made.sigma is not None:
        largest = float(np.linalg.norm(made.sigma.sigma, axis=1).max())
        counts |= {"position_sigma_median": made.sigma.median, "position_sigma_p90": made.sigma.p90}
        counts["position_sigma_largest"] = largest
        if made.sigma.scale is not None:
            counts["scale_sigma"] = made.sigma.scale
    said = made.remarks
    started = _against_start(run)
    counts |= started.counts
    notes, contradictions = (*said.notes, *started.notes), (*said.contradictions, *started.contradictions)
    dim = dim_images(run.folder, [name for name, _ in said.dropped], run.settings.tuning.features)
    dropped = tuple(
        (
            name,
            f"{why}; it shows {dim[name]:.1f} grey levels of contrast: more light, or nearer" if name in dim else why,
        )
        for name, why in said.dropped
    )
    return Outcome(counts, dropped=dropped, notes=notes, tables=made.tables, contradictions=contradictions)


def _against_start(run: Run) -> Outcome:
    if run.inputs.start is None:
        return Outcome({})
    scene, start = load_scene(run.path("scene.json")), read_start(run.inputs.start)
    model, tuning = load_model(run.path("sparse", "0")), run.settings.tuning.sfm.start_check
    files = [scene.source_name(k) for k in range(len(scene))]
    names = list(start.poses)
    given = np.full((len(scene), 4, 4), np.nan)
    for k, row in images_by_name(names, start.path, files).items():
        given[k] = start.poses[names[row]]
    made = transforms.invert(image_poses(model, scene))
    xyz, image, point = tracks(model, scene)
    reach = float(np.median(np.linalg.norm(xyz[point] - made[image, :3, 3], axis=1)))
    found = check_start(given, made, reach, tuning)
    text, contradicts = start_told(found, scene, tuning)
    counts = {"start_images": int(found.both.sum()), "start_disagrees": int(found.bad.sum())}
    return Outcome(counts, notes=() if contradicts else (text,), contradictions=(text,) if contradicts else ())
