"""Tracks of the design where wrong matches join what does not belong together."""

from __future__ import annotations

import numpy as np

from tiegraph.design.tracks import Candidates, Tracks
from tiegraph.design.tuning import NetTuning
from tiegraph.scene.matches import PreviewMatches

FEATURES = 6
TUNING = NetTuning()


def chained(images: int) -> Tracks:
    """Every image ties with the next by all its features, and one wrong match a pair makes one track of two."""
    i, j = np.arange(images - 1), np.arange(1, images)
    right = np.stack([np.arange(FEATURES)] * 2, axis=1)
    matches = np.tile(np.concatenate([right[1:], [[0, 1]]]), (images - 1, 1))
    start = FEATURES * np.arange(images)
    candidates = Candidates.make(i, j, np.full(len(i), 9.0), PreviewMatches(i, j, start, matches), images)
    tracks = Tracks(candidates, TUNING)
    tracks.join(np.arange(len(i)))
    return tracks


def test_one_wrong_track_does_not_link_all_images() -> None:
    images = 4 * TUNING.wide_images
    tracks = chained(images)
    assert np.bincount(tracks.parent).max() > 1.9 * images  # two features of every image in one
    joint = tracks.joint()
    assert 2 * images < joint.nnz <= images * TUNING.wide_images  # and not the square of the images
    apart = np.abs(np.subtract(*joint.nonzero()))
    assert apart.max() < TUNING.wide_images


def test_small_surveys_keep_every_link() -> None:
    images = TUNING.wide_images - 10
    tracks = chained(images)
    seen = tracks.incidence()
    count = np.zeros((images, len(tracks.parent)))
    image = np.repeat(np.arange(images), np.diff(tracks.candidates.first))
    np.add.at(count, (image, tracks.parent), 1.0)
    count = count[:, count.sum(axis=0) >= 2]
    assert seen.shape == count.shape and seen.nnz == np.count_nonzero(count)
    np.testing.assert_array_equal(tracks.joint().toarray(), count @ count.T)
