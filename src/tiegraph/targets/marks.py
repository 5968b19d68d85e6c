"""From targets seen in images to marks of the points of a control point file, and what is odd about them."""

from collections import Counter, defaultdict
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.scene.control import TargetMark
from tiegraph.scene.rig import on_plane
from tiegraph.scene.targets import Target, count_of, families
from tiegraph.targets.detect import Seen, centre_of
from tiegraph.text import some

OTHERS = (
    "apriltag_16h5", "apriltag_25h9", "apriltag_36h10", "apriltag_36h11",
    "4x4_1000", "5x5_1000", "6x6_1000", "7x7_1000", "aruco_original", "aruco_mip_36h12",
)  # fmt: skip
"""Families that hold all others."""


@dataclass(frozen=True)
class TargetMarks:
    """The marks of named targets, and what is to be said."""

    marks: tuple[TargetMark, ...] = ()
    notes: tuple[str, ...] = field(default_factory=tuple)


def marks_of(
    seen: Mapping[int, Sequence[Seen]],
    named: Mapping[str, Target],
    camera_of: Callable[[int], pycolmap.Camera | None],
    names: Sequence[str],
) -> TargetMarks:
    """Marks of the targets ``named`` in a file, of what was ``seen`` by scene index; ``names`` of the images.

    A target at two places of one image was printed twice: it is not used at all.
    """
    by_target: dict[Target, dict[int, list[Seen]]] = defaultdict(lambda: defaultdict(list))
    for image, found in seen.items():
        for one in found:
            by_target[one.target][image].append(one)
    marks, notes = [], []

    def apart(found: Sequence[Seen]) -> bool:
        """Whether a target is at two places, and not at one with two outlines."""
        first = found[0].corners
        side = float(np.linalg.norm(first[1] - first[0]))
        return any(np.linalg.norm((s.corners - first).mean(axis=0)) > side / 2 for s in found[1:])

    for name, target in named.items():
        places = by_target.pop(target, {})
        twice = [k for k, found in places.items() if apart(found)]
        if twice:
            more = f" and of {len(twice) - 1} more" if len(twice) > 1 else ""
            text = f"target {name} is seen at two places of {names[twice[0]]}{more}: printed twice? It is not used"
            notes.append(text)
            continue
        if not places:
            notes.append(f"target {name} is seen in none of {len(seen)} images")
        elif len(places) == 1:
            only = names[next(iter(places))]
            notes.append(f"target {name} is seen in one image only, {only}: two are needed for a place")
        for k, found in places.items():
            best = min(found, key=lambda s: s.sigma_px)
            x, y = centre_of(best.corners, camera_of(k))
            if np.isfinite([x, y, best.sigma_px]).all():
                marks.append(
                    TargetMark(name=name, image=k, xy=(float(x), float(y)), sigma_px=float(best.sigma_px / np.sqrt(2)))
                )
    notes += _not_named(by_target)
    return TargetMarks(tuple(marks), tuple(notes))


def _not_named(by_target: Mapping[Target, Mapping[int, Sequence[Seen]]]) -> list[str]:
    """Targets that the file does not name, seen in two images at least: one may be gravel."""
    others = {t: len(places) for t, places in by_target.items() if len(places) > 1}
    if not others:
        return []
    shown = some((f"{t.name} ({count} images)" for t, count in sorted(others.items())))
    return [f"targets that are seen and not named in the file: {shown}"]


def likely_family(seen: Sequence[Seen]) -> str:
    """What was seen of other families, in words; "" if nothing twice."""
    count = Counter(s.target.family for s in seen)
    family, number = count.most_common(1)[0] if count else ("", 0)
    if number < 2:
        return ""
    largest = max(s.target.number for s in seen if s.target.family == family)
    size = family.partition("_")[0]
    if family.endswith("_1000"):
        fits = [n for n in families() if n.startswith(f"{size}_") and count_of(n) > largest]
        family = min(fits, key=count_of)
    return f"{Target(family, largest).name.partition(':')[0]} (seen {number} times)"


def seen_in(
    views: Mapping[int, tuple[np.ndarray, pycolmap.Camera]], place: np.ndarray
) -> dict[int, tuple[float, float]]:
    """Pixels at which images, by index, see a place (3,), the most central first; what hides it is not asked for.

    ``views``: cam_from_world (4, 4) and camera of each.
    """
    found = {}
    for k, (pose, camera) in views.items():
        there = transforms.apply(pose, place[None])[0]
        if not np.isfinite(there).all() or there[2] <= 0:
            continue
        xy = camera.img_from_cam(there)
        if xy is None or not np.isfinite(xy).all():
            continue
        size = np.array([camera.width, camera.height])
        inside = ((np.ravel(xy) >= 0) & (np.ravel(xy) <= size)).all()
        # On the plane z = 1, between a ray and the way there and back: lenses fold beyond their images
        if inside and np.abs(on_plane(camera, np.ravel(xy)[None])[0] - there[:2] / there[2]).max() < 1e-3:
            found[k] = (float(xy[0]), float(xy[1]))
    middle = {k: np.linalg.norm(np.array(xy) / (views[k][1].width, views[k][1].height) - 0.5)
              for k, xy in found.items()}  # fmt: skip
    return dict(sorted(found.items(), key=lambda item: (round(float(middle[item[0]]), 6), item[0])))
