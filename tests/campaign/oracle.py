"""The judge of a case. It must not be wrong in either direction without showing: what it cannot tell is a failure."""

from __future__ import annotations

import re
import signal
from collections.abc import Collection, Sequence
from dataclasses import dataclass, field

from campaign.process import Ended

CLEAR, SAID, HARMLESS = "clear", "said", "harmless"
SILENT, UNEXPECTED, HANG, CRASH = "silent", "unexpected", "hang", "crash"
LOSS, LEFTOVER, UNCLEAR, STUCK = "loss", "leftover", "unclear", "stuck"
LATER = "later"  # a case that only the long form can judge
GOOD = (CLEAR, SAID, HARMLESS)
FAILURES = (LOSS, HANG, CRASH, LEFTOVER, SILENT, UNEXPECTED, STUCK, UNCLEAR)
_SURPRISE = re.compile(  # the library has stack traces of its own
    r"unexpected [A-Z]\w*|Traceback \(most recent|^\s+File \"[^\"]+\", line \d+|^\*\*\* (?:Aborted at|SIG)",
    re.MULTILINE,
)
_CRASH_WORDS = re.compile(
    r"terminate called|Fatal Python error|Segmentation fault|core dumped|Aborted|signal SIG(?:ABRT|SEGV|BUS|FPE|ILL)"
)
_ERROR = re.compile(r"^tiegraph: ", re.MULTILINE)
_USAGE = re.compile(r"^╭─ ", re.MULTILINE)  # asked of errors only
_CONTROL = re.compile(r"[\x00-\x08\x0b-\x1f\x7f-\x9f]")


@dataclass
class Verdict:
    """What a case came to; ``why`` is for people."""

    name: str
    why: str = ""
    said: list[str] = field(default_factory=list)


def text_fault(ended: Ended) -> Verdict | None:
    """The fault that shows without looking at results: hang, crash, leftover processes, "unexpected"."""
    if ended.hung:
        return Verdict(HANG, "it did not end in time")
    if ended.left:
        return Verdict(LEFTOVER, "; ".join(ended.left))
    if ended.signal is not None:
        return Verdict(CRASH, f"ended by {signal.Signals(ended.signal).name}")
    if match := _CRASH_WORDS.search(ended.text):
        return Verdict(CRASH, _line_at(ended.text, match.start()))
    if match := _SURPRISE.search(ended.text):
        return Verdict(UNEXPECTED, _line_at(ended.text, match.start()))
    if match := _CONTROL.search(ended.text):
        return Verdict(UNCLEAR, f"a control character reaches the terminal: {_line_at(ended.text, match.start())!r}")
    return None


def refusal(ended: Ended, words: Collection[str]) -> Verdict:
    """The verdict on a run that ended with an error: one line that holds one of ``words``."""
    fault = text_fault(ended)
    if fault is not None:
        return fault
    if ended.code not in (1, 2):
        return Verdict(UNCLEAR, f"exit code {ended.code}")
    lines = error_lines(ended.text)
    if len(lines) != 1:
        return Verdict(UNCLEAR, f"{len(lines)} error lines: {lines[:3]}")
    if not holds(lines[0], words):
        return Verdict(UNCLEAR, f"names none of {sorted(words)}: {lines[0]}", lines)
    return Verdict(CLEAR, lines[0], lines)


def error_lines(text: str) -> list[str]:
    """The error messages: the lines of `tiegraph: ...`, or the box of the argument parser as one line."""
    lines = [line for line in text.splitlines() if _ERROR.match(line)]
    if not lines and (match := _USAGE.search(text)):
        lines = [" ".join(text[match.start() :].split())]
    return lines


def passed(ended: Ended, clean_text: str, words: Collection[str], different: Sequence[str]) -> Verdict:
    """The verdict on a run that ended with exit code 0: what it said beyond the clean run, and what differs."""
    fault = text_fault(ended)
    if fault is not None:
        return fault
    told = said(ended.text, clean_text, words)
    if told:
        return Verdict(SAID, told[0], told[:4])
    if different:
        return Verdict(SILENT, "; ".join(different[:4]))
    return Verdict(HARMLESS)


def said(text: str, clean_text: str, words: Collection[str]) -> list[str]:
    """The notes that a clean run does not make and that hold one of ``words``, and the contradictions that it does not
    find, which cannot always name the one that is wrong; counts of a stage are no note."""
    usual = {_shape(line) for line in clean_text.splitlines()}
    notes = [line.strip() for line in text.splitlines() if line.lstrip().startswith((". ", "! "))]
    return [n for n in notes if _shape(n) not in usual and (n.startswith("! ") or holds(n, words))]


def holds(line: str, words: Collection[str]) -> bool:
    """Whether a line holds one of the words, whole, in any case."""
    low = line.lower()
    return any(re.search(rf"(?<![a-z0-9]){re.escape(w.lower())}", low) for w in words if w)


def _shape(line: str) -> str:
    """A note without its numbers."""
    return re.sub(r"[-+]?\d+(\.\d+)?", "#", line.strip())


def _line_at(text: str, place: int) -> str:
    start = text.rfind("\n", 0, place) + 1
    end = text.find("\n", place)
    return text[start : end if end >= 0 else None].strip()[:300]


def after_signal(ended: Ended, number: int | None, main: bool) -> Verdict:
    """The verdict on a run that was hit: ``number`` to its main process (``main``) or to a process it started."""
    if ended.hung:
        return Verdict(HANG, "it did not end after the signal")
    if ended.left:
        return Verdict(LEFTOVER, "; ".join(ended.left))
    by_us = main and ended.signal is not None and ended.signal == number
    if by_us and number == signal.SIGKILL:
        return Verdict(CLEAR)
    if match := _SURPRISE.search(ended.text):
        return Verdict(UNEXPECTED, _line_at(ended.text, match.start()))
    if ended.code == 0:
        return Verdict(HARMLESS, "it had ended already, or did without")
    if by_us and number in (signal.SIGTERM, signal.SIGHUP):
        return Verdict(CLEAR, "ended by the signal")  # what a shell expects; who sent it knows
    if ended.signal is not None:
        return Verdict(CRASH, f"ended by {signal.Signals(ended.signal).name}")
    lines = error_lines(ended.text)
    if len(lines) != 1:
        return Verdict(UNCLEAR, f"{len(lines)} error lines, exit code {ended.code}: {lines[:3]}")
    return Verdict(CLEAR, lines[0], lines)
