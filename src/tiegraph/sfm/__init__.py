"""Structure from motion with rigs, and where the model is on the Earth.

**Mapping.** The mapper works on its own copy of the database, with the rows of the rig in it. It runs
in a child process, because an error in COLMAP's worker threads aborts the process (``tiegraph.child``). Poses that
are roughly known are a *start* (``sfm.start``); what fails its acceptance test is mapped by COLMAP: global with a rig
or from 60 images, else incremental (``mapping``). The receipt says which and why. Images that no verified pair ties to
the model are a survey of their own and become a model of their own, whichever mapper made it; the receipt names them.
A rig held as given that leaves most tied images without a place, or shows as a principal point that no lens has, is
reported to contradict the images (``registrationreport``); it is not changed.

**Final adjustment** (``adjustment``). Every model goes through one robust adjustment with free principal points, which
COLMAP holds (on the example survey that bends rig and model), and, for RADIAL cameras, with aspect and decentring
under priors (``adjustment.lens``): otherwise the rotations of a rig take up what a lens has of them. Points that only
shot saw are left out: false matches between cameras centimetres apart intersect close to the rig and have a large
weight.

**After the mapper** (``finish``, in a child process of its own): registration is repaired and completed
(``sfm.placement``), the rig is tested against the images, and cameras that fire apart get their times (``sfm.rig``),
sigmas are estimated (``covariance``), and ``sfm.world`` places the model.

**The model in formulas.** Unknowns: pose (R_f, c_f) of each frame, extrinsics E_s, lens k_s and, where cameras fire
apart, time tau_s of each sensor, points X_j; in the world the similarity (s, R, t), the antenna a in the rig frame,
the clock offset delta of the receiver, and the error q that all its positions share. The observations and their
errors:

* observation of point j by sensor s of frame f: x = pi(k_s, E_s (R_f (X_j - c_f))) + e, Cauchy of scale 0.5 px; the
  observations of one point have correlated errors, so sigmas are computed from the gradient of each point
  (``covariance``);
* values that a file gives for E_s and k_s: given + N(0, its sigma); the geometry that the cameras of a rig have in
  common is a prior for each of them (``adjustment.leverarmprior``); a camera that fires late is at its place after
  the motion of tau_s (``motion``);
* position i of stated sigma u_i at time t_i: p_i = s R (c + R' a)(t_i + delta) + t + q + u_i (w n_i + g z_i); c and
  R' are cubics through the frames' poses, n is white, z is a first-order Gauss-Markov process
  (``world.positionerrors``);
* the shape of the model, where the images leave it undetermined: c_f + sum_m v_fm b_m, b_m of variance 1 (``shape``);
* control points, scale bars, orientations, the upward direction of the cameras: value + N(0, sigma) (``world``).

The variance components w and g and the correlation time of z are maximum likelihood estimates. a and delta have
priors of 1 m and of one step between frames; where the positions reduce these sigmas by less than a tenth, a and
delta keep their prior values and their uncertainty is propagated. The rig as given is tested by freeing groups of its
parameters in the same normal equations (``rig.linear``, ``rig.confront``). Statements of two sources contradict each
other if their difference has a probability below 0.1 % (``scene.evidence``).

Adjustments go through pycolmap's Ceres problem. Its wheel names the types of pyceres but holds no ``Problem``, so the
package pyceres is a dependency. Own camera models and an own bundle adjustment are
refused.
"""
