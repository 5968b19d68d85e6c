"""The rig in the model: how it is used, whether it is rigid and synchronised, and what holds it when it is not.

**Sensors without ties** (``support``). A sensor of a refined rig most of whose images have no ties (an up camera
under the open sky) is placed as given: with a few false ties it would run off, and nothing in the error would tell.

**Rig diagnostics** (``resections``, written to ``sparse/0/rig_diagnostics.csv``). Each camera takes the step to where
the sightings of points want it that stand where the other cameras alone put them, so that it cannot confirm itself.
``diagnostics`` names cameras that scatter or stand off along the motion (``timeoffset``). A scatter counts by what its
frames make sure of (a sign test of the median at 5 %): nine frames with few points prove little.

**The rig against the images** (``linear``, ``contradicted_priors``, ``confront``). One system of equations holds times,
places, rotations, lenses and scale; frames and points are eliminated. Of all groups of unknowns the one that explains
most for its number (Bayesian information criterion) is freed, then the next, until none explains more than chance. A
step too large for one linearisation frees nothing and is reported without figures. What the mapper left out because the
rig was held is not in the model, so the verified matches between cameras are tested too (``cameramatches``): two
cameras that fire at different times fit to a tenth of a pixel, while half of their matches contradict the model. What
the user orders is kept (``--sparse.rig fixed``, ``synchronised = true``); what contradicts it is reported.

**Relaxing** (``calibrate_times``). A rig that moves is relaxed, unless fewer images would then be registered by points.
Every image becomes a frame of its own (``linear``), tied to its reference by extrinsics, time offset and a
constant, which are unknowns of the adjustment (``sfm.adjustment.timecost``). A calibrated rig keeps its rotations, and
lenses whose calibration has no distortion get some where that explains the images clearly better: otherwise offsets and
mounting take it up.
"""
