"""Design: the candidate pairs that are matched at full resolution, by the accuracy they are expected to give.

1. The pairs that are kept under any method (``holding``): the strongest across every cut of the graph, until three
   are expected to be verified.
2. Of loose photographs with few candidates an image all are matched (``takes_all``).
3. Otherwise a greedy choice (``hybrid``): the pairs of the largest gain, effective resistance times new tracks
   (``resistance``, ``tracks``), until the predicted sigma of the positions is within the budget of that of all
   candidates (``predict``), which counts the frames of a known rig, not its images.

Pairs without known ties are previewed first (``pipeline.features``): the sources ``sequence``, ``exhaustive``
and ``file`` by themselves preview none, and method ``all`` needs none. Otherwise only a third of the candidates was
ever previewed, and the tracks of all are predicted from the points of the coarse model (``matchprediction``): the
decrease of matches with the angle between the rays and with the ratio of the distances, and the rate at which an image
detects a point at all, are fitted to the previewed pairs (``visibility.npz`` contains the coordinates of the points and
the projection centres).

A net of resistances has one unknown an image. Choosing by the bundle adjustment, with the extrinsics and intrinsics
that images share, gave a sigma 1 to 8 % better at equal pairs and no better trajectory (benchmarks/README.md); it was
removed. Paper 002's accuracy of a pair (``pipeline.design``, ``papers.fuse2014``) is passed to ``fuse2014`` as a column
of the pair table.
"""
