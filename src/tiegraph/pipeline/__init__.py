"""The pipeline: the table of stages. Whoever has read it has seen the program.

The glue functions read artefacts, call engines and write artefacts; nothing else does.
"""

from tiegraph.pipeline.capture import preview, scan
from tiegraph.pipeline.masking import masks
from tiegraph.pipeline.model import features, forget_matches, match, sparse
from tiegraph.pipeline.remasking import remask
from tiegraph.pipeline.result import evaluate, report
from tiegraph.pipeline.shots import shots
from tiegraph.pipeline.surface import cloud, dense
from tiegraph.pipeline.ties import design, network
from tiegraph.pipeline.verification import verify
from tiegraph.pipeline.world import georef
from tiegraph.project.stages import Stage

__all__ = ["SHOTS", "STAGES"]

# What SQLite and the matching keep beside the database while they work.
_BESIDE_DATABASE = tuple(f"database.db{s}" for s in ("-wal", "-shm", "-journal", ".tmp", ".tmp-journal", ".match"))

# fmt: off
STAGES = (
    Stage("scan", scan, (), ("scene.json", "images"), "image", version=2),
    Stage("masks", masks, ("scan",), ("masks", "classes", "masks.csv"), "image", version=7),
    Stage("preview", preview, ("scan", "masks"), ("preview",), "image", version=2, tuned=("features",)),
    Stage("network", network, ("scan", "preview"), ("network.npz", "network.csv", "network"), version=6,
          scratch=("network/model",), tuned=("features", "sfm")),
    Stage("design", design, ("masks", "network"), ("pairs.npz", "pairs.txt", "pairs", "design"), version=6,
          uses=("features",), tuned=("features", "sfm")),
    Stage("features", features, ("scan", "masks"), ("database.db",), "image", version=2, scratch=_BESIDE_DATABASE),
    Stage("match", match, ("network", "design", "features"), ("match.npz",), "block of pairs",
          changes=("database.db",), clear=forget_matches),
    Stage("verify", verify, ("network", "match"), ("verify.npz",), "pair", version=2),
    Stage("sparse", sparse, ("network", "match", "verify"), ("sparse",), version=14, scratch=("sparse/.run",),
          tuned=("sfm",)),
    Stage("georef", georef, ("network", "sparse"), ("sparse/world", "world.json"), version=7,
          scratch=("sparse/.world",), tuned=("sfm",)),
    Stage("remask", remask, ("masks", "georef"), ("remask/masks", "remask/classes"), "image", version=3,
          tuned=("masks", "sfm")),
    Stage("dense", dense, ("georef", "remask"), ("depth",), "image", version=5),
    Stage("cloud", cloud, ("dense",), ("cloud.copc.laz", "cloud.laz", "cloud.ply"), scratch=(".tiles",)),
    Stage("evaluate", evaluate, ("verify", "georef", "remask", "dense", "cloud"), ("metrics.json",), version=2),
    Stage("report", report, ("evaluate",), ("report.html",), version=2),
)
# fmt: on

SHOTS = Stage(
    "shots",
    shots,
    ("scan",),
    ("shots",),
    "shot",
    uses=("dense", "cloud"),
    tuned=("dense", "cloud"),
    scratch=("shots/.tiles",),
)
"""The single-shot mode: apart from the table, for a survey does not need it."""
