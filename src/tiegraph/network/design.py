"""Design: which of the candidate pairs are matched at full resolution."""

from __future__ import annotations

import numpy as np
from scipy.sparse import coo_array
from scipy.sparse.csgraph import connected_components, minimum_spanning_tree

from tiegraph.network.settings import DesignSettings
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.scene import Scene


def design(pairs: Pairs, scene: Scene, settings: DesignSettings) -> Pairs:
    """The table with pairs cut (reason ``cut``) by the method of the settings; what was connected stays connected."""
    if settings.method == "all":
        return pairs
    kept = np.flatnonzero(pairs.dropped == 0)
    chosen = np.zeros(len(pairs), bool)
    chosen[kept[_forest(pairs, kept, len(scene))]] = True
    chosen[kept[_top(pairs, kept, scene, settings.pairs_per_image)]] = True
    return pairs.drop(~chosen, "cut")


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


def components(pairs: Pairs, images: int) -> np.ndarray:
    """(N,) component of every image in the graph of kept pairs, the largest is 0."""
    kept = pairs.kept()
    graph = coo_array((np.ones(len(kept)), (kept.i, kept.j)), shape=(images, images))
    labels = connected_components(graph.tocsr(), directed=False)[1]
    size = np.bincount(labels, minlength=1)
    order = np.argsort(-size, kind="stable")
    rename = np.empty(len(order), int)
    rename[order] = np.arange(len(order))
    return rename[labels]


def component_notes(pairs: Pairs, scene: Scene) -> tuple[str, ...]:
    """What falls apart: images without a pair, by name, and the components of the rest."""
    labels = components(pairs, len(scene))
    size = np.bincount(labels, minlength=1)
    notes = []
    lonely = [scene.names[k] for k in np.flatnonzero(size[labels] == 1)] if len(scene) > 1 else []
    if lonely:
        notes.append(f"{len(lonely)} images have no pair: {some(lonely)}")
    parts = np.flatnonzero(size > 1)
    if len(parts) > 1:
        named = [f"{size[k]} images with {scene.names[int(np.argmax(labels == k))]}" for k in parts]
        held = "; the frames of the rig hold them together" if _frames_connected(pairs, scene) else ""
        notes.append(f"the pairs fall into {len(parts)} components: {some(named)}{held}")
    return tuple(notes)


def _frames_connected(pairs: Pairs, scene: Scene) -> bool:
    """Whether all frames are one component, every image standing for its frame."""
    kept = pairs.kept()
    ends = scene.frame[kept.i], scene.frame[kept.j]
    graph = coo_array((np.ones(len(kept)), ends), shape=(scene.frames, scene.frames))
    return int(connected_components(graph.tocsr(), directed=False)[0]) == 1


def some(names: list[str], limit: int = 10) -> str:
    """The first names of a list, and how many more there are."""
    more = f" and {len(names) - limit} more" if len(names) > limit else ""
    return ", ".join(names[:limit]) + more
