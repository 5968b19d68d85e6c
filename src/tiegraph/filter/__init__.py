"""View-graph filtering: verified pairs that contradict the coarse model, or the rotations all others agree on, go.

A pair of images of the coarse model is refused if its matches lie where no surface within reach explains them
(``filter``): a wall that repeats along the way has the right rotation and the right epipolar lines, but impossible
distances. An image that it contradicts in most of its pairs it has at a wrong place: these pairs it does not judge.
An image that sees too few points to tell distances (an up camera below a bridge) is judged by the place that its rig
gives it, at any distance. Where it contradicts all pairs between two parts of itself, no pair bears out how it has put
these together, and it does not judge them. Pairs that the model does not know are judged by loops of rotations
(``loops``). The tables of ``match`` stay complete; the mapper's copy of the database leaves refused pairs out.
"""
