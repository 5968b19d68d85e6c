"""The unit of a rough model against that of its rig: how long its rig's lever arms really are.

A rig of known extrinsics gives a model its unit, but only through ties between its cameras. Where these are few, a
mapper may settle on another one: points that two cameras share then lie far off or nowhere, and drop out. Rotations and
epipolar planes stay right; the places of the cameras in their frames are wrong, and with them every distance. On
PandaSet, whose car mostly stands still, the preview model was 16 times too large for its rig.
"""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np

from tiegraph.geometry import transforms
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.scene import Scene
from tiegraph.verify.bearings import Calibration
from tiegraph.verify.prior import MIN_SHARE, Prior, agreement

DOUBT = 0.1  # share of the pairs between cameras of a rig that contradict, from which the unit is looked into
SAMPLE = 80  # of these pairs
FACTORS = np.geomspace(1 / 32, 32, 31)
GAIN = 2.0  # so many times fewer contradictions, or the unit is left alone


def in_unit_of_rig(
    scene: Scene, pairs: Pairs, share: np.ndarray, database: str, prior: Prior, run_map: Callable[..., list[Any]]
) -> tuple[Prior, str]:
    """The prior with its rigs' lever arms stretched so that ties between cameras agree with it, and a note.

    ``share`` (P,): agreement of the pairs with the prior as it is, NaN = not judged. The same prior and no note where
    most of them agree, or no factor makes them.
    """
    across = np.flatnonzero(np.isfinite(share) & (scene.sensor_key[pairs.i] != scene.sensor_key[pairs.j]))
    wrong = float(np.mean(share[across] < MIN_SHARE)) if len(across) else 0.0
    if wrong < DOUBT:
        return prior, ""
    some = across[np.unique(np.linspace(0, len(across) - 1, SAMPLE).round().astype(int))]
    items = [(int(pairs.i[k]), int(pairs.j[k])) for k in some]
    lone = Calibration.of(scene, by_frame=False)
    tried = [stretched(prior, scene, float(f)) for f in FACTORS]
    agree = np.array([run_map(agreement, items, database, lone, p) for p in tried])
    best = int(np.argmax(np.nan_to_num(agree).mean(axis=1)))
    if GAIN * np.mean(agree[best] < MIN_SHARE) > np.mean(share[some] < MIN_SHARE):
        return prior, ""
    said = (
        f"the preview model is {FACTORS[best]:.2g} times as large as its rig makes it: {100 * wrong:.0f} % of the "
        f"pairs between its cameras would contradict; verified with lever arms as long as these pairs say"
    )
    return tried[best], said


def stretched(prior: Prior, scene: Scene, factor: float) -> Prior:
    """The prior with its images ``factor`` times as far from the middle of their frames."""
    known = np.flatnonzero(np.isfinite(prior.cam_from_world).all(axis=(1, 2)))
    frame, centre = scene.frame[known], transforms.centre(prior.cam_from_world[known])
    number = np.maximum(np.bincount(frame, minlength=scene.frames), 1)
    middle = np.stack([np.bincount(frame, c, scene.frames) for c in centre.T], axis=1) / number[:, None]
    moved = middle[frame] + factor * (centre - middle[frame])
    rotation = prior.cam_from_world[known, :3, :3]
    poses = prior.cam_from_world.copy()
    poses[known] = transforms.rigid(rotation, -np.einsum("kab,kb->ka", rotation, moved))
    return Prior(poses, prior.reach)
