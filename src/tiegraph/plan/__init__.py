"""The planner: what a survey will give, before anyone goes there.

**Stations** (``figures``): one camera before a surface, in closed form. Footprint, GSD, base and overlap, sigma of a
depth by the number of rays, points per area, motion blur and the exposure that avoids it (Wenzel et al. 2012, paper
004, equations 1 and 2; its table 1 is reproduced by the tests).

**Paths** (``path``, ``network``, ``accuracy``): closed forms know nothing of how errors add up along a way, so a whole
path is simulated: where the frames stand, which surface there is, which points of it are seen from where, with noisy
observations, as a COLMAP model. It goes through the very covariance code of the stage `sparse`, which the glue hands
in, with rig and lenses free where nobody calibrated them. What finished runs show is put in where a simulation has to
assume: how many tie points an image has, how long their tracks are, how much errors that observations share widen the
sigmas. Fewer points are simulated than there will be; their errors are made smaller in the same measure, so that poses
come out as by all of them.

Positions and control points place the free network in the world by universal kriging: the shape's covariance, an
unknown similarity, and fixes that tell both the similarity and the bends of the shape. As in `georef`, what all
positions of a receiver share comes on top, unless control points hold the place.

**What is assumed**: frames stand where they are planned and look as they are planned; everything is matched that can
be; no mistakes. So a plan says what a good run gives, and the report of the run what was reached.
"""
