"""The strongest pairs of each image, spread over cameras and passes."""

import numpy as np

from tiegraph.scene.graph import forest
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.scene import Scene


def strongest_pairs(pairs: Pairs, scene: Scene, per_image: int) -> Pairs:
    """The ``per_image`` best kept pairs of each image, those of following frames, and a maximum spanning forest by
    preview matches.

    Pairs that were never previewed rank last. Those of a camera's following frames are always there, for walls may
    repeat anywhere but hardly from one frame to the next: they hold a pass together (``canal`` without them, 9 pairs
    an image: torn at a bridge, 13 m).
    """
    kept = pairs.kept()
    strength = np.nan_to_num(kept.score.astype(float), nan=0.0)
    chosen = following(kept, scene)
    chosen[forest(kept.i, kept.j, strength, len(scene))] = True
    chosen[strongest_places(kept.i, kept.j, strength, scene, per_image)] = True
    return kept.where(chosen)


def following(pairs: Pairs, scene: Scene) -> np.ndarray:
    """(P,) bool: pairs of one camera's images of two frames that follow each other on a pass."""
    sequence, step = scene.sequence[scene.frame], scene.sequence_index[scene.frame]
    order = np.lexsort((step, scene.sensor_key, sequence))
    near = (sequence[order][1:] == sequence[order][:-1]) & (scene.sensor_key[order][1:] == scene.sensor_key[order][:-1])
    near &= sequence[order][1:] >= 0
    after = np.full(len(scene), -1)
    after[order[:-1][near]] = order[1:][near]
    return (after[pairs.i] == pairs.j) | (after[pairs.j] == pairs.i)


def strongest_places(i: np.ndarray, j: np.ndarray, strength: np.ndarray, scene: Scene, count: int) -> np.ndarray:
    """Places of the ``count`` best of pairs i, j (P,) of each image.

    An image ranks its partners round robin over their passes and cameras, the strongest of each first: by strength
    alone the next frames of the same camera would fill the list, and short bases hold a network together badly.
    """
    place = np.tile(np.arange(len(i)), 2)
    image, partner = np.concatenate([i, j]), np.concatenate([j, i])
    strength = np.tile(strength, 2)
    sensors = len(scene.all_sensors)
    group = (scene.sequence[scene.frame].astype(np.int64) + 1) * sensors + scene.sensor_key
    order = np.lexsort((partner, -strength, group[partner], image))
    turn = _rank(np.stack([image[order], group[partner[order]]]))
    again = np.lexsort((-strength[order], turn, image[order]))
    rank = _rank(image[order][again][None])
    return np.unique(place[order[again[rank < count]]])


def _rank(keys: np.ndarray) -> np.ndarray:
    """(K,) place of each column within its run of equal columns (R, K)."""
    n = keys.shape[1]
    first = np.ones(n, bool)
    first[1:] = np.any(np.diff(keys, axis=1) != 0, axis=0)
    return np.arange(n) - np.maximum.accumulate(np.where(first, np.arange(n), 0))
