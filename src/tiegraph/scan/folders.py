"""The meaning of the folders: which part of an image's path is the camera and which the pass.

Cameras that write into one folder, such as the bands of a multispectral rig, mark their files by name:
IMG_180822_133949_0205_GRE.TIF, ..._NIR.TIF (Parrot Sequoia), IMG_0001_1.tif ... _5.tif (MicaSense), ..._MS_RE.TIF
(DJI); 0001_left.png, image_camera07.jpg, cam1_0001.jpg. The mark is the camera, the rest the shot; the folder of the
camera is then written "*_GRE" or "cam1_*".
"""

import os
import re
from collections import Counter, defaultdict
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import PurePosixPath

import numpy as np

from tiegraph.geometry.geodesy import Origin, world_from_geodetic
from tiegraph.geometry.transforms import rigid
from tiegraph.scan.rigfiles.rigspec import RigSpec
from tiegraph.scan.tuning import FoldersTuning
from tiegraph.scene.exif import Exif, relative_rotation
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
_REGULAR = 0.9  # share of equal steps in the numbers, or in the times, of a sequence


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
        own, at = next(found, ((), 0))
        marked = ((p, without[0]) for p in patterns if (without := _without_mark(name, p)))
        if own:
            places.append(("/".join(own), parts[:at] + parts[at + len(own) :]))
        else:
            places.append(next(marked, ("", parts) if "" in folders else None))
    passes = iter(_pass_names([p[1] for p in places if p is not None]))
    return [p and Place(p[0], next(passes)) for p in places]


def is_pattern(folder: str) -> bool:
    """Whether a sensor's folder is a pattern of file names, "*_GRE" or "left_*": cameras that write into one folder."""
    return folder.startswith("*") or folder.endswith("*")


def _without_mark(name: str, pattern: str) -> tuple[tuple[str, ...], str] | None:
    """Folders and stem of an image without what the pattern of its camera says; None if the pattern does not fit."""
    path = PurePosixPath(name)
    if pattern.startswith("*"):
        mark = pattern[1:].lower()
        fits = mark and path.stem.lower().endswith(mark)
        return (path.parts[:-1], path.stem[: -len(mark)]) if fits else None
    begin = pattern.removesuffix("*")
    stem = path.stem.removeprefix(begin.rpartition("/")[2])
    if name.startswith(begin):
        return PurePosixPath(name[len(begin) :]).parts[1:-1], stem
    return (path.parts[:-1], stem) if path.name.startswith(begin) else None


def shot_stem(name: str, folder: str) -> str:
    """Stem of an image's file name without the mark of its camera, by the pattern."""
    marked = _without_mark(name, folder) if is_pattern(folder) else None
    return marked[1] if marked else PurePosixPath(name).stem


def _pass_names(paths: Sequence[tuple[str, ...]]) -> list[str]:
    """Pass of each image: its folders without those that all share; for a single pass the last specific one."""
    common = len(os.path.commonprefix(list(paths)))
    telling = [p for p in paths[0][:common] if not words(p) & _GENERIC_WORDS] if paths else []
    return ["/".join(p[common:]) or [LONE_PASS, *telling][-1] for p in paths]


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
    inside = [k for k, p in enumerate(paths) if len(p) == depth or count < 0.75 * len(paths)]
    inner, why = _by_camera_level(names, exif, inside, kind, cameras)
    if not inner and len(inside) < len(names):
        inside = list(range(len(names)))
        inner, why = _by_camera_level(names, exif, inside, kind, cameras)
    if inner:
        places: list[Place | None] = [None] * len(names)
        for k, place in zip(inside, inner):
            places[k] = place
        folders = tuple(sorted({p.folder for p in inner}, key=natural))
        passes = len({p.sequence for p in inner})
        return Layout(tuple(places), folders, Order(False, f"{len(folders)} cameras, {passes} pass(es): {why}"))
    lone = tuple(Place("", name) for name in _pass_names(paths))
    order = order_of(names, lone, exif, sizes, kind, tuning)
    return Layout(lone, ("",), replace(order, why=f"{order.why}; {why}") if why else order)


def _by_camera_level(
    names: Sequence[str], exif: Sequence[Exif], inside: Sequence[int], kind: str, cameras: tuple[int, ...]
) -> tuple[list[Place], str]:
    """Places of the images ``inside``, None if no level of folders is one of cameras, and why."""
    paths = [PurePosixPath(names[k]).parts[:-1] for k in inside]
    common = len(os.path.commonprefix(paths))
    shots = [(PurePosixPath(names[k]).stem, exif[k]) for k in inside]
    level, why = _camera_level([p[common:] for p in paths], shots, kind, cameras)
    if level is None:
        return [], why
    at = common + level
    rest = [p[:at] + p[at + 1 :] for p in paths]
    return [Place(p[at], name) for p, name in zip(paths, _pass_names(rest))], why


def _camera_level(
    tails: Sequence[tuple[str, ...]], shots: Sequence[tuple[str, Exif]], kind: str, cameras: tuple[int, ...]
) -> tuple[int | None, str]:
    """Depth of the folders of cameras in paths without their common beginning, None if there are none, and why."""
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
    return _camera_level_by_structure(tails, shots, levels)


def _camera_level_by_structure(
    tails: Sequence[tuple[str, ...]], shots: Sequence[tuple[str, Exif]], levels: list[list[str]]
) -> tuple[int | None, str]:
    uniform = len({len(t) for t in tails}) == 1
    if uniform and len(levels) == 1 and len(levels[0]) > 1:
        likeness = sum(bool(words(f) & _PASS_WORDS) for f in levels[0]) / len(levels[0])
        groups = [{s: e for t, (s, e) in zip(tails, shots) if t[0] == f} for f in levels[0]]
        shared = set.intersection(*map(set, groups))
        if likeness < 0.5 and len(shared) >= 0.5 * min(map(len, groups)):
            equal = f"the folders {_some(levels[0])} have equal file names"
            apart = _apart([[g[s] for s in sorted(shared)] for g in groups])
            if apart:
                return None, f"{equal}, but {apart}: no cameras of a rig (if they are, give --scan.layout cameras)"
            return 0, equal
    if uniform and len(levels) == 2:
        below = [{t[1] for t in tails if t[0] == f} for f in levels[0]]
        if len(below) > 1 and len(below[0]) > 1 and all(b == below[0] for b in below):
            return 1, f"each of the folders {_some(levels[0])} has the folders {_some(levels[1])}"
    return None, ""


def _apart(groups: Sequence[Sequence[Exif]]) -> str:
    """Why EXIF excludes that images of one name in several folders were taken together; "" if it does not."""
    first = groups[0]
    for other in groups[1:]:
        both = [(a, b) for a, b in zip(first, other) if np.isfinite([a.lat_deg, b.lat_deg]).all()]
        if both:
            here = Origin(both[0][0].lat_deg, both[0][0].lon_deg, 0.0)
            sides = (np.array([[e.lat_deg, e.lon_deg, 0.0] for e in side]) for side in zip(*both))
            one, two = (world_from_geodetic(side, here) for side in sides)
            metres = float(np.median(np.linalg.norm(two - one, axis=1)))
            if metres > 30:  # positions in EXIF are some metres off
                return f"images of equal names are {metres:.0f} m apart"
        times = np.array([[a.time_s, b.time_s] for a, b in zip(first, other)])
        times = times[np.isfinite(times).all(axis=1)]
        if len(times):
            between = times[:, 1] - times[:, 0]
            scatter = float(np.median(np.abs(between - np.median(between))))
            if scatter > 2:  # EXIF has whole seconds, and different clocks differ by a constant
                return f"the time between images of equal names differs by {scatter:.0f} s"
            after = times[:, 0].min() > times[:, 1].max() or times[:, 1].min() > times[:, 0].max()
            if after and _regular_times(times[:, 0].tolist()):  # irregular and equal: one trigger, two clocks
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
    regular = _regular_times([e.time_s for e in exif])
    if regular is not None:
        if regular:
            return Order(False, f"{as_sequence}: taken at regular times", guessed=True)
        return Order(True, "loose photographs: taken at irregular times")
    stems = [PurePosixPath(n).stem for n in names]
    if all(_PHOTO_NAME.match(s) for s in stems):
        return Order(True, "loose photographs: numbered as a camera numbers single photographs")
    if _regular_numbers(names):
        return Order(False, f"{as_sequence}: numbered in equal steps", guessed=True)
    return Order(True, "loose photographs: neither times nor numbers show an order")


def _regular_times(times: Sequence[float]) -> bool | None:
    """Whether times are in equal steps; None where some are missing or all are equal."""
    if np.isnan(times).any() or min(times) == max(times):
        return None
    steps = sorted(np.diff(sorted(times)).tolist())
    middle = steps[len(steps) // 2]
    play = max(0.25 * middle, 1.0)  # EXIF often has whole seconds only
    equal = sum(abs(s - middle) <= play for s in steps) / len(steps)
    return middle > 0 and equal >= _REGULAR


def _regular_numbers(names: Sequence[str]) -> bool:
    by_folder: dict[str, list[int]] = {}
    for name in names:
        numbers = re.findall(r"\d+", PurePosixPath(name).stem)
        if not numbers:
            return False
        by_folder.setdefault(str(PurePosixPath(name).parent), []).append(int(numbers[-1]))
    steps = [step for values in by_folder.values() for step in np.diff(sorted(values)).tolist()]
    usual, count = max(Counter(steps).items(), key=lambda item: item[1], default=(0, 0))
    return usual > 0 and count / len(steps) >= _REGULAR


_BANDS = frozenset(
    "gre red reg nir rgb green blue blu rededge lwir thermal tir pan panchro d ms_g ms_r ms_re ms_nir".split()
)
_CAMERA = r"left|right|front|rear|back|(?:cam|camera)_?\d+"
_END = re.compile(rf"(?i)^(?P<shot>.+?)_(?P<mark>{'|'.join(_BANDS)}|{_CAMERA}|\d{{1,2}})$")
_BEGIN = re.compile(rf"(?i)^(?P<mark>(?:{_CAMERA})[_-]?)(?P<shot>\d.*)$")
_MICASENSE = re.compile(r"(?i)^IMG_\d{4}_\d{1,2}$")


def layout_by_marks(names: Sequence[str], exif: Sequence[Exif], kind: str) -> Layout | None:
    """The layout of images whose names end in marks of bands or cameras, or begin with those of cameras; None if they
    do not. ``kind`` is ScanSettings.layout.

    Marks are names of bands, sides and numbered cameras; or mere numbers, if the files or MicaSense's naming show that
    these are cameras: photographs numbered in rows and columns look alike.
    """
    if kind != "auto":
        return None

    def end_of(k: int) -> re.Match[str] | None:
        path = PurePosixPath(names[k])
        found = _END.match(path.stem)
        tiff = path.suffix.lower() in (".tif", ".tiff")
        number = found is not None and found["mark"].isdigit()
        return found if not number or exif[k].rig.index >= 0 or (tiff and _MICASENSE.match(path.stem)) else None

    ends = _marked(names, [end_of(k) for k in range(len(names))], "*_{}")
    return ends or _marked(names, [_BEGIN.match(PurePosixPath(n).stem) for n in names], "{}*")


def _marked(names: Sequence[str], found: Sequence[re.Match[str] | None], pattern: str) -> Layout | None:
    marks = [m["mark"].lower() if m else "" for m in found]
    spelt = {mark: pattern.format(m["mark"]) for m, mark in zip(found, marks) if m}
    shots: dict[tuple[str, str], set[str]] = defaultdict(set)
    for name, match, mark in zip(names, found, marks):
        if match:
            shots[str(PurePosixPath(name).parent), match["shot"]].add(mark)
    held = sum(len(s) for s in shots.values())
    possible = max(len(names), len(shots) * len(spelt))
    if len(spelt) < 2 or len(shots) < 2 or held < 0.75 * possible:  # with less it is chance
        return None
    passes = _pass_names([PurePosixPath(n).parts[:-1] for n in names])
    places = tuple(Place(spelt[m], p) if m else None for m, p in zip(marks, passes))
    folders = tuple(spelt[m] for m in sorted(spelt, key=natural))
    side = "ends" if pattern.startswith("*") else "beginnings"
    note = f"{len(folders)} cameras that share folders, by the {side} of the file names: {_some(folders)}"
    return Layout(places, folders, Order(False, note))


def with_rig_tags(spec: RigSpec, layout: Layout, exif: Sequence[Exif], notes: list[str]) -> RigSpec:
    """A guessed rig with the values of the files (XMP): which camera is the reference, their names and rotations.

    The bands of one camera head have the same view direction; if the files give the differences, these are used.
    Cameras in folders of their own get poses only if all files have them.
    """
    tags = [[e.rig for e, p in zip(exif, layout.places) if p and p.folder == s.folder] for s in spec.sensors]
    angles = [Counter(t.relatives_deg for t in found if t.relatives_deg) for found in tags]
    told = sum(map(bool, angles))
    marks = [f.removeprefix("*_").lower() for f in layout.folders if is_pattern(f)]
    one_head = len(marks) == len(tags) and all(m in _BANDS or m.isdigit() for m in marks)
    if len(tags) < 2 or not (told == len(tags) or one_head):
        return spec
    reference = next((t.reference for found in tags for t in found if t.reference >= 0), -1)
    order = sorted(range(len(tags)), key=lambda k: not any(t.index == reference >= 0 for t in tags[k]))
    turns = [relative_rotation(angles[k].most_common(1)[0][0]) if angles[k] else np.eye(3) for k in order]
    # The band name in the files, else the mark in their names.
    named = [Counter(t.band for t in tags[k] if t.band).most_common(1) for k in order]
    names = [found[0][0] for found in named if found]
    if len(set(names)) < len(order):
        marks = [spec.sensors[k].name.lstrip("*_") for k in order]
        names = [f"band{m}" if m.isdigit() else m for m in marks]
    how = "their view directions are nominally the same"
    if told:
        how = f"the rotations of {told} of them are taken from their XMP (RigRelatives)"
        how += f", in {names[0]}" if reference >= 0 else ""
    notes.append(f"the {len(order)} cameras are one head: {how}; their relative positions come from the images")
    sensors = tuple(
        replace(spec.sensors[k], name=name, body_from_sensor=rigid(turns[0].T @ turn, np.zeros(3)))
        for k, name, turn in zip(order, names, turns)
    )
    return replace(spec, sensors=sensors, nominal=True)
