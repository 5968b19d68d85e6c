"""What is handed over: the files of a run folder that others use, with what they are and how large."""

from pathlib import Path

from tiegraph.report import formatting
from tiegraph.report.runfolder import RunFolder
from tiegraph.report.texts import t

_FILES = {
    "cloud.copc.laz": "point cloud for viewers (COPC), colours, sigma of each point",
    "cloud.laz": "point cloud as LAZ, colours, sigma of each point",
    "cloud.ply": "point cloud as PLY, with normals",
    "sparse/world": "camera positions and sparse points (COLMAP)",
    "metrics.json": "accuracy, all figures",
    "accuracy.csv": "accuracy, as a table",
}


def deliverables(run: RunFolder) -> list[tuple[str, str, int]]:
    """(name, what it is, bytes) of each that is there."""
    there = [(name, run.path / name, words) for name, words in _FILES.items()]
    return [(name, t(words), _bytes(path)) for name, path, words in there if path.exists()]


def sizes(rows: list[tuple[str, str, int]]) -> list[tuple[str, str, str]]:
    """The same with sizes as text."""
    return [(name, words, formatting.size(amount)) for name, words, amount in rows]


def _bytes(path: Path) -> int:
    if path.is_dir():
        return sum(p.stat().st_size for p in path.iterdir() if p.is_file())
    return path.stat().st_size
