"""Where a start model stands, and whose it is: told by what is in a folder or file, for nothing else is asked."""

import re
from pathlib import Path

from tiegraph.errors import InputError
from tiegraph.scene.colmapmodel import is_model
from tiegraph.scene.regular import regular

ACCEPTED = (
    "a COLMAP model (the folder of images.bin or images.txt, or of sparse/0), OpenSfM's or ODM's reconstruction.json, "
    "nerfstudio's transforms.json, or the cameras that Metashape exports as XML"
)
_HEAD = 1 << 16  # letters of an XML file in which its root stands


def find_start(path: Path) -> tuple[str, Path]:
    """The program (COLMAP, OpenSfM, nerfstudio, Metashape) and the file or folder of the model that ``--start`` names.

    Raises InputError if there is none.
    """
    if not path.exists():
        raise InputError(f"--start {path}: no such file or folder; give {ACCEPTED}")
    for program, find in _FORMATS.items():
        place = find(path)
        if place is not None:
            return program, place
    raise InputError(f"--start {path}: no model that is known; give {ACCEPTED}")


def called(place: Path) -> str:
    """A model's file or folder in messages: "sparse/0" says more than "0"."""
    return f"{place.parent.name}/{place.name}" if place.name.isdigit() else place.name


def _find_colmap(path: Path) -> Path | None:
    """The model folder; of several beside each other (0, 1, ...) the largest file of images."""
    if path.is_file():
        return path.parent if path.name in ("images.bin", "images.txt") else None
    if is_model(path):
        return path
    for folder in (path, path / "sparse"):
        if folder.is_dir():
            numbered = [p for p in folder.iterdir() if p.name.isdigit() and is_model(p)]
            if numbered:
                return max(sorted(numbered, key=lambda p: int(p.name)), key=_size)
    return None


def _size(model: Path) -> int:
    return max((model / n).stat().st_size for n in ("images.bin", "images.txt") if (model / n).exists())


def _find_opensfm(path: Path) -> Path | None:
    if path.is_file():
        return path if _is_json(path) and '"shots"' in _content(path) else None
    places = (path / "reconstruction.json", path / "opensfm" / "reconstruction.json")
    return next((p for p in places if p.is_file()), None)


def _find_transforms(path: Path) -> Path | None:
    if path.is_file():
        return path if _is_json(path) and '"frames"' in _content(path) else None
    return path / "transforms.json" if (path / "transforms.json").is_file() else None


def _is_json(path: Path) -> bool:
    return path.suffix.lower() == ".json"


def _content(path: Path) -> str:
    try:
        return regular(path).read_bytes().decode("utf-8", "replace")
    except OSError as error:
        raise InputError(f"--start {path}: cannot be read ({error.strerror}); give {ACCEPTED}") from None


def _find_metashape(path: Path) -> Path | None:
    if path.is_file():
        return path if path.suffix.lower() == ".xml" and _is_metashape(path) else None
    found = [p for p in sorted(path.glob("*.xml")) if p.is_file() and _is_metashape(p)]
    if len(found) > 1:
        names = ", ".join(p.name for p in found[:4])
        raise InputError(f"--start {path}: {len(found)} files of cameras in it ({names}): give the one that is meant")
    return found[0] if found else None


def _is_metashape(path: Path) -> bool:
    return bool(re.search(r"<document\b.*?<chunk\b", _content(path)[:_HEAD], re.DOTALL))


_FORMATS = {
    "COLMAP": _find_colmap,
    "OpenSfM": _find_opensfm,
    "nerfstudio": _find_transforms,
    "Metashape": _find_metashape,
}
