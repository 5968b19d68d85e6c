"""Pair source ``doubling``: each image with those of its camera 1, 2, 4, 8, ... frames on (quadratic overlap)."""

import numpy as np

from tiegraph.network.passes import Context, Proposal
from tiegraph.scene.pairs import Pairs


def propose(context: Context) -> Proposal:
    """Pairs of all passes, of each camera for itself."""
    rows = [row[row >= 0] for a_pass in context.passes for row in a_pass.images]
    steps = [np.stack([row[:-step], row[step:]]) for row in rows for step in 2 ** np.arange(len(row).bit_length())]
    i, j = np.concatenate([np.zeros((2, 0), int), *steps], axis=1)
    return Proposal(Pairs.make(i, j, "plugin"), (f"doubling: {len(i)} pairs of {len(rows)} rows of images",))
