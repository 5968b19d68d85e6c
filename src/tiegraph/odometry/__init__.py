"""Visual odometry: the path of a stereo camera, a rig or a single camera from its images alone, frame after frame.

The method, in the order of ``odometry``: corners (Shi and Tomasi) are followed from image to image by Lucas and Kanade,
from where the predicted pose expects them, and back (``cameras``). Points of known place give the frame's pose, for one
camera or many, with a common view or none, by pycolmap's generalised absolute pose (``worldmap``). A frame in which the
points have moved far enough is a keyframe: the other cameras of the rig are asked for what they see of
the corners at the same instant, new corners fill the image, points get places, and the last keyframes are adjusted
together by pycolmap's bundle adjustment with cameras and rig held. A segment begins at one instant where
cameras see the same, else from two frames by their relative orientation: of a single camera, whose path
has no scale, or of the whole rig; of one that shares the edges of its views, what is seen there tells the length.

**Lost and found** (``recall``): a frame that cannot be followed is looked for in what earlier keyframes saw; after
some without success a new segment is begun, which is joined when one of its keyframes shows a place of an earlier one.
So are loops closed. Which keyframes may show a place is told by their thumbnails: the survey's retrieval needs the
features of all images beforehand. What is seen again becomes an observation like any other, and all is adjusted once
at the end.

**Covariances** (``covariance``) are those of all observations together, a little smaller than those of windows that
forget; what all corners of an image share is in no residual, so they are widened by what drives with truth show
(``tuning``; docs/odometry.md says how far one factor holds and what was tried in its place). A rig that is wrong shows
in none of them.

What was looked at: VISO2 (Geiger et al. 2011), PTAM (Klein and Murray 2007), ORB-SLAM (Mur-Artal et al. 2015), VINS
(Qin et al. 2018). Inertial measurements are not read: no file of them is known to the project.
"""
