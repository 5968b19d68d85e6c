"""The pipeline: the table of stages, an overview of the whole program.

The glue functions read artefacts, call engines and write artefacts; nothing else does. That of a stage is the
function of its name in the module of its name or in ``_ELSEWHERE``, loaded when the stage runs: a worker, a child
process or a short command loads few engines and not all of them (matplotlib, statistics, the report), which would cost
each 2.5 CPU s more.

``scan`` writes ``scene.json``; ``candidates``, ``coarse`` and ``network`` each write a copy of their own, with the rig
checked against the images, calibrated by the coarse model, and the sections cut. Every later stage reads the last,
``network/scene.json``: the rig by the images is a result, and the scan keeps what was found in the folder.
``sparse`` and ``georef`` see ``Scene.measured()``: positions that a trajectory carried over a GNSS gap, and odometry
with its own world for each pass, serve the choice of pairs and never constrain or test a model.
"""

from contextlib import suppress
from importlib import import_module
from typing import Any

from tiegraph.project.stages import Stage, needed

__all__ = ["MESH", "SHOTS", "STAGES", "table"]


_ELSEWHERE = {
    "preview": "features", "candidates": "network", "coarse": "network", "design": "network", "match": "features",
    "sparse": "georef", "refine": "masks", "cloud": "dense", "report": "evaluate",
}  # fmt: skip


def _module(stage: str) -> Any:
    return import_module(f"tiegraph.pipeline.{_ELSEWHERE.get(stage, stage)}")


def load(until: str | None = None) -> None:
    """Import the glue of all stages up to and including one, as far as possible: a stage reports missing parts."""
    for stage in needed(table(until), until):
        with suppress(ImportError):
            _module(stage.name)


def _stage(name: str, *what: Any, **more: Any) -> Stage:
    return Stage(name, lambda run: getattr(_module(name), name)(run), *what, **more)


# SQLite's files beside the database while it works.
_BESIDE_DATABASE = tuple(f"database.db{s}" for s in ("-wal", "-shm", "-journal"))

# fmt: off
STAGES = (
    _stage("scan", (), ("scene.json", "whole.json", "images", "odometry"), "image", version=14,
           tuned=("scene", "odometry")),
    _stage("masks", ("scan",), ("masks", "classes", "masks.csv"), "image", version=14),
    _stage("preview", ("scan", "masks"), ("preview",), "image", version=3, tuned=("features",)),
    _stage("candidates", ("scan", "preview"), ("candidates.npz", "candidates"), "pair", version=10,
           scratch=("candidates/matched",), tuned=("scene", "network", "features")),
    _stage("coarse", ("scan", "preview", "candidates"), ("coarse.npz", "coarse"), "block", version=14,
           uses=("candidates",), scratch=("coarse/blocks", "coarse/mapping", "coarse/matched"),
           tuned=("scene", "network", "features", "sfm")),
    _stage("network", ("scan", "masks", "preview", "coarse"), ("network.npz", "network.csv", "network"), version=11,
           uses=("candidates",), tuned=("scene",)),
    _stage("design", ("masks", "coarse", "network"), ("pairs.npz", "pairs.txt", "pairs", "design"), version=13,
           uses=("features",), tuned=("features", "sfm")),
    _stage("features", ("scan", "masks"), ("database.db",), "image", version=5, scratch=_BESIDE_DATABASE),
    _stage("match", ("network", "design", "features"), ("match.npz",), "block of pairs", version=3,
           changes=("database.db",), clear=lambda folder: _module("match").forget_matches(folder),
           scratch=("database.db.match",), tuned=("features",)),
    _stage("sparse", ("preview", "coarse", "network", "match"), ("sparse",), version=43,
           scratch=("sparse/.run",), tuned=("scene", "features", "sfm")),
    _stage("georef", ("network", "match", "sparse"), ("sparse/world", "world.json"), version=30,
           scratch=("sparse/.world",), tuned=("scene", "sfm", "targets")),
    _stage("refine", ("masks", "georef"), ("refine/masks", "refine/classes"), "image", version=5,
           tuned=("masks", "sfm")),
    _stage("dense", ("georef", "refine"), ("depth",), "image", version=6, passing=True),
    _stage("cloud", ("dense",), ("cloud.copc.laz", "cloud.laz", "cloud.ply", "passes"), version=7,
           scratch=(".tiles",), tuned=("evaluate",)),
    _stage("products", ("georef", "refine", "dense", "cloud"), ("products",), "tile", version=10,
           scratch=("products/.tiles",), tuned=("evaluate",)),
    _stage("evaluate", ("georef", "refine", "dense", "cloud"), ("metrics.json", "accuracy.csv", "evaluate"), version=11,
           scratch=("evaluate/.tiles",), tuned=("scene",), spares=("dense", "cloud")),
    _stage("report", ("products", "evaluate"), ("report.html", "report.json"), version=18, alone=True),
)
# fmt: on

SHOTS = _stage("shots", ("scan",), ("shots",), "shot", uses=("dense", "cloud"), tuned=("dense", "cloud"),
               scratch=("shots/.tiles",))  # fmt: skip
"""The single-shot mode: apart from the table, for a survey does not need it."""

MESH = _stage("mesh", ("georef", "refine", "dense", "cloud"), ("mesh",), "image", tuned=("evaluate",),
              scratch=("mesh/.work",))  # fmt: skip
"""The textured mesh of a finished survey: apart from the table, for it is made when it is asked for."""


def table(until: str | None = None) -> tuple[Stage, ...]:
    """The stages, with those apart from the table if they are asked for."""
    return (*STAGES, *(stage for stage in (MESH,) if stage.name == until))
