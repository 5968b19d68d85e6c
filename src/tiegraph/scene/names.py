"""Safe file names of any origin: for libraries that take UTF-8 only, for file systems, for display.

Linux keeps names as bytes. Those that are not UTF-8 (a Shift-JIS archive unpacked) reach Python as strings with lone
surrogates, which kill the interpreter inside OpenCV and cannot be written to any text file. So a survey's files get
names of ours where they are listed (``clean_names``), and only the opening of a file (``on_disk``) uses the original
ones.
"""

import hashlib
import itertools
import os
import re
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from pathlib import Path, PurePosixPath

from tiegraph.errors import InputError
from tiegraph.text import acts, composed, one_line

# File systems take 255 bytes; masks/<name>.png, depth maps <name>.geometric.bin and temporary files add to a name.
LONGEST_BYTES = 200
_ANY_CASE = "\0"  # before names in lower case: in no file's name
_SHOWN = 80  # characters of a name in an error
_ESCAPE = re.compile("%(?:[0189A-F][0-9A-F]|7F)")  # of control characters and of what may not be UTF-8


def clean(name: str) -> str:
    """A name in composed form with every byte that is not text (control characters, bytes that are not UTF-8) as
    ``%XX``."""
    if name.isascii() and name.isprintable():
        return name
    return composed("".join("".join(f"%{b:02X}" for b in os.fsencode(c)) if acts(c) else c for c in name))


def plain_name(text: str) -> str:
    """An image's name in our form: slashes, no ./ before it, in composed form."""
    return composed(text.replace("\\", "/").removeprefix("./"))


def lookup_of(named: Iterable[tuple[str, int]]) -> dict[str, int]:
    """Table of names in a user's file, for ``found_by``: names of images; the ends of their paths, with and
    without suffix, if these are unique; and all of them in any case, as Windows takes names, if that is unique.
    """
    full = dict(named)
    written = [(text.split("/"), k) for n, k in full.items() for text in (n, str(PurePosixPath(n).with_suffix("")))]
    ends = (("/".join(parts[level:]), k) for parts, k in written for level in range(len(parts)))
    out = _of_one(ends) | full
    return _of_one((f"{_ANY_CASE}{key.lower()}", k) for key, k in out.items()) | out


def _of_one(named: Iterable[tuple[str, int]]) -> dict[str, int]:
    """The unique entries, by name."""
    found: dict[str, int | None] = {}
    for name, what in named:
        if found.setdefault(name, what) != what:
            found[name] = None
    return {name: what for name, what in found.items() if what is not None}


def found_by(lookup: Mapping[str, int], name: str) -> int | None:
    """The image of a name, by a table of ``lookup_of``; None if it names nothing here."""
    plain = plain_name(name)
    return lookup.get(plain, lookup.get(f"{_ANY_CASE}{plain.lower()}"))


def all_found(given: Sequence[str], named: Iterable[tuple[str, int]]) -> tuple[int | None, ...]:
    """The image of each given name, as in ``found_by``. Leading folders that all have and none needs are removed."""
    lookup = lookup_of(named)
    parts = [[p for p in plain_name(name).split("/") if p not in ("", "..")] for name in given]
    levels = range(len(os.path.commonprefix([p[:-1] for p in parts])) + 1)
    tried = (tuple(found_by(lookup, "/".join(p[level:])) for p in parts) for level in levels)
    return next((found for found in tried if set(found) != {None}), (None,) * len(given))


def on_disk(folder: Path, name: str) -> Path | None:
    """The file below a folder for a name of ours (POSIX), in whatever form the file system has it; None without."""
    parts = [(p, unclean(p), unicodedata.normalize("NFD", p)) for p in PurePosixPath(name).parts]
    ways = itertools.product(*(dict.fromkeys(spellings) for spellings in parts))
    return next((path for way in ways if os.path.isfile(path := folder.joinpath(*way))), None)  # False if too long, too


def clean_names(names: Sequence[str]) -> list[str]:
    """``clean`` of POSIX names below a folder, folder by folder, so that two files or folders never become one."""
    if all(name.isascii() and name.isprintable() for name in names):
        return list(names)
    taken = {str(p) for name in names for p in (PurePosixPath(name), *PurePosixPath(name).parents)}
    made: dict[PurePosixPath, PurePosixPath] = {PurePosixPath("."): PurePosixPath(".")}

    def of(path: PurePosixPath) -> PurePosixPath:
        if path not in made:
            part, number = clean(path.name), 2
            made[path] = of(path.parent) / part
            while part != path.name and str(made[path]) in taken:
                other = PurePosixPath(part)
                made[path] = of(path.parent) / f"{other.stem}_{number}{other.suffix}"
                number += 1
            taken.add(str(made[path]))
        return made[path]

    return [str(of(PurePosixPath(name))) for name in names]


def unclean(name: str) -> str:
    """The file name from which ``clean`` made ``name``, if it is one: ``%XX`` of bytes that are no text."""
    parts = re.split(f"({_ESCAPE.pattern})", name)
    raw = os.fsdecode(b"".join(bytes.fromhex(p[1:]) if _ESCAPE.fullmatch(p) else os.fsencode(p) for p in parts))
    return raw if clean(raw) == name else name


def shortened(part: str, limit: int = LONGEST_BYTES) -> str:
    """One part of a path in at most ``limit`` bytes: its beginning, a hash of the whole, its suffix."""
    if len(os.fsencode(part)) <= limit:
        return part
    suffix = PurePosixPath(part).suffix
    suffix = suffix if len(os.fsencode(suffix)) <= 20 else ""
    mark = "~" + hashlib.blake2b(os.fsencode(part), digest_size=5).hexdigest() + suffix
    return os.fsencode(part)[: limit - len(mark.encode())].decode("utf-8", "ignore") + mark


def check_name(name: object) -> None:
    """Raise InputError for an image name that could lead out of the folder it is joined to, or is none at all.

    Good names are relative POSIX paths without empty parts, ``.``, ``..``, and characters that are not text.
    """
    good = isinstance(name, str) and name != "" and not any(map(acts, name)) and "\\" not in name
    if not good or any(part in ("", ".", "..") for part in str(name).split("/")) or Path(str(name)).drive:
        raise InputError(
            f"image name '{one_line(str(name))[:_SHOWN]}': must be a path below the image folder, such as a/1.jpg, "
            "without '..', empty parts, backslashes or control characters; restore the file it is in, or make it again"
        )


def inside(folder: Path, name: str) -> Path:
    """``folder / name`` for writing. Raises InputError for a name that ``check_name`` refuses."""
    check_name(name)
    return folder / name


def check_text(value: object, what: str) -> None:
    """Raise InputError for a path or text of the user with control characters or bytes that are not UTF-8.

    Such a path cannot be written to ``tiegraph.toml``, the report or a log, nor handed to COLMAP.
    """
    text = str(value)
    if any(map(acts, text)):
        raise InputError(
            f"{what} '{one_line(text)}': has control characters or bytes that are not UTF-8; "
            "rename the file or folder (files below the image folder may have such names)"
        )
