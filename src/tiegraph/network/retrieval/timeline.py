"""All passes in a row, for the search for loops: places, cells, and frames at a distance."""

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from tiegraph.network.passes import Pass
from tiegraph.network.retrieval.vocabulary import BagsOfWords
from tiegraph.network.tuning.retrieval import LoopSearchTuning


@dataclass(frozen=True)
class Timeline:
    """All passes in a row: ``image_at[g, s]`` = image of sensor s at place g, -1 = none; of every place its pass, the
    stride of its samples and its cell; of every image its place (-1 = loose) and sensor."""

    image_at: np.ndarray  # (G, S)
    of_pass: np.ndarray  # (G,)
    rank: np.ndarray  # (G,) frame of the pass
    stride: np.ndarray  # (G,)
    cell: np.ndarray  # (G,)
    cell_pass: np.ndarray  # (C,)
    place: np.ndarray  # (N,)
    sensor: np.ndarray  # (N,)

    def sampled(self) -> np.ndarray:
        """Images of every stride-th frame."""
        images = self.image_at[self.rank % self.stride == 0]
        return np.sort(images[images >= 0])

    def stepped(self, places: np.ndarray, frames: np.ndarray) -> np.ndarray:
        """(K,) the place this number of frames (K,) later in the same pass; -1 = none."""
        there = np.clip(places + frames, 0, len(self.of_pass) - 1)
        return np.where((there == places + frames) & (self.of_pass[there] == self.of_pass[places]), there, -1)

    def moved(self, images: np.ndarray, frames: np.ndarray) -> np.ndarray:
        """(K,) the image of the same camera this number of frames (K,) later; -1 = none."""
        there = self.stepped(self.place[images], frames)
        return np.where(there >= 0, self.image_at[there, self.sensor[images]], -1)


def timeline(passes: Sequence[Pass], words: BagsOfWords, tuning: LoopSearchTuning) -> Timeline:
    """The passes in a row, sampled according to the similarity of their images."""
    sensors = max(len(p.images) for p in passes)
    length = np.array([len(p) for p in passes])
    image_at = np.full((length.sum(), sensors), -1, np.int64)
    reach = np.array([_reach(p, words, tuning) for p in passes])
    size = np.maximum(reach, -(-length.sum() // 3000))
    of_pass = np.repeat(np.arange(len(passes)), length)
    rank = np.concatenate([np.arange(n) for n in length])
    for k, p in enumerate(passes):
        image_at[of_pass == k, : len(p.images)] = p.images.T
    cells = -(-length // size)
    cell = (np.cumsum(cells) - cells)[of_pass] + rank // size[of_pass]
    place, sensor = np.full(len(words), -1, np.int64), np.zeros(len(words), np.int64)
    g, s = np.nonzero(image_at >= 0)
    place[image_at[g, s]], sensor[image_at[g, s]] = g, s
    stride = np.maximum(1, reach // tuning.strides_a_reach)[of_pass]
    cell_pass = np.repeat(np.arange(len(passes)), cells)
    return Timeline(
        image_at=image_at,
        of_pass=of_pass,
        rank=rank,
        stride=stride,
        cell=cell,
        cell_pass=cell_pass,
        place=place,
        sensor=sensor,
    )


def _reach(p: Pass, words: BagsOfWords, tuning: LoopSearchTuning) -> int:
    """Frames over which the images of a camera look alike."""
    steps = [s for s in tuning.ladder if s < len(p)]
    alike = []
    for step in steps:
        left, right = p.images[:, :-step].ravel(), p.images[:, step:].ravel()
        there = (left >= 0) & (right >= 0)
        alike.append(float(words.between(left[there], right[there]).mean()) if there.any() else 0.0)
    # A quarter of the similarity of consecutive frames above that of distant ones
    level = min(alike) + 0.25 * (alike[0] - min(alike))
    below = [s for s, value in zip(steps, alike) if value < level]
    return below[0] if below else steps[-1]
