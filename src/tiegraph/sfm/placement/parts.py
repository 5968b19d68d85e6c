"""What is in doubt is placed anew: a part that stands wrong as a whole by one similarity, single frames by themselves.

A section that slid, or a model that tore, is right within. Its matches with the others, of which either side has points
of its own, tell how it stands to these. Placed frame by frame it would be lost beyond what the others see: of 90 frames
of a corridor, torn in the middle, 18 found no place.
"""

from dataclasses import replace

import numpy as np
import pycolmap

from tiegraph.geometry import transforms
from tiegraph.geometry.align import Similarity
from tiegraph.scene.colmapmodel import matrix, rigid3d
from tiegraph.scene.scene import Scene
from tiegraph.sfm.placement.doubtful import Explained, explained, frame_ids
from tiegraph.sfm.ties import find_ties, fit_ties, tested, together
from tiegraph.sfm.tuning.placement import PlacementTuning
from tiegraph.sfm.verified import ImageObservations, VerifiedMatches


def placed_anew(
    model: pycolmap.Reconstruction, scene: Scene, verified: VerifiedMatches, tuning: PlacementTuning
) -> tuple[dict[int, pycolmap.Rigid3d], list[int]]:
    """Of the frames in doubt, by COLMAP's ids, new poses of those that move, and those that have no place by which to
    go. None is taken out if these are the larger half (a rig that is wrong): the others are nothing to lean on."""
    found = explained(model, scene, verified, tuning)
    moves = part_moves(found, tuning)
    poses = {
        k: _moved(pose, move)
        for f, move in moves.items()
        for k in frame_ids(model, scene, f)
        if (pose := model.frame(k).rig_from_world) is not None
    }
    left = found.doubts.keys() - moves.keys()
    few = 2 * len(left) <= len({int(scene.frame[k]) for k in found.seen.cameras})
    return poses, [k for f in sorted(left) for k in frame_ids(model, scene, f)] if few else []


def part_moves(found: Explained, tuning: PlacementTuning) -> dict[int, Similarity]:
    """By frame (scene index) of parts in doubt the similarity that their matches to the others hold; the part that most
    do first, and then others onto it."""
    placed = {int(found.scene.frame[k]) for k in found.seen.cameras}
    parts = [tuple(placed - found.doubts.keys()), *(part for part in found.parts if len(part) > 1)]
    seen, move = [_alone(found.seen, part) for part in parts], {0: Similarity()}
    while True:
        fits = {}
        for k in set(range(len(parts))) - move.keys():
            ties = together([find_ties(seen[n], seen[k], found.verified, tuning).moved(s) for n, s in move.items()])
            fit = fit_ties(ties, tuning)
            if fit is not None and tested(ties, fit, tuning).holds(tuning):
                fits[k] = fit
        if not fits:
            return {f: s for k, s in move.items() if k for f in parts[k]}
        best = max(fits, key=lambda k: int(fits[k].agree.sum()))
        move[best] = fits[best].first_from_second


def steps_of_parts(found: Explained, tuning: PlacementTuning) -> dict[int, np.ndarray]:
    """By frame (scene index) of parts in doubt how far away (3,) their matches to the others have them, model units."""
    order = sorted(found.seen.cameras, key=lambda k: -int(found.scene.sensor[k]))  # the reference is written last
    first = {int(found.scene.frame[k]): transforms.centre(found.seen.cam_from_world[k]) for k in order}
    return {f: move(first[f][None])[0] - first[f] for f, move in part_moves(found, tuning).items()}


def _alone(seen: ImageObservations, frames: tuple[int, ...]) -> ImageObservations:
    """The images of some frames, with the points that no others see."""
    inside = set(frames)
    own = {k for k in seen.cameras if seen.frame[k] in inside}
    shared = np.zeros(len(seen.xyz) + 1, bool)  # the last: no point
    for k in seen.cameras.keys() - own:
        shared[seen.point[k]] = True
    shared[-1] = True
    point = {k: np.where(shared[seen.point[k]], -1, seen.point[k]) for k in own}
    return replace(seen, point=point, cam_from_world={k: seen.cam_from_world[k] for k in own})


def _moved(rig_from_world: pycolmap.Rigid3d, move: Similarity) -> pycolmap.Rigid3d:
    pose = transforms.invert(matrix(rig_from_world))
    return rigid3d(transforms.invert(transforms.rigid(move.rotation @ pose[:3, :3], move(pose[None, :3, 3])[0])))
