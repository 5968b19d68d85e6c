"""The rig in the model: how it is used, whether it is rigid and synchronised, and what holds it when it is not.

**Sensors without ties** (``support``). A sensor of a refined rig most of whose images have no ties (an up camera
under the open sky) is placed as given: with a few false ties it would run off, and nothing in the error would tell.

**The rig against the images** (``linear``, ``priortest``, ``confront``). One system of equations holds times, places,
rotations and lenses; frames and points are eliminated. Of all groups of unknowns the one that explains most for its
number (Bayesian information criterion) is freed, then the next, until none explains more than chance. A step too large
for one linearisation frees nothing and is reported without figures. What the mapper left out because the rig was held
is not in the model, so the verified matches between cameras are tested too (``diagnostics``): two cameras that fire
at different times fit to a tenth of a pixel, while half of their matches contradict the model. What the user orders is
kept (``--sparse.rig fixed``, ``synchronised = true``); what contradicts it is reported.

**Times** (``rigcheck``, ``sfm.motion``). Cameras that surely fire apart get their times: key points are brought to the
frame's instant by the motion, the rig is adjusted as one, and the same system tells the next step, until a step is
below its sigma. In the model they stand where they were when they fired, as frames of their own of the same rig. Lenses
whose calibration has no distortion get some where that explains the images clearly better: otherwise times and mounting
take it up.

**Loose cameras** (``diagnostics``). How far each camera strays from its place from shot to shot is a variance component
of its images' scores (``systematic.mountings``). One that strays visibly, or lost its sightings in the adjustment, is
let go of: its images stand alone, unless fewer images would then have a place.
"""
