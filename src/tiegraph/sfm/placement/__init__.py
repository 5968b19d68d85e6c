"""The place of every frame, tested before the final adjustment.

The pass must not jump (``continuity``; the coarse model tells how long a step is, else the pass itself), and the
verified matches of a frame, also those that the mapper threw out, must agree with its pose (``verified``,
``consistency``). A frame or block that fails is left out with its reason (``doubtful``). Segments of a pass that a
jump separates never join into a block, whatever false ties connect them.

Frames were once placed again, missing ones placed by their matches or by guided matching, and images that hang on
their rig tied by it. On eleven surveys, with the repeated walls of ``canal`` among them, none placed a frame, and the
few images that were tied moved no trajectory for the better (benchmarks/README.md); they are gone.
"""
