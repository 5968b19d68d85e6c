"""The meaning of the folders: which part of an image's path is the camera and which the pass."""

import os
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import PurePosixPath

import numpy as np

from tiegraph.geometry.geodesy import Origin, world_from_geodetic
from tiegraph.scan.tuning import FoldersTuning
from tiegraph.scene.exif import Exif
from tiegraph.text import some

_CAMERA_WORDS = frozenset(
    "cam camera lens sensor image img fisheye left right front rear back top zenith port starboard l r".split()
)
_PASS_WORDS = frozenset(
    "pass run track line strip leg flight up down upstream downstream forward backward outbound inbound return day "
    "session survey lap section mission media dcim go river".split()
)
UP_WORDS = frozenset("up top sky zenith".split())
# Names that cameras give to single photographs; video frames and industrial cameras have a plain word or nothing.
_PHOTO_NAME = re.compile(r"^(img|dsc|dscn|dscf|dji|p|pict|gopr|mvi|sam|_mg|_dsc|photo|cimg|r)_?\d", re.IGNORECASE)
_GENERIC_WORDS = _CAMERA_WORDS | frozenset("images cameras data photos pictures input jpg jpeg png frames raw".split())
LONE_PASS = "all"


@dataclass(frozen=True)
class Place:
    """The place of an image: sensor folder ("" = none) and pass."""

    folder: str
    sequence: str


@dataclass(frozen=True)
class Order:
    """Whether images are loose photographs, and why (for people); ``guessed``: they are a sequence only if the images
    show it, which the network tests."""

    loose: bool
    why: str
    guessed: bool = False


@dataclass(frozen=True)
class Layout:
    """Reading of a folder tree: the place of each image, the sensor folders in natural order, and order."""

    places: tuple[Place | None, ...]  # None: a stray, outside the camera folders
    folders: tuple[str, ...]
    order: Order


def is_camera(folder: str) -> bool:
    """Whether a folder is named like a camera's."""
    return bool(words(folder) & _CAMERA_WORDS)


def natural(text: str) -> list[tuple[int, int, str]]:
    """Sort key that puts cam2 before cam10."""
    parts = re.split(r"(\d+)", text)
    return [(0, int(p), p) if p.isdigit() else (1, 0, p.lower()) for p in parts if p]


def words(name: str) -> set[str]:
    """Words of a folder name without its numbers: Front_Camera2 -> front, camera."""
    return set(re.findall(r"[a-z]+", re.sub(r"(?<=[a-z])(?=[A-Z])", " ", name).lower()))


def place_by_folders(names: Sequence[str], folders: Sequence[str]) -> list[Place | None]:
    """Places of images below known sensor folders; a folder "" takes all images of no other folder.

    A sensor folder may have several levels and be above or below the pass; the longest and deepest match counts. A
    pattern such as "*_GRE" means the images whose names have this end, in any folder; "left_*" those whose names
    have this beginning, with their folders or in any.
    """
    wanted = sorted((tuple(f.split("/")) for f in folders if f and not is_pattern(f)), key=len, reverse=True)
    patterns = sorted(filter(is_pattern, folders), key=len, reverse=True)
    places: list[tuple[str, tuple[str, ...]] | None] = []
    for name in names:
        parts = PurePosixPath(name).parts[:-1]
        found = ((w, k) for w in wanted for k in range(len(parts) - len(w), -1, -1) if parts[k : k + len(w)] == w)
        match = next(found, None)
        mark = next((p for p in patterns if _fits(name, p)), None)
        if match is not None:
            own, at = match
            places.append(("/".join(own), parts[:at] + parts[at + len(own) :]))
        elif mark is not None:
            places.append((mark, _besides(name, mark)))
        else:
            places.append(("", parts) if "" in folders else None)
    common = _common([p[1] for p in places if p is not None])
    return [p and Place(p[0], _pass_name(p[1], common)) for p in places]


def is_pattern(folder: str) -> bool:
    """Whether a sensor's folder is a pattern of file names, "*_GRE" or "left_*": cameras that write into one folder."""
    return folder.startswith("*") or folder.endswith("*")


def _fits(name: str, pattern: str) -> bool:
    path, begin = PurePosixPath(name), pattern.removesuffix("*")
    if pattern.startswith("*"):
        return shot_stem(name, pattern) != path.stem
    return name.startswith(begin) or path.name.startswith(begin)


def _besides(name: str, pattern: str) -> tuple[str, ...]:
    """The folders of an image without those that are part of a pattern."""
    begin = pattern.removesuffix("*")
    if pattern.startswith("*") or not name.startswith(begin):
        return PurePosixPath(name).parts[:-1]
    return PurePosixPath(name[len(begin) :]).parts[1:-1]


def shot_stem(name: str, folder: str) -> str:
    """Stem of an image's file name without the mark of its camera, by the pattern."""
    stem, mark = PurePosixPath(name).stem, folder[1:].lower()
    if folder.endswith("*"):
        return stem.removeprefix(folder[:-1].rpartition("/")[2])
    return stem[: -len(mark)] if is_pattern(folder) and mark and stem.lower().endswith(mark) else stem


def pass_names(paths: Sequence[tuple[str, ...]]) -> list[str]:
    """Pass of each image by the folders it lies in."""
    common = _common(paths)
    return [_pass_name(p, common) for p in paths]


def _pass_name(parts: tuple[str, ...], common: int) -> str:
    """Folders of a pass without those that all images share; for a single pass the last specific one."""
    if parts[common:]:
        return "/".join(parts[common:])
    telling = [p for p in parts if not words(p) & _GENERIC_WORDS]
    return telling[-1] if telling else LONE_PASS


def _common(paths: Sequence[tuple[str, ...]]) -> int:
    return len(os.path.commonprefix(list(paths)))


def guess_layout(
    names: Sequence[str],
    exif: Sequence[Exif],
    sizes: Sequence[tuple[int, int]],
    kind: str,
    tuning: FoldersTuning,
    cameras: tuple[int, ...] = (),
) -> Layout:
    """Reading of a folder tree without a rig file; ``kind`` is ScanSettings.layout.

    ``cameras`` are the numbers of cameras that a preset allows: a folder level with this many names is preferred.
    """
    paths = [PurePosixPath(n).parts[:-1] for n in names]
    depth, count = Counter(len(p) for p in paths).most_common(1)[0]
    inside = [k for k, p in enumerate(paths) if len(p) == depth or count < tuning.one_depth * len(paths)]
    inner, why = _by_camera_level(names, exif, inside, kind, cameras, tuning)
    if not inner and len(inside) < len(names):
        inside = list(range(len(names)))
        inner, why = _by_camera_level(names, exif, inside, kind, cameras, tuning)
    if inner:
        places: list[Place | None] = [None] * len(names)
        for k, place in zip(inside, inner):
            places[k] = place
        folders = tuple(sorted({p.folder for p in inner}, key=natural))
        passes = len({p.sequence for p in inner})
        return Layout(tuple(places), folders, Order(False, f"{len(folders)} cameras, {passes} pass(es): {why}"))
    lone = tuple(Place("", _pass_name(p, _common(paths))) for p in paths)
    order = order_of(names, lone, exif, sizes, kind, tuning)
    return Layout(lone, ("",), replace(order, why=f"{order.why}; {why}") if why else order)


def _by_camera_level(
    names: Sequence[str],
    exif: Sequence[Exif],
    inside: Sequence[int],
    kind: str,
    cameras: tuple[int, ...],
    tuning: FoldersTuning,
) -> tuple[list[Place], str]:
    """Places of the images ``inside``, None if no level of folders is one of cameras, and why."""
    paths = [PurePosixPath(names[k]).parts[:-1] for k in inside]
    common = _common(paths)
    shots = [(PurePosixPath(names[k]).stem, exif[k]) for k in inside]
    level, why = _camera_level([p[common:] for p in paths], shots, kind, cameras, tuning)
    if level is None:
        return [], why
    at = common + level
    rest = [p[:at] + p[at + 1 :] for p in paths]
    shared = _common(rest)
    return [Place(p[at], _pass_name(r, shared)) for p, r in zip(paths, rest)], why


def _camera_level(
    tails: Sequence[tuple[str, ...]],
    shots: Sequence[tuple[str, Exif]],
    kind: str,
    cameras: tuple[int, ...],
    tuning: FoldersTuning,
) -> tuple[int | None, str]:
    depth = min(len(t) for t in tails)
    if kind in ("sequence", "loose") or depth == 0:
        return None, ""
    levels = [sorted({t[k] for t in tails}) for k in range(depth)]
    if kind == "passes":
        return depth - 1, "camera folders below pass folders, by the layout setting"
    if kind == "cameras":
        return 0, "camera folders at the top, by the layout setting"
    fitting = [k for k in range(depth) if len(levels[k]) in cameras]
    if len(fitting) == 1:
        return fitting[0], f"the folders {_some(levels[fitting[0]])} are as many as the rig has cameras"
    likeness = [sum(map(is_camera, level)) / len(level) for level in levels]
    best = max(range(depth), key=lambda k: (likeness[k], k))
    if likeness[best] >= 0.5 and (len(levels[best]) > 1 or depth > 1):
        return best, f"the folders {_some(levels[best])} are named like cameras"
    return _camera_level_by_structure(tails, shots, levels, tuning)


def _camera_level_by_structure(
    tails: Sequence[tuple[str, ...]],
    shots: Sequence[tuple[str, Exif]],
    levels: list[list[str]],
    tuning: FoldersTuning,
) -> tuple[int | None, str]:
    uniform = len({len(t) for t in tails}) == 1
    if uniform and len(levels) == 1 and len(levels[0]) > 1:
        likeness = sum(bool(words(f) & _PASS_WORDS) for f in levels[0]) / len(levels[0])
        groups = [{s: e for t, (s, e) in zip(tails, shots) if t[0] == f} for f in levels[0]]
        shared = set.intersection(*map(set, groups))
        if likeness < 0.5 and len(shared) >= 0.5 * min(map(len, groups)):
            equal = f"the folders {_some(levels[0])} have equal file names"
            apart = _apart([[g[s] for s in sorted(shared)] for g in groups], tuning)
            if apart:
                return None, f"{equal}, but {apart}: no cameras of a rig (if they are, give --scan.layout cameras)"
            return 0, equal
    if uniform and len(levels) == 2:
        below = [{t[1] for t in tails if t[0] == f} for f in levels[0]]
        if len(below) > 1 and len(below[0]) > 1 and all(b == below[0] for b in below):
            return (
                1,
                f"each of the folders {_some(levels[0])} has the folders {_some(levels[1])}",
            )
    return None, ""


def _apart(groups: Sequence[Sequence[Exif]], tuning: FoldersTuning) -> str:
    """Why EXIF excludes that images of one name in several folders were taken together; "" if it does not."""
    first = groups[0]
    for other in groups[1:]:
        both = [(a, b) for a, b in zip(first, other) if np.isfinite([a.lat_deg, b.lat_deg]).all()]
        if both:
            here = Origin(both[0][0].lat_deg, both[0][0].lon_deg, 0.0)
            ends = [
                world_from_geodetic(np.array([[e.lat_deg, e.lon_deg, 0.0] for e in side]), here) for side in zip(*both)
            ]
            metres = float(np.median(np.linalg.norm(ends[1] - ends[0], axis=1)))
            if metres > tuning.apart_m:
                return f"images of equal names are {metres:.0f} m apart"
        times = np.array([[a.time_s, b.time_s] for a, b in zip(first, other)])
        times = times[np.isfinite(times).all(axis=1)]
        if len(times):
            between = times[:, 1] - times[:, 0]
            scatter = float(np.median(np.abs(between - np.median(between))))
            if scatter > tuning.apart_s:
                return f"the time between images of equal names differs by {scatter:.0f} s"
            after = times[:, 0].min() > times[:, 1].max() or times[:, 1].min() > times[:, 0].max()
            if after and _regular_times(times[:, 0].tolist(), tuning):  # irregular and equal: one trigger, two clocks
                return "one folder was taken after the other"
    return ""


def _some(names: Sequence[str]) -> str:
    return some(sorted(names, key=natural), 6)


def order_of(
    names: Sequence[str],
    places: Sequence[Place | None],
    exif: Sequence[Exif],
    sizes: Sequence[tuple[int, int]],
    kind: str,
    tuning: FoldersTuning,
) -> Order:
    """Whether images of one camera are loose photographs rather than sequences.

    Only the user's statement proves a sequence: a camera that numbers its pictures and a photographer with a steady
    hand produce equal steps too.
    """
    if kind in ("loose", "sequence", "passes", "cameras"):
        word = "loose photographs" if kind == "loose" else "a sequence of one camera"
        return Order(kind == "loose", f"{word}, by the layout setting")
    passes = len({p.sequence for p in places if p})
    if kind == "video":
        return Order(False, f"videos of one camera each, {passes} pass(es)")
    as_sequence = f"a sequence of one camera in {passes} pass(es), if the images confirm it"
    if len(names) < tuning.few:
        return Order(True, f"loose photographs: fewer than {tuning.few}, so their order does not matter")
    if len({(e.make, e.model, *s) for e, s in zip(exif, sizes)}) > 1:
        return Order(True, "loose photographs: taken by different cameras or in different sizes")
    regular = _regular_times([e.time_s for e in exif], tuning)
    if regular is not None:
        if regular:
            return Order(False, f"{as_sequence}: taken at regular times", guessed=True)
        return Order(True, "loose photographs: taken at irregular times")
    stems = [PurePosixPath(n).stem for n in names]
    if all(_PHOTO_NAME.match(s) for s in stems):
        return Order(True, "loose photographs: numbered as a camera numbers single photographs")
    if _regular_numbers(names, tuning):
        return Order(False, f"{as_sequence}: numbered in equal steps", guessed=True)
    return Order(True, "loose photographs: neither times nor numbers show an order")


def _regular_times(times: Sequence[float], tuning: FoldersTuning) -> bool | None:
    if any(t != t for t in times):
        return None
    ordered = sorted(times)
    steps = sorted(b - a for a, b in zip(ordered, ordered[1:]))
    middle = steps[len(steps) // 2]
    play = max(tuning.play * middle, tuning.play_s)
    equal = sum(abs(s - middle) <= play for s in steps) / len(steps)
    return middle > 0 and equal >= tuning.regular if ordered[-1] > ordered[0] else None


def _regular_numbers(names: Sequence[str], tuning: FoldersTuning) -> bool:
    by_folder: dict[str, list[int]] = {}
    for name in names:
        numbers = re.findall(r"\d+", PurePosixPath(name).stem)
        if not numbers:
            return False
        by_folder.setdefault(str(PurePosixPath(name).parent), []).append(int(numbers[-1]))
    steps = [step for values in by_folder.values() for step in np.diff(sorted(values)).tolist()]
    usual, count = max(Counter(steps).items(), key=lambda item: item[1], default=(0, 0))
    return usual > 0 and count / len(steps) >= tuning.regular
