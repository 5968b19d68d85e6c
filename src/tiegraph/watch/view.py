"""What the page draws, seen from above: levelled by the cameras, turned by positions if there are some; and the page
itself, for browsers of this machine alone."""

import json
from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from tiegraph.geometry import transforms
from tiegraph.geometry.gravity import levelled
from tiegraph.geometry.transforms import level_umeyama, robust_umeyama
from tiegraph.scene.pairs import PreviewMatches
from tiegraph.scene.scene import Scene

_WIDE = 0.2  # of the length of the positions' extent: from this width on they tell all seven unknowns
_LEAST_POSITIONS = 3  # a similarity in the plan has four unknowns, and one is to contradict


def plan_from_world(cam_from_world: np.ndarray, scene: Scene) -> tuple[np.ndarray, float]:
    """(4, 4) rotation, scale and shift into the plan (x right, y up the page, z height), and its scale.

    With measured positions of three frames and more, in metres and with north up; else the path lies along x and the
    unit stays. Positions that lie along a line do not tell its roll: there the cameras say what is up.
    """
    plan = levelled(cam_from_world, scene.frame)
    placed = np.isfinite(cam_from_world).all(axis=(1, 2))
    frames, centre = scene.frame[placed], transforms.centre(cam_from_world[placed])
    known = scene.measured_positions()[frames] & scene.metric_positions()
    here, there = transforms.apply(plan, centre)[known], scene.world_from_rig[frames[known], :3, 3]
    if len(here) < _LEAST_POSITIONS or not min(np.ptp(p[:, :2], axis=0).max() for p in (here, there)) > 0:
        return plan, 1.0
    sigma = np.nan_to_num(scene.position_sigma_m[frames[known]], nan=1.0)
    spread = np.linalg.svd(there - there.mean(axis=0), compute_uv=False)
    wide = len(there) > _LEAST_POSITIONS and spread[1] > _WIDE * spread[0]
    fit, _ = robust_umeyama(here, there, np.linalg.norm(sigma, axis=1)) if wide else level_umeyama(here, there, sigma)
    return fit.matrix @ plan, fit.scale


def path_and_ties(
    scene: Scene, ties: PreviewMatches, places: np.ndarray, modelled: np.ndarray, least: int, most: int
) -> dict[str, Any]:
    """Frames with their places in the plan and ties between frames, for the page; images that are not tied, by name.

    places (N, 3) of the images, NaN = no pose; modelled (N,): by the coarse model and not by resection; ``least``
    matches of a tie; ``most`` ties drawn, the strongest first.
    """
    where = np.full((scene.frames, 2), np.nan)
    by_model = np.zeros(scene.frames, bool)
    for image in np.flatnonzero(np.isfinite(places[:, 0]))[::-1]:
        where[scene.frame[image]] = places[image, :2]
        by_model[scene.frame[image]] = modelled[image]
    count = ties.counts()
    tied = count >= least
    i, j, count = ties.i[tied], ties.j[tied], count[tied]
    degree = np.bincount(np.concatenate([i, j]), minlength=len(scene))
    low, high = np.minimum(scene.frame[i], scene.frame[j]), np.maximum(scene.frame[i], scene.frame[j])
    between = low != high
    pair, at = np.unique(low[between].astype(np.int64) * scene.frames + high[between], return_inverse=True)
    total = np.bincount(at, count[between], len(pair))
    strongest = np.argsort(-total, kind="stable")[:most]
    return {
        "frames": [
            [*rounded(where[k]), int(by_model[k]), int(scene.sequence[k]), scene.frame_names[k]]
            for k in np.lexsort((scene.sequence_index, scene.sequence))
            if np.isfinite(where[k]).all()
        ],
        "ties": [
            [*rounded(where[a]), *rounded(where[b]), int(total[k])]
            for k, a, b in zip(strongest, pair[strongest] // scene.frames, pair[strongest] % scene.frames)
            if np.isfinite(where[[a, b]]).all()
        ],
        "tied_pairs": int(tied.sum()),
        "untied": [name for name, number in zip(scene.names, degree) if number == 0],
    }


def rounded(values: Sequence[float] | np.ndarray) -> list[float]:
    """Numbers of a page: five digits."""
    return [float(f"{v:.5g}") for v in values]


_PAGE = Path(__file__).with_name("page.html")
_HOLE = "/*STATE*/null"  # in the page; a page that is kept has its data here and asks nobody


def page(state: dict[str, Any] | None) -> bytes:
    """The page; with a state, one that shows it without a server."""
    text = _PAGE.read_text(encoding="utf-8")
    if state is not None:
        text = text.replace(_HOLE, json.dumps(state).replace("<", "\\u003c"))
    return text.encode()
