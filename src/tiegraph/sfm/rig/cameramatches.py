"""Whether the matches between two cameras of a rig agree with the model, beside those of each camera with itself.

A mapper that holds a rig splits the points that contradict it, or leaves them out: what is left of two cameras that
fire apart fits to a tenth of a pixel, and only their verified matches still tell (rendered vehicle, 0.5 m apart along
the way: 46 and 65 % of the matches between them agree with the model in two runs, 99 % of each camera's own).
"""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tiegraph.scene.scene import Scene
from tiegraph.sfm.tuning.rig import CameraMatchesTuning
from tiegraph.sfm.verified import ImageObservations, VerifiedMatches, rays_meet


@dataclass(frozen=True)
class CameraMatches:
    """Two cameras (keys, from 0) of one rig, image pairs with an opinion, the shares of matches that agree: between the
    two, and the smaller of each with itself; whether the matches between them want another rig, or other times."""

    first: int
    second: int
    pairs: int
    between: float
    own: float
    contradicted: bool


def camera_matches(
    verified: VerifiedMatches, seen: ImageObservations, scene: Scene, tuning: CameraMatchesTuning
) -> list[CameraMatches]:
    """All two cameras of one rig that enough pairs of images tie, against the poses of a model."""
    explained = rays_meet(verified, seen)
    told = explained[:, 1] > 0
    rows, explained = verified.pairs[told], explained[told]
    cameras = np.sort(scene.sensor_key[rows], axis=1).reshape(-1, 2)
    rigs = scene.rig[scene.frame[rows]].reshape(-1, 2)
    share = {}
    for pair in np.unique(cameras[rigs[:, 0] == rigs[:, 1]], axis=0):
        of = (cameras == pair).all(axis=1)
        if of.sum() >= tuning.min_pairs:
            agree, all_ = explained[of].sum(axis=0)
            share[int(pair[0]), int(pair[1])] = (int(of.sum()), float(agree / all_))
    out = []
    for (a, b), (count, between) in share.items():
        if a != b and (a, a) in share and (b, b) in share:
            own = min(share[a, a][1], share[b, b][1])
            contradicted = 1 - between > max(tuning.contradicted, tuning.times * (1 - own))
            out.append(
                CameraMatches(first=a, second=b, pairs=count, between=between, own=own, contradicted=contradicted)
            )
    return out


def table(found: Sequence[CameraMatches], scene: Scene) -> dict:
    """Table of the receipt, its own verdict in the last column."""
    names = [s.name for s in scene.all_sensors]
    columns = ["camera", "camera", "image pairs", "agree between %", "agree within %", "verdict"]
    rows = [
        [names[t.first], names[t.second], t.pairs, round(100 * t.between, 1), round(100 * t.own, 1),
         "contradicts the model" if t.contradicted else ""]
        for t in found
    ]  # fmt: skip
    return {"columns": columns, "rows": rows}


def sentence(found: Sequence[CameraMatches], scene: Scene) -> list[str]:
    """One sentence on all that contradict, the worst named; none where nothing does. Views of one panorama cannot."""
    stitched = [rig.stitched() for rig in scene.rigs for _ in rig.sensors]
    bad = sorted((t for t in found if t.contradicted and not stitched[t.first]), key=lambda t: t.between)
    if not bad:
        return []
    names = [s.name for s in scene.all_sensors]
    worst, rest = bad[0], len(bad) - 1
    others = f" (and {rest} more)" if rest else ""
    return [
        f"ties between {names[worst.first]} and {names[worst.second]}{others}: {worst.between:.0%} of them agree with "
        f"the model, of each camera's own {worst.own:.0%}; cameras of the rig fire apart, or stand otherwise than the "
        "model has them"
    ]
