"""What each stage says of itself when it is done (or that it began), the list of the files it made, and the versions
that its result depends on."""

import json
import platform
from functools import cache
from importlib.metadata import PackageNotFoundError, version
from pathlib import Path

from tiegraph.__version__ import __version__
from tiegraph.project.ledger import Ledger
from tiegraph.project.stages import read_object, save_json, write_atomic


class Receipts:
    """The receipts of a run folder: ``receipts/<stage>.json``, the lists ``receipts/files/<stage>.json``."""

    def __init__(self, folder: Path) -> None:
        self.folder = folder

    def path(self, stage: str) -> Path:
        """Where a stage's receipt is."""
        return self.folder / "receipts" / f"{stage}.json"

    def list_path(self, stage: str) -> Path:
        """Where the list of a stage's files is."""
        return self.folder / "receipts" / "files" / f"{stage}.json"

    def read(self, stage: str) -> dict:
        """A stage's receipt, {} if there is none or it is damaged."""
        return read_object(self.path(stage)) or {}

    def damaged(self, stage: str) -> bool:
        """Whether there is a receipt that cannot be read."""
        return self.path(stage).exists() and not self.read(stage)

    def write(self, stage: str, receipt: dict) -> None:
        """Write a stage's receipt."""
        save_json(self.path(stage), receipt)

    def files(self, stage: str) -> Ledger | None:
        """The files a stage made, {} if it never ran, None if the list is damaged."""
        if not self.list_path(stage).exists():
            return {} if not self.path(stage).exists() else None
        found = read_object(self.list_path(stage))
        return found if found is not None and all(isinstance(v, list) for v in found.values()) else None

    def write_files(self, stage: str, files: Ledger) -> None:
        """Write the list of a stage's files."""
        write_atomic(self.list_path(stage), json.dumps(files, separators=(",", ":")))


_PACKAGES = ("pycolmap", "pycolmap-cuda12", "numpy", "opencv-python-headless", "scipy", "laspy", "pyproj")


def software() -> dict[str, str]:
    """Versions of tiegraph, Python and the packages that are installed of those a result depends on."""
    found = {package: known for package in _PACKAGES if (known := _version(package))}
    return {"tiegraph": __version__, "python": platform.python_version(), **found}


@cache  # every receipt tells it, and to read a package's description takes milliseconds
def _version(package: str) -> str:
    try:
        return version(package)
    except PackageNotFoundError:
        return ""
