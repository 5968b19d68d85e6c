"""Text on its way to people: what came from outside cannot act, what is not known is said in words, not in figures."""

import csv
import io
import math
import shlex
import unicodedata
from collections.abc import Iterable, Mapping, Sequence
from typing import Any

# Control characters (ESC, CR, BEL, NUL), format characters (that turn the direction of writing, or cannot be seen),
# halves of characters (bytes of a file name that are not UTF-8), separators of lines and paragraphs.
_ACTING = ("Cc", "Cf", "Cs", "Zl", "Zp")
_KEPT = "\n\t"


def acts(character: str) -> bool:
    """Whether a character does something to a terminal, a log or a page instead of standing for a letter."""
    return unicodedata.category(character) in _ACTING


def composed(text: str) -> str:
    """Letters with their marks as one character (NFC): macOS writes file names with the marks apart (NFD)."""
    return text if text.isascii() else unicodedata.normalize("NFC", text)


def printable(text: str) -> str:
    r"""``text`` with every character that acts as an escape such as ``\x1b`` or ``\u202e``; line breaks and tabs stay.

    Bytes of a file name that are not UTF-8, which Python holds as halves of surrogate pairs, become their own escape
    (``\x8e``), so that the result can always be written.
    """
    if text.isascii() and text.isprintable():
        return text
    return "".join(c if c in _KEPT or not acts(c) else _escaped(c) for c in text)


def one_line(text: str) -> str:
    """As ``printable``, line breaks and tabs escaped too: for names."""
    return "".join(_escaped(c) if acts(c) else c for c in text)


def command(*words: object) -> str:
    """A command line of tiegraph to copy: names are words to the shell, whatever they hold."""
    return shlex.join(["tiegraph", *map(str, words)])


def known_to(sigma: float, most: float, shown: str) -> str:
    """How well something is known: "known to <shown>", or "not known" where the sigma is not below ``most``.

    ``most`` is the size of what it is a sigma of: the length of a lever arm, a right angle, 1 for a scale.
    """
    return f"known to {shown}" if sigma < most else "not known"


def round_below(value: float) -> float:
    """The largest of 1, 2 and 5 times a power of ten that is not above a value: lengths of scale bars."""
    power = 10.0 ** math.floor(math.log10(value))
    return max(k * power for k in (1, 2, 5) if k * power <= value * 1.0001)


def round_above(value: float, series: Sequence[float] = (1, 2, 5, 10)) -> float:
    """The smallest of a series up to 10, times a power of ten, that is not below a value: intervals."""
    power = 10.0 ** math.floor(math.log10(value))
    return float(f"{next(k * power for k in series if k * power >= value * 0.9999):.3g}")


def some(texts: Iterable[str], most: int = 4, total: int = 0, joint: str = ", ") -> str:
    """The first of some texts, and how many more there are, of ``total`` where that is more than is at hand."""
    told = list(texts)
    rest = max(total, len(told)) - most
    return joint.join(told[:most]) + (f" and {rest} more" if rest > 0 else "")


def counted(counts: Mapping[str, Any]) -> str:
    """The counts of a receipt in words, three digits of what is no whole number: "12 images, 0.351 mean error"."""
    numbers = {k: int(v) if isinstance(v, float) and v.is_integer() else v for k, v in counts.items()}
    said = ((f"{v:.3g}" if isinstance(v, float) else v, k.replace("_", " ")) for k, v in numbers.items())
    return ", ".join(f"{value} {name}" for value, name in said)


def meant(word: str, known: Iterable[str], cutoff: float = 0.6) -> str:
    """The known word nearest to a wrong one, as the end of a message; "" if none is near."""
    import difflib  # for errors alone

    near = difflib.get_close_matches(word, list(known), n=1, cutoff=cutoff)
    return f"; perhaps you meant {near[0]!r}?" if near else ""


def finite(value: Any) -> Any:
    """A value for JSON: NaN and infinity become null, arrays and tuples lists."""
    value = value.tolist() if hasattr(value, "tolist") else value
    if isinstance(value, dict):
        return {k: finite(v) for k, v in value.items()}
    if isinstance(value, (list, tuple)):
        return [finite(v) for v in value]
    return None if isinstance(value, float) and not math.isfinite(value) else value


def csv_text(columns: Iterable[object], rows: Iterable[Iterable[object]]) -> str:
    """A table as CSV, lines ending in a newline."""
    out = io.StringIO()
    csv.writer(out, lineterminator="\n").writerows([columns, *rows])
    return out.getvalue()


def _escaped(character: str) -> str:
    code = ord(character)
    if 0xDC80 <= code <= 0xDCFF:  # PEP 383: byte 0x80 + n of a file name is U+DC80 + n
        return f"\\x{code - 0xDC00:02x}"
    return character.encode("unicode_escape", "surrogatepass").decode("ascii")
