"""View-graph filtering: verified pairs that contradict the coarse model are refused.

A pair of images of the coarse model is refused if its matches lie where no surface within reach explains them
(``filter``): a wall that repeats along the path has the right rotation and the right epipolar lines, but impossible
distances. An image that contradicts most of its pairs is wrong in the model: these pairs are not judged by it. If the
model contradicts all pairs between two parts of itself, no pair confirms how these were joined, and it does not judge
them. Pairs of other images are kept. The tables of ``match`` stay complete; the mapper's copy of the database omits
refused pairs.
"""
