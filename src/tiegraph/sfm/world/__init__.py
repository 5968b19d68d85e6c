"""Georeferencing: evidence, similarity, adjustment with positions and control points.

**Evidence** (``fixes``). Every row of the receiver is connected by a cubic to the poses of up to four frames around
its time. So rows between frames are used, a lever arm rotates with the boat, and a clock offset is the derivative of
the same sum. During the search sigmas are scaled by level of the stated sigma to the residuals, and for their
correlation in time (``positionerrors``): a float solution that wanders must not outvote a fixed one because it is
written five times a second. Control points enter with the intersection of the rays of their marks (``marks``), which
also shows whether they were marked in copies of the images; check points never enter. The scale of the rig enters
with the sigma of its file, with the accuracy with which the images transfer its baselines to the length of the whole
(the adjustment's own sigma of the scale, which two cameras back to back hardly determine) and with the share of its
lever arms that the images contradict. Cameras on all sides (a ring, or two back to back) determine the vertical, to 3
deg or to their variation from frame to frame (``upright``). Sources that contradict each other are weighed before the
fit (``weighing``).

**Similarity** (``similarityfit``, ``fit``). Lever arm and clock offset are unknowns of it with weak priors. Values that
the positions hardly determine stay as given (``positionerrors``) and are reported: along a straight path the clock
offset acts like the lever arm, and the height of an antenna like the height of the world. Positions of images by name
are those of the cameras, unless they certainly differ by one lever arm.

**Adjustment with positions** (``fit.by_errors``, ``georeferencing``). Positions, control points, antenna, clock,
similarity and the undetermined part of the shape are unknowns of one block, in which the large eigenvectors of the
shape (``sfm.shape``) represent the images. One bundle adjustment then moves the frames to the result of the block,
and everything else follows the images; a large movement is repeated, because control points follow the frames that
see them only to first order. The result is kept only if the held-out positions (every fifth) fit as well as with the
similarity, and the images fit no worse (``georeference_folders``). The images of a shot whose cameras fire at
different times keep their relative poses (``constraints.of_one_shot``).

**Several models** (``oneworld``): models that no tie joined for the mapper come into the world of the largest one by
the matches between them, else by their own positions, and then into one model (``scene.colmapmodel``); models that
neither places are named in a note. Registering the rig of a model to the points of the others would add no pair of
images: of the matches between two separately mapped passes an eighth has a point on one side only, and every such
pair has other matches too (`canal`, `canal_demo`, KITTI).

**Sigma** (``positionerrors``). The last fit weighs the inlier positions by the errors that their residuals show
(white, slow, common to all). The covariance of the block is that of the georeference and, after the adjustment, of
the shape. The common error of all positions of a receiver is a part of the stated sigma. An upward direction that the
positions refute is not used. A note says what determines the scale where the rig does, and what checks it.
``world.json`` keeps the covariance of the georeference (``accuracy``), which ``cloud`` propagates to its points.
Heights are ellipsoidal unless the CRS is a compound one. A compound CRS whose geoid grid PROJ does not have is
refused, because PROJ would silently keep the heights unchanged. Grid coordinates have the scale of the grid: the
report says so.
"""
