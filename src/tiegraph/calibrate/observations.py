"""What the cameras see of the board: one view for every camera and instant; and what they must see at least."""

import re
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from itertools import combinations
from pathlib import Path, PurePosixPath

import numpy as np

from tiegraph.calibrate.board import Board
from tiegraph.errors import InputError
from tiegraph.scene.graph import parts

LEAST_VIEWS = 3  # of a camera: two of a plane fix a focal length and no more
_LEAST_JOINT = 2  # instants at which two cameras see the board together: a single one may be wrong unnoticed


@dataclass(frozen=True)
class CameraImages:
    """A camera by the folder of its images: name, folder ("" = all images), COLMAP's model, width and height in
    pixels, number of images."""

    name: str
    folder: str
    model: str
    size: tuple[int, int]
    count: int


@dataclass(frozen=True)
class View:
    """What a camera sees of the board at an instant (numbers of both): ``corners`` (K,) of the board at ``xy`` (K, 2),
    COLMAP's pixels."""

    camera: int
    instant: int
    name: str
    corners: np.ndarray
    xy: np.ndarray


@dataclass(frozen=True)
class Observations:
    """All views of a calibration."""

    board: Board
    cameras: tuple[CameraImages, ...]
    views: tuple[View, ...]

    def of_camera(self, camera: int) -> "Observations":
        """One camera and its views, in which it is the first."""
        views = tuple(replace(v, camera=0) for v in self.views if v.camera == camera)
        return Observations(self.board, self.cameras[camera : camera + 1], views)

    def instants(self) -> list[int]:
        """The instants at which any camera sees the board."""
        return sorted({v.instant for v in self.views})

    def corners(self) -> np.ndarray:
        """(K,) numbers of the corners that any view has, ascending."""
        return np.unique(np.concatenate([view.corners for view in self.views]))

    def among(self, instants: Collection[int]) -> "Observations":
        """The views of these instants."""
        return replace(self, views=tuple(v for v in self.views if v.instant in instants))

    def without(self, views: Collection[str]) -> "Observations":
        """All views but those of these names."""
        return replace(self, views=tuple(v for v in self.views if v.name not in views))


def check_views(seen: Observations) -> None:
    """Raise InputError for a camera that sees the board in no image or too few, for cameras that number its corners
    differently, and for cameras that nothing ties together."""
    for number, camera in enumerate(seen.cameras):
        views = len(seen.of_camera(number).views)
        if views == 0:
            raise InputError(
                f"{camera.name}: the board was found in none of its {camera.count} images: does --board say what was "
                f"printed ({' x '.join(map(str, seen.board.counts))} {seen.board.counted}), and is the board sharp and "
                "whole in them?"
            )
        if views < LEAST_VIEWS:
            raise InputError(
                f"{camera.name}: the board was found in {views} of its {camera.count} images, and {LEAST_VIEWS} "
                "are the least: take 20 or more, near and far, tilted, in every part of the image"
            )
    if len(seen.cameras) > 1 and seen.board.turnable:
        raise InputError(
            f"a checkerboard of {seen.board.counts[0]} x {seen.board.counts[1]} inner corners looks the same after "
            "half a turn, so cameras may number its corners differently: take one with an odd and an even count, or "
            "ChArUco"
        )
    check_ties(seen)


def check_count(folder: Path, images: int) -> None:
    """Raise InputError for fewer images than views that a camera needs."""
    if 0 < images < LEAST_VIEWS:
        raise InputError(
            f"{folder}: {images} image{'s' * (images > 1)}, and a camera needs the board in {LEAST_VIEWS} at "
            "least: take 20 or more, near and far, tilted, in every part of the image"
        )


def check_one_camera(names: Sequence[str]) -> None:
    """Raise InputError for images of one folder that are numbered like those of two cameras: left01 and right01."""
    numbers: dict[str, dict[str, set[int]]] = {}  # by folder and beginning of the name
    for name in map(PurePosixPath, names):
        if found := re.fullmatch(r"(.*?)(\d+)", name.stem):
            numbers.setdefault(str(name.parent), {}).setdefault(found[1], set()).add(int(found[2]))
    for begun in numbers.values():
        for (a, one), (b, two) in combinations(sorted(begun.items()), 2):
            if len(one & two) >= LEAST_VIEWS:
                raise InputError(
                    f"images in one folder: {len(one & two)} numbers stand behind {a!r} and behind {b!r}. If two "
                    f"cameras took them, give each a folder of its own ({a.strip('_- ')}/, {b.strip('_- ')}/); if one "
                    "did, say --layout sequence"
                )


def joint_instants(seen: Observations) -> np.ndarray:
    """(C, C) number of instants at which two cameras see the board together."""
    there = np.zeros((len(seen.cameras), max(seen.instants(), default=0) + 1), int)
    for view in seen.views:
        there[view.camera, view.instant] = 1
    return there @ there.T


def check_ties(seen: Observations) -> None:
    """Raise InputError if some cameras hang together with no others, naming them."""
    a, b = np.nonzero(joint_instants(seen) >= _LEAST_JOINT)
    part = parts(a, b, len(seen.cameras))
    if part.any():
        named = " | ".join(", ".join(c.name for c, own in zip(seen.cameras, part == k) if own) for k in np.unique(part))
        raise InputError(
            f"nothing ties these cameras together: {named}. At {_LEAST_JOINT} instants or more one of each group "
            "must see the board together with one of another (a part of it will do with ChArUco and AprilGrid). Are "
            "images of one instant called alike?"
        )
