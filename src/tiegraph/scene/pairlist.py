"""COLMAP's list of image pairs, as a user hands it over."""

import difflib
from pathlib import Path

import numpy as np

from tiegraph.errors import InputError
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.regular import regular
from tiegraph.scene.scene import Scene
from tiegraph.scene.table import text_lines


def read_pair_list(path: Path, scene: Scene) -> tuple[Pairs, tuple[str, ...]]:
    """Pairs of a COLMAP pair list: two image names a line, ``#`` starts a comment; self pairs and repeats are counted.

    Raises InputError naming file, line and name for an unknown image, a line without exactly two names, an unreadable
    file, or a file without pairs.
    """
    rows: dict[tuple[int, int], int] = {}
    ignored: dict[str, list[int]] = {"self pairs": [], "repeated pairs": []}  # lines of each
    for number, words in pair_lines(path):
        i, j = sorted(_pair_of(words, f"{path}, line {number}", scene))
        if i == j:
            ignored["self pairs"].append(number)
        elif rows.setdefault((i, j), number) != number:
            ignored["repeated pairs"].append(number)
    if not rows:
        lines = ignored["self pairs"]
        raise InputError(
            f"{path}, line {lines[0]}: its {len(lines)} lines pair images with themselves; name two images a line"
        )
    both = np.array(list(rows))
    said = ", ".join(f"{len(v)} {kind} (line {v[0]}{' ...' if len(v) > 1 else ''})" for kind, v in ignored.items() if v)
    note = f"file: {len(rows)} pairs from {path.name}" + (f"; ignored: {said}" if said else "")
    return Pairs.make(both[:, 0], both[:, 1], "file"), (note,)


def pair_lines(path: Path) -> list[tuple[int, list[str]]]:
    """(line number, two image names) of a pair list, without comments.

    Raises InputError naming file and line for what is no text, holds no pairs, or has other than two names in a line.
    """
    try:
        text = regular(path).read_bytes().decode("utf-8-sig")
    except OSError as error:
        raise InputError(f"{path}: cannot be read as a pair list: {error.strerror}") from None
    except UnicodeDecodeError as error:
        raise InputError(f"{path}: no pair list: not text in UTF-8 (byte {error.start + 1})") from None
    out = [(k, line.split("#", 1)[0].split()) for k, line in enumerate(text_lines(text), start=1)]
    out = [(k, words) for k, words in out if words]
    if not out:
        raise InputError(f"{path}: holds no pairs; expected two image names a line")
    for k, words in out:
        if len(words) != 2 or "\0" in words[0] + words[1]:
            found = f"{len(words)} words: {' '.join(words)!r:.99}"
            raise InputError(f"{path}, line {k}: expected two image names, found {found}")
    return out


def _pair_of(words: list[str], place: str, scene: Scene) -> tuple[int, int]:
    index = []
    for name in words:
        if name not in scene.image_index:
            name = name.replace("\\", "/").removeprefix("./")
        if name not in scene.image_index:
            near = difflib.get_close_matches(name, scene.names, n=1, cutoff=0.3)
            hint = f"; perhaps {near[0]!r}?" if near else ""
            lost = next((d.reason for d in scene.dropped if d.name == name), None)
            why = f" (left out by scan: {lost})" if lost else hint
            raise InputError(f"{place}: the survey has no image {name!r}{why}")
        index.append(scene.image_index[name])
    return index[0], index[1]
