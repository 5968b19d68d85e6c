"""Pattern calibration: the cameras of a rig, or a single one, from images of a board.

The method, in the order of ``pipeline/calibrate.py``: corners are detected (``board``);
start values come from resections, the focal length by a search over the field of view, so that every model of COLMAP
starts alike; all images of all cameras are adjusted together by pycolmap's bundle adjustment (``adjust``).
The board is the world, an instant is a frame of the rig, and the corners are points that are held: so nothing of the
adjustment is our own, and cameras that never see the board together hang together over instants at which others do.

**Sigmas** (``judge``): pycolmap's own covariance refuses rigs, so the Jacobian of its problem is asked for, and
the poses of the board are eliminated instant by instant. The corners of one view err together (a board that is not
flat, blur, light), which independent errors would not show; so a parameter gets the larger of the classical sigma and
the one that the scatter of the instants' gradients says (the sandwich estimator of ``sfm.covariance``, with instants
as clusters). Judged is by instants that were held back, by where in the image corners were seen, and by
the sigma of the focal length: views of a board that is never tilted leave it open, and that is an error.

The scale is the board's: a wrong square size changes no residual, but every length of the rig.
"""
