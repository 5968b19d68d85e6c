"""The rig in the model: how it is used, whether it is rigid and synchronised, and what happens when it is not.

**Sensors without ties** (``rig.unsupported_sensors``). A sensor of a refined rig most of whose images have no ties
(an up camera under the open sky) is placed as given: with a few false ties it would diverge, and no residual would
show it.

**The rig against the images** (``linear``, ``confront``). One system of equations holds times, places,
rotations and lenses; frames and points are eliminated. Hypotheses on which of them differ from the file compete. A step
too large for one linearisation frees nothing and is reported without figures. Observations that the mapper left out
because the rig was held are not in the model, so the verified matches between cameras are tested too (``diagnostics``).
Orders of the user are obeyed (``--sparse.rig fixed``, ``synchronised = true``); contradictions to them are reported.

**Times** (``rigcheck``, ``sfm.motion``). Cameras that certainly fire at different times get their own times: key
points are moved to the frame's instant by the motion, the rig is adjusted as one, and the same system gives the next
step, until a step is below its sigma. In the model these images are at the places where they were taken, as frames of
their own of the same rig. Lenses calibrated without distortion get distortion if that explains the images clearly
better; otherwise times and mounting would absorb it.

**Loose cameras** (``diagnostics``). The movement of each camera relative to the rig from shot to shot is a variance
component of its images' scores (``systematic``). A camera that moves visibly, or lost its observations in
the adjustment, is released from the rig: its images are separate frames, unless fewer images would then have a place.
"""
