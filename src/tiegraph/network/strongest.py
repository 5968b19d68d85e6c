"""The strongest pairs of each image, spread over cameras and passes, with a forest that holds everything together."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import minimum_spanning_tree

from tiegraph.scene.pairs import Pairs
from tiegraph.scene.scene import Scene


def strongest_pairs(pairs: Pairs, scene: Scene, per_image: int) -> Pairs:
    """The ``per_image`` best kept pairs of each image, and a maximum spanning forest by preview matches."""
    kept = pairs.kept()
    rows = np.arange(len(kept))
    chosen = np.zeros(len(kept), bool)
    chosen[_forest(kept, rows, len(scene))] = True
    chosen[_top(kept, rows, scene, per_image)] = True
    return kept.where(chosen)


def _strength(pairs: Pairs, rows: np.ndarray) -> np.ndarray:
    """Preview matches of rows; a pair that was never previewed ranks below every one that was."""
    return np.nan_to_num(pairs.score[rows].astype(float), nan=0.0)


def _forest(pairs: Pairs, rows: np.ndarray, images: int) -> np.ndarray:
    """Places in ``rows`` of a maximum spanning forest by strength."""
    strength = _strength(pairs, rows)
    cost = strength.max(initial=0.0) + 1.0 - strength  # positive: scipy takes zeros for missing edges
    graph = coo_array((cost, (pairs.i[rows], pairs.j[rows])), shape=(images, images))
    tree = minimum_spanning_tree(graph.tocsr()).tocoo()
    key = pairs.i[rows].astype(np.int64) * images + pairs.j[rows]
    low, high = np.minimum(*tree.coords).astype(np.int64), np.maximum(*tree.coords)
    return np.flatnonzero(np.isin(key, low * images + high))


def _top(pairs: Pairs, rows: np.ndarray, scene: Scene, count: int) -> np.ndarray:
    """Places in ``rows`` of the ``count`` best pairs of each image.

    An image ranks its partners round robin over their passes and cameras, the strongest of each first: by strength
    alone the next frames of the same camera would fill the list, and short bases hold a network together badly.
    """
    i, j = pairs.i[rows], pairs.j[rows]
    place = np.tile(np.arange(len(rows)), 2)
    image, partner = np.concatenate([i, j]), np.concatenate([j, i])
    strength = np.tile(_strength(pairs, rows), 2)
    sensors = len(scene.all_sensors)
    group = (scene.track[scene.frame].astype(np.int64) + 1) * sensors + scene.sensor_key
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
