"""A hundred thousand images by simulation: what each stage up to the design costs, and whether blocks can be joined.

``stages``: the program's own stages on a simulated canal, each in a process of its own; only what needs pixels
(previews, their matches, COLMAP's mapper of a block) is replaced (``standin``).
``hierarchy``: a closed way of 10 000 frames in blocks, each adjusted by itself, joined, and held by positions with
outages.
"""
