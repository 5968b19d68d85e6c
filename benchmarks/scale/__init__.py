"""A hundred thousand images by simulation: what each stage up to the design costs.

``stages``: the program's own stages on a simulated canal, each in a process of its own; only what needs pixels
(previews, their matches, COLMAP's mapper of a block) is replaced (``standin``).
"""
