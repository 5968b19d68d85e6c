"""The rules by which inputs are spoiled: bytes, tables, structured text, paths. All take a random generator and return
what was done, in words; a rule that does not fit raises Unfit and another one is drawn."""

from __future__ import annotations

import os
import random
import re
import shutil
from collections.abc import Callable
from pathlib import Path

ODD_NUMBERS = ("nan", "inf", "-inf", "1e300", "-1e9", "1e12", "0", "-1", "1e-300", "99999999999999999999", "", "abc",
               "1,5", "0x10", "١٢", "true")  # fmt: skip
ODD_NAMES = (
    b"\x83e\x83X\x83g",  # Shift-JIS
    b"a" * 240,
    b"line\nbreak",
    b"bell\x07\x1b[31mred",
    b"[bold]markup[/bold]",
    b"$\\frac{",
    b" leading space",
    b"-o",
    b"semi;colon 'quote\" ",
    "bild-ä-画像-🚤".encode(),
    b"%s{0}%n",
    b"..x",
    b"com\xff",
)


class Unfit(Exception):
    """A rule that cannot be applied to this input."""


def truncated(path: Path, rng: random.Random) -> str:
    """Cut at a random byte."""
    data = path.read_bytes()
    if len(data) < 2:
        raise Unfit
    at = rng.randrange(1, len(data))
    path.write_bytes(data[:at])
    return f"{path.name} cut at byte {at} of {len(data)}"


def flipped(path: Path, rng: random.Random) -> str:
    """A few bytes replaced by random ones; in text the highest bit is set, for another digit is another survey."""
    data = bytearray(path.read_bytes())
    if not data:
        raise Unfit
    text = _is_text(bytes(data))
    places = [rng.randrange(len(data)) for _ in range(rng.choice((1, 8, 64)))]
    for at in places:
        data[at] = data[at] | 0x80 if text else data[at] ^ (1 << rng.randrange(8))
    path.write_bytes(bytes(data))
    return f"{path.name}: bytes {places[:4]}{'...' if len(places) > 4 else ''} spoiled"


def _is_text(data: bytes) -> bool:
    return b"\0" not in data and data[:2] not in (b"\xff\xd8", b"\x89P", b"PK")


def _replaced(name: str, what: str, make: Callable[[Path, random.Random], object]) -> Callable:
    """The rule that makes something else of a file."""

    def rule(path: Path, rng: random.Random) -> str:
        make(path, rng)
        return f"{path.name} {what}"

    rule.__name__ = name
    return rule


emptied = _replaced("emptied", "empty", lambda path, rng: path.write_bytes(b""))
# what a crash of the machine leaves
zeros = _replaced("zeros", "full of zeros", lambda path, rng: path.write_bytes(bytes(path.stat().st_size)))
noise = _replaced(
    "noise", "random bytes", lambda path, rng: path.write_bytes(rng.randbytes(max(64, path.stat().st_size)))
)
folder_instead = _replaced("folder_instead", "is a folder", lambda path, rng: (path.unlink(), path.mkdir()))
pipe_instead = _replaced("pipe_instead", "is a named pipe", lambda path, rng: (path.unlink(), os.mkfifo(path)))
loop_instead = _replaced(
    "loop_instead", "is a link to itself", lambda path, rng: (path.unlink(), path.symlink_to(path.name))
)
gone = _replaced("gone", "deleted", lambda path, rng: path.unlink())


def device_instead(path: Path, rng: random.Random) -> str:
    """A link to a device."""
    path.unlink()
    device = rng.choice(("/dev/zero", "/dev/null", "/dev/full"))
    path.symlink_to(device)
    return f"{path.name} is a link to {device}"


def unreadable(path: Path, rng: random.Random) -> str:
    """No permissions."""
    if os.geteuid() == 0:
        raise Unfit  # root reads everything
    path.chmod(0)
    return f"{path.name} without permissions"


BYTES: tuple[Callable, ...] = (truncated, flipped, flipped, truncated, emptied, zeros, noise)
PLACES: tuple[Callable, ...] = (folder_instead, pipe_instead, loop_instead, device_instead, gone, unreadable)


def _lines(path: Path) -> list[str]:
    lines = path.read_text(errors="replace").splitlines()
    if len(lines) < 3:
        raise Unfit
    return lines


def _split(line: str) -> tuple[list[str], str]:
    mark = "," if "," in line else " "
    return line.split(mark), mark


def column(path: Path, rng: random.Random) -> str:
    """A column deleted, twice, or two of them swapped, header included or not."""
    lines = _lines(path)
    cells = [_split(line)[0] for line in lines]
    mark = _split(lines[-1])[1]
    width = len(cells[-1])
    if width < 2 or len(cells[0]) != width:
        raise Unfit
    what, a, b = rng.choice(("deleted", "doubled", "swapped with")), *rng.sample(range(width), 2)
    first = rng.choice((0, 1)) if what == "swapped with" else 0
    for row in cells[first:]:
        if what == "deleted":
            del row[a]
        elif what == "doubled":
            row.insert(b, row[a])
        else:
            row[a], row[b] = row[b], row[a]
    _write(path, [mark.join(row) for row in cells])
    return (
        f"{path.name}: column {a + 1} {what} {b + 1 if what != 'deleted' else ''}, header {'kept' if first else 'too'}"
    )


def row(path: Path, rng: random.Random) -> str:
    """Rows deleted, doubled with another number, swapped, or the header lost."""
    lines = _lines(path)
    what = rng.choice(("deleted", "doubled", "doubled and changed", "shuffled", "without header", "only header"))
    at = rng.randrange(1, len(lines))
    if what == "deleted":
        del lines[at]
    elif what == "doubled":
        lines.insert(at, lines[at])
    elif what == "doubled and changed":
        lines.insert(at, _other_number(lines[at], rng))
    elif what == "shuffled":
        rest = lines[1:]
        rng.shuffle(rest)
        lines[1:] = rest
    elif what == "without header":
        del lines[0]
    else:
        del lines[1:]
    _write(path, lines)
    return f"{path.name}: row {at + 1} {what}"


def _other_number(line: str, rng: random.Random) -> str:
    numbers = list(re.finditer(r"-?\d+\.\d+", line))
    if not numbers:
        raise Unfit
    match = rng.choice(numbers)
    return line[: match.start()] + f"{float(match[0]) * 1.02 + 3:.6f}" + line[match.end() :]


def number(path: Path, rng: random.Random) -> str:
    """One number replaced by one that cannot be meant."""
    text = path.read_text(errors="replace")
    found = list(re.finditer(r"(?<![\w.])-?\d+(\.\d+)?([eE][-+]?\d+)?(?![\w.])", text))
    if not found:
        raise Unfit
    match, odd = rng.choice(found), rng.choice(ODD_NUMBERS)
    path.write_text(text[: match.start()] + odd + text[match.end() :])
    line = text.count("\n", 0, match.start()) + 1
    return f"{path.name}, line {line}: {match[0]} -> {odd!r}"


def all_numbers(path: Path, rng: random.Random) -> str:
    """One column of a table replaced by an odd number in every row."""
    lines = _lines(path)
    width = len(_split(lines[-1])[0])
    at, odd = rng.randrange(width), rng.choice(ODD_NUMBERS)
    for k in range(1, len(lines)):
        cells, mark = _split(lines[k])
        if at < len(cells):
            cells[at] = odd
        lines[k] = mark.join(cells)
    _write(path, lines)
    return f"{path.name}: column {at + 1} is {odd!r} in every row"


def separators(path: Path, rng: random.Random) -> str:
    """Another separator, decimal commas, or rows that are longer than the header."""
    lines = _lines(path)
    mark = _split(lines[-1])[1]
    what = rng.choice((";", "\t", "|", "decimal commas", "longer rows", "shorter rows", "quoted"))
    if what == "decimal commas":
        lines = [lines[0], *(line.replace(".", ",") for line in lines[1:])]
    elif what == "longer rows":
        lines = [lines[0], *(line + mark + "1" for line in lines[1:])]
    elif what == "shorter rows":
        lines = [lines[0], *(line.rpartition(mark)[0] for line in lines[1:])]
    elif what == "quoted":
        lines = [mark.join(f'"{c}"' for c in line.split(mark)) for line in lines]
    else:
        lines = [line.replace(mark, what) for line in lines]
    _write(path, lines)
    return f"{path.name}: {what!r}"


def encoded(path: Path, rng: random.Random) -> str:
    """UTF-16, a byte order mark, Latin-1 or Shift-JIS comments, line ends of other systems, NUL bytes."""
    text = path.read_text(errors="replace")
    what = rng.choice(("utf-16", "utf-8-sig", "utf-32", "cr", "crlf", "nul", "latin-1", "shift_jis"))
    if what in ("utf-16", "utf-8-sig", "utf-32"):
        path.write_bytes(text.encode(what))
    elif what in ("cr", "crlf"):
        path.write_bytes(text.replace("\n", "\r" if what == "cr" else "\r\n").encode())
    elif what == "nul":
        path.write_bytes(text.replace("\n", "\0\n").encode())
    else:
        path.write_bytes(text.encode() + ("\n# größe\n" if what == "latin-1" else "\n# 測量\n").encode(what))
    return f"{path.name} in {what}"


def scaled(path: Path, rng: random.Random) -> str:
    """A column in another unit: radians, milliseconds, millimetres, feet."""
    lines = _lines(path)
    width = len(_split(lines[-1])[0])
    at, factor = rng.randrange(width), rng.choice((0.017453292519943295, 57.29577951308232, 1000.0, 0.001, 0.3048))
    changed = 0
    for k in range(len(lines)):
        cells, mark = _split(lines[k])
        if at < len(cells) and re.fullmatch(r"-?\d+\.\d+", cells[at]):
            cells[at], changed = f"{float(cells[at]) * factor:.12f}", changed + 1
        lines[k] = mark.join(cells)
    if not changed:
        raise Unfit
    _write(path, lines)
    return f"{path.name}: column {at + 1} times {factor:.6g}"


def names(path: Path, rng: random.Random) -> str:
    """A word that names something becomes an unknown one."""
    text = path.read_text(errors="replace")
    found = list(re.finditer(r"[A-Za-z_][\w/.]{2,}", text))
    if not found:
        raise Unfit
    match = rng.choice(found)
    odd = rng.choice(("nosuch", "../../x.jpg", "", "a" * 300, "\x1b[31mred", "[bold]"))
    path.write_text(text[: match.start()] + odd + text[match.end() :])
    return f"{path.name}: {match[0]!r} -> {odd[:20]!r}"


def structure(path: Path, rng: random.Random) -> str:
    """A line of a structured file deleted, doubled, moved, or one more key."""
    lines = _lines(path)
    at = rng.choice([k for k, line in enumerate(lines) if line.strip()])
    what = rng.choice(("deleted", "doubled", "moved", "unknown key", "value is a list", "value is text"))
    line = lines[at]
    if what == "deleted":
        del lines[at]
    elif what == "doubled":
        lines.insert(at, line)
    elif what == "moved":
        lines.insert(rng.randrange(len(lines)), lines.pop(at))
    elif what == "unknown key":
        lines.insert(at, "nosuch = 1" if path.suffix == ".toml" else '"nosuch": 1,')
    else:
        key, mark, _ = line.partition("=" if path.suffix == ".toml" else ":")
        if not mark:
            raise Unfit
        end = "," if line.rstrip().endswith(",") else ""
        lines[at] = key + mark + (" [[]]" if what == "value is a list" else ' "text"') + end
    _write(path, lines)
    return f"{path.name}, line {at + 1}: {what} ({line.strip()[:50]})"


def _write(path: Path, lines: list[str]) -> None:
    path.write_text("\n".join(lines) + "\n")


TABLES: tuple[Callable, ...] = (column, row, number, number, all_numbers, separators, encoded, scaled, names)
STRUCTURED: tuple[Callable, ...] = (structure, structure, number, number, names, encoded)


def renamed(path: Path, rng: random.Random) -> str:
    """A name that file systems allow."""
    odd = rng.choice(ODD_NAMES)
    try:
        os.rename(path, os.path.join(os.fsencode(path.parent), odd + os.fsencode(path.suffix)))
    except OSError as error:
        raise Unfit from error
    return f"{path.name} renamed to {odd!r}"


def copied(path: Path, rng: random.Random) -> Path:
    """A second file beside one."""
    return Path(shutil.copyfile(path, path.with_name("x" + path.name)))
