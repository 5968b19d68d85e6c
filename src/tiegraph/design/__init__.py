"""Design: the candidate pairs that are matched at full resolution, by the accuracy they are expected to give.

``design`` keeps what holds the graph together and adds the pairs of the largest gain until the predicted sigma of the
positions is near that of all candidates; ``tracks`` has tracks, gains and that prediction. Of loose photographs with
few candidates all pairs are matched.

Pairs without known ties are previewed first (``pipeline.preview``). Where only a part of the candidates was ever
previewed, the tracks of all are predicted from the points of the coarse model (``matchprediction``).

A net of resistances has one unknown an image. Choosing by the bundle adjustment, with the extrinsics and intrinsics
that images share, gave a sigma 1 to 8 % better at equal pairs and no better trajectory (benchmarks/README.md).
"""
