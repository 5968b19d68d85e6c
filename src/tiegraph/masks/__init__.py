"""Masks: the usable pixels for features. Sources by name, and their comparison with hand-made masks.

Source ``learnt``, the default for rigs on a path, learns platform, sky and water from the survey itself, without
labels or weights:

1. Frames between which the scene moves are chosen.
2. The platform, where edges keep their gradient direction in all frames, and what these edges enclose (``platform``).
3. Matchability: which features match in the neighbouring frame (``matchability``). Zones where none does are water if
   most level cameras show them (``waterline``). The border of the sky gives sky (``skyline``), below the black surround
   of a fisheye lens, which is masked as platform; but not where that area is narrow, because there the border ran
   down a pale wall (``learnt``).
4. Labels of the static scene. An area as bright as the sky and connected to it is no label of the scene if it hardly
   matches, or if it ends above the horizon, the lowest row of sky that several images agree on: straight ahead a
   cloud matches as a wall does, but a wall stands on the ground.
5. From these labels one table a camera over colour, brightness and texture, learnt twice. The labels of a camera
   outweigh those of the others, whose clouds look like its walls.
6. Classification of each image (``classification``): sky by pixel, by region without an edge inside and by place in the
   image, with its edge refined by a guided filter on brightness; water is what lies below the best line.

**Refinement.** Stage ``refine`` finds the water level where these lines meet the banks of the sparse model
(``waterline``), and draws the lines again from geometry. It removes sky that contains points of the model, seen in
that image or not, because sky occludes nothing (``skyline``). The platform is not learnt again. Later stages read only
the COLMAP masks; the classes are for the report and ``refine``.

**Tests before a class is masked** (``matchability``). A platform needs frames that verify motion (a rig at rest has
none). A sky whose verified matches are as near as the scene is refused, by all cameras together, and without a sky
there is no water. A sky must lie above the rest (``learnt``). Only rows where sky is searched count, so that snow or
still water below do not matter; cameras of the role ``up`` are not tested. Wires and tree tops do not refute a sky:
this takes a density of a fifth of the matches of a surface, and overexposed areas that match so densely are used.
"""

USE, SKY, WATER, EGO, OVEREXPOSED = range(5)
"""The classes of a mask; on disk is only used or not."""
NAMES = ("used", "sky", "water", "platform", "overexposed")
"""Names by number, for tables."""
