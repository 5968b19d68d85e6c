"""Which images of a survey can be used: those that can be read, each file once."""

from collections import Counter
from collections.abc import Sequence
from pathlib import PurePosixPath

from tiegraph.errors import InputError
from tiegraph.scan.assign import Report, Usable
from tiegraph.scene.images import Probe


def usable_images(names: Sequence[str], probes: Sequence[Probe], report: Report) -> Usable:
    """The images that can be read, each file once; the report gets the others. InputError with fewer than two."""
    first: dict[str, str] = {}
    usable, repeated = [], []
    for k, (name, probe) in enumerate(zip(names, probes)):
        if probe.reason:
            report.drop([name], probe.reason)
        elif probe.digest in first:
            report.drop([name], f"the same file as {first[probe.digest]}")
            repeated.append((name, first[probe.digest]))
        else:
            first[probe.digest] = name
            usable.append(k)
    report.notes += _say_repeated(repeated, names)
    need_two(len(usable), report)
    return Usable(tuple(usable), tuple(names[k] for k in usable), tuple(probes[k] for k in usable))


def _say_repeated(repeated: Sequence[tuple[str, str]], names: Sequence[str]) -> list[str]:
    """One note for every two folders of which one repeats files of the other: a pass that was copied."""
    heads = Counter(_heads(name, original) for name, original in repeated)
    out = []
    for (copy, original), count in heads.items():
        total = sum(name.startswith(f"{copy}/") for name in names) if copy else len(names)
        said = f"{count} of {total} images"
        if copy == original:
            out.append(f"folder {copy or '.'}: {said} repeat others of it (identical files): left out")
        else:
            kind = "folder" if "/" in copy + original else "pass"
            text = f"{kind} {copy or '.'} repeats {kind} {original or '.'}: {said} are identical files"
            out.append(f"{text}; pairs between them carry no base, so they are left out")
    return out


def _heads(name: str, other: str) -> tuple[str, str]:
    """The folders of two files without what they end on alike: (B, A) for B/cam0/1.jpg and A/cam0/1.jpg."""
    mine, its = list(PurePosixPath(name).parent.parts), list(PurePosixPath(other).parent.parts)
    if mine == its:
        return "/".join(mine), "/".join(its)
    while mine and its and mine[-1] == its[-1]:
        mine.pop()
        its.pop()
    return "/".join(mine), "/".join(its)


def need_two(count: int, report: Report) -> None:
    """Raise InputError, with what was left out, for fewer than two images."""
    if count < 2:
        why = "; ".join(f"{d.name}: {d.reason}" for d in report.dropped[:3])
        raise InputError(
            f"{count} usable image(s): at least 2 are needed, and about 10 for a model. "
            + (f"Left out {len(report.dropped)}: {why}" if why else "Give a folder with more images")
        )
