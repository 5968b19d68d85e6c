"""Sections of a survey mapped apart (paper 001), joined by the matches between them, and adjusted as one.

The pairs of images that run between sections are held back while these are mapped. Then they join the models
(``ties``), which tells how well the borders hold, and the whole starts from the joined poses with all pairs.
"""

from dataclasses import replace

import numpy as np

from tiegraph.scene.colmapmodel import image_poses, read_model
from tiegraph.sfm.database import ViewGraph
from tiegraph.sfm.mapping import Account, Job, map_images
from tiegraph.sfm.ties import TEST_COLUMNS, Joining, TieTest, moved
from tiegraph.sfm.verified import read_verified

COLUMNS = ["section", "images", *TEST_COLUMNS, "joined"]


def start_from_sections(job: Job) -> Job:
    """The job, starting from the poses of its sections where these are to be mapped apart and joined."""
    scene, source = job.scene, job.source
    if not source.apart:
        return job
    refused = tuple(sorted({*source.refused, *source.apart}))
    graph = ViewGraph(source.database, scene, job.settings.min_matches, refused)
    account = Account(runs=job.account.runs)  # that a section has no pair with another need not be said
    alone = replace(job, source=replace(source, refused=refused, apart=()), graph=graph, account=account)
    models = [read_model(folder) for folder in map_images(alone).folders]
    verified = read_verified(source.database, scene, source.refused)
    joining = Joining(scene, verified, job.tuning.placement, models, {0: models[0]})
    while (found := joining.strongest([k for k in range(len(models)) if k not in joining.world])) is not None:
        number, fit, _ = found
        joining.add(number, moved(models[number], fit.first_from_second))
    poses = np.full((len(scene), 4, 4), np.nan)
    for number in sorted(joining.world, reverse=True):  # where two have an image, the larger model tells
        own = image_poses(joining.world[number], scene)
        there = np.isfinite(own).all(axis=(1, 2))
        poses[there] = own[there]
    rows = [_row(k, len(m.reg_image_ids()), joining.tests.get(k), k in joining.world) for k, m in enumerate(models)]
    job.account.tables["sections mapped apart"] = {"columns": COLUMNS, "rows": rows}
    job.account.notes.append(
        f"{len(models)} sections were mapped apart, {len(joining.world)} of them joined by the matches between them; "
        "the whole starts from there"
    )
    return replace(job, source=replace(source, apart=(), preview=poses))


def _row(number: int, images: int, test: TieTest | None, joined: bool) -> list:
    told = [None] * len(TEST_COLUMNS) if test is None else test.cells()
    return [number, images, *told, "yes" if joined else "no"]
