"""Where the model is on the Earth: evidence, similarity, adjustment with positions and control points.

**Evidence** (``fixes``). Every row of the receiver is tied to the poses of up to four frames about its time by a cubic.
So rows between frames count, a lever arm turns with the boat, and a clock offset is the derivative of the same sum.
Until all is found sigmas are scaled by level of the stated sigma to what the residuals say, and for their correlation
in time (``positionerrors``): a float solution that wanders must not outvote a fixed one because it is written five
times a second. (Doubt beforehand, after outages and under bridges, bought nothing.) Control points enter where the rays
of their marks meet (``marks``), which tells too whether they were marked in copies of the images; check points never
enter. The scale of the rig enters with the sigma of its file, with how well the images carry its baselines to the
length of the whole (the adjustment's own sigma of the scale, which two cameras back to back hardly tell) and with the
share of its lever arms that the images contradict. Cameras all round (a ring, or two back to back) tell the vertical,
to 3 deg or to what they lean from frame to frame.

**Similarity** (``similarityfit``, ``fit``). Lever arm and clock are unknowns of it (``antenna``). What cannot be told
is reported: along a straight way the clock is the lever arm, and the height of an antenna is the height of the world.
Positions of images by name are those of the cameras, unless they surely stand off by one lever arm.

**Adjustment with positions** (``fit.by_errors``, ``georeferencing``). Positions, control points, antenna, clock,
similarity and what the images leave open of the shape are unknowns of one block: its large eigenvectors
(``sfm.shape``) stand for the images there. One bundle adjustment then brings the frames to where the block has them,
and all else follows as the images have it; once more where that was far, for control points move as the frames that
see them only to first order. It is kept only if every fifth position, which it did not know, is met as well as by the
similarity, and the images fit no worse (``georeference_folders``). The images of a shot whose cameras fire apart keep
how they stand to each other (``rigpriors.of_one_shot``).

**Several models** (``oneworld``): parts of a survey that no tie joined for the mapper come into the world of the
largest by the matches between them, else by their own positions, and into one model (``scene.colmapmodel``); what
neither places is named. Poses of
a model's rig in the others' points would add no pair of images: of the matches between two passes mapped apart an
eighth has a point on one side only, and every pair that has such has others too (`canal`, `canal_demo`, KITTI).

**Sigma** (``positionerrors``). The last fit weighs the believed positions by the errors that their residuals show
(white, slow, common to all). The covariance of the block is that of the placement and, once adjusted, of the shape.
What all positions of a receiver share counts with a part of the stated sigma. An upward direction that the positions
refute is not used. A note says what holds the scale where the rig does, and what checks it. ``world.json`` keeps the
covariance of the placement (``accuracy``), which ``cloud`` carries to its points. Heights are ellipsoidal unless the
CRS is a compound one. A compound CRS whose geoid grid PROJ does not have is refused, because PROJ would silently leave
the heights as they are. Grid coordinates have the scale of the grid: the report says so.
"""
