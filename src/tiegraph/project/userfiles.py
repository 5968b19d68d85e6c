"""What a user names must be there before anything runs: one check for every option and setting that is a path."""

from __future__ import annotations

import os
from pathlib import Path

from tiegraph.errors import InputError
from tiegraph.project.settings import Settings, sections, shortened
from tiegraph.scene.regular import regular

_SHORT = {"--georef.gcp": "--gcp", "--georef.marks": "--marks"}  # what they are called on the command line too


def user_files(settings: Settings) -> list[tuple[str, Path, str]]:
    """(option, path, kind) of every setting that names something of the user's, where one is given."""
    out = []
    for section, fields in sections():
        for name, field in fields.items():
            kind = field.json_schema_extra.get("kind") if isinstance(field.json_schema_extra, dict) else None
            path = getattr(getattr(settings, section), name) if kind else None
            if path is not None:
                out.append((f"--{section}.{name}".replace("_", "-"), path, str(kind)))
    return out


def check_files(settings: Settings) -> None:
    """Raise InputError for the first setting whose file or folder is not there, of another kind or not readable."""
    for option, path, kind in user_files(settings):
        check_path(_SHORT.get(option, option), path, kind)


def check_path(option: str, path: Path, kind: str) -> None:
    """Raise InputError, naming option and path, unless it is a readable ``kind``: file, folder, file or folder."""
    try:
        there, folder, file = path.exists(), path.is_dir(), path.is_file()
    except (OSError, ValueError) as error:  # a name too long, a zero byte
        raise InputError(f"{option} {shortened(str(path))}: not a path ({error})") from None
    if not there:
        raise InputError(f"{option} {path}: no such {kind}; mend the path, or leave the option away")
    if not (folder and "folder" in kind) and not (file and "file" in kind):
        what = "a folder" if folder else "a file" if file else _what(path)
        raise InputError(f"{option} {path} is {what}; give a {kind}")
    if not os.access(path, os.R_OK | (os.X_OK if folder else 0)):
        raise InputError(f"{option} {path}: no permission to read it")


def _what(path: Path) -> str:
    try:
        regular(path, None)
    except OSError as error:
        return str(error.strerror)
    return "no file now"
