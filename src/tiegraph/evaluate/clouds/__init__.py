"""Two point clouds of any size, compared: tiles with a halo, nearest distances, M3C2, registration, two epochs.

``tiles`` lays both clouds into files, cut in plan into tiles of a bounded number of points; all that follows looks at
one tile and a halo as wide as it asks for, so that the results are those of the whole clouds at once. ``nearest`` holds
the measures of ETH3D and of Tanks and Temples (accuracy, completeness, F-score, ghosts). They see the spacing of a thin
reference as an error; ``m3c2`` (Lague, Brodu, Leroux 2013) does not. It is written here and not taken from py4dgeo:
numpy and scipy do it in 6 s where that takes 21 s (1 M points a cloud, 100 000 core points, two cores), with equal
results (``tests/evaluate``), and it needs no more than the tile. ``register`` moves a cloud onto the other by ICP, if
asked, and says how well; ``m3c2`` makes of M3C2 between two epochs what has changed, ``judge`` of that between the
clouds of two passes of one run how well these agree.
"""
