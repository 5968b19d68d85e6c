"""Glue of comparisons of clouds outside the table of stages: two files, and two epochs (``epochs``)."""

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from typing import Any

import numpy as np

from tiegraph.errors import InputError
from tiegraph.evaluate.clouds.judge import Question, judge_cloud
from tiegraph.evaluate.reference import to_world
from tiegraph.evaluate.tuning import Tuning
from tiegraph.geometry.geodesy import ENU, Origin
from tiegraph.pipeline.evaluate import write_judgement
from tiegraph.project.stages import save_json
from tiegraph.scene.atomic import must_be_new, replacing, scratch_folder
from tiegraph.scene.cloudchunks import PointSource, open_cloud
from tiegraph.scene.results import metrics_to_dict


def evaluate_clouds(files: tuple[Path, Path], out: Path | None, question: Question, tuning: Tuning) -> dict[str, Any]:
    """Judge the first of two cloud files by the second; the content of metrics.json. ``out``: a folder for it, a map
    and clouds.

    Raises InputError for files that are no clouds or do not meet, and for a folder that is there.
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
        notes.append(f"only one of both names a CRS ({own.crs or truth.crs}): they are compared as they are")
    notes += [f"{cloud.name}: {cloud.note}" for cloud in (own, truth) if cloud.note and own.note != truth.note]
    with new_folder(out) as folder, scratch_folder(folder) as scratch:
        found = judge_cloud(own, _into(truth, own.crs), scratch, question, tuning)
        result = metrics_to_dict(found.metrics(), found.tables(), [found.notes(), *notes])
        if folder is not None:
            write_judgement(found, folder, _place(own.crs))
            save_json(folder / "metrics.json", result)
    return result


def refuse_coarse_alone(register: str, coarse: bool, remedy: str) -> None:
    """Raise InputError for a coarse start of no registration."""
    if coarse and register == "none":
        raise InputError(f"--coarse starts a registration: add {remedy}")


def _into(source: PointSource, crs: str | None) -> PointSource:
    """A cloud in the coordinates of a CRS."""
    if source.crs is None or crs is None or source.crs == crs:
        return source
    frames = _place(source.crs), _place(crs)
    return source.moved(lambda xyz: to_world(xyz, *frames), crs)


def _place(crs: str | None) -> Origin:
    """A world that is the CRS itself."""
    return Origin(lat_deg=0.0, lon_deg=0.0, height_m=0.0, crs=crs or ENU)


@contextmanager
def new_folder(out: Path | None) -> Iterator[Path | None]:
    """A folder that is there as a whole once all in it is made. Raises InputError if it is there before."""
    if out is None:
        yield None
        return
    must_be_new(out)
    with replacing(out) as folder:
        folder.mkdir()
        yield folder
