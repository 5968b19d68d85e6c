"""Structure from motion with rigs, and where the model is on the Earth.

**Mapping.** The mapper works on its own copy of the database (``database``), with the rows of the rig in it. It runs
in a child process, because an error in COLMAP's worker threads aborts the process (``tiegraph.child``). Poses that
are roughly known are a *start* (``sfm.start``); what fails its acceptance test is mapped by COLMAP: global with a rig
or from 60 images, else incremental (``mapping``). The receipt says which and why. Above 1000 images without a usable
coarse model, a mapper makes rough models of blocks (``blockwise``, over the pool; cut and joined by the same
``scene.blocks`` and ``scene.joining`` as the coarse model), and the start takes their poses. Images that no verified
pair ties to the model are a survey of their own and become a model of their own, whichever mapper made it; the
receipt names them. A rig held as given that leaves most tied images without a place, or shows as a principal point
that no lens has, is reported to contradict the images (``registrationreport``); it is not changed.

**Final adjustment** (``adjustment``). Every model goes through one robust adjustment with free principal points, which
COLMAP holds (on the example survey that bends rig and model), and, for RADIAL cameras, with aspect and decentring
under priors (``adjustment.lens``): otherwise the rotations of a rig take up what a lens has of them. Points that only
one shot saw are left out: false matches of cameras centimetres apart meet close by and weigh much.

**After the mapper** (``finish``, in a child process of its own): registration is repaired and completed
(``sfm.placement``), the rig is tested against the images and relaxed if it moves (``sfm.rig``), sigmas are estimated
(``covariance``), and ``sfm.world`` places the model.

Adjustments go through pycolmap's Ceres problem. Its wheel names the types of pyceres but holds no ``Problem``, so the
package pyceres is a dependency. Own camera models and an own bundle adjustment are
refused.
"""
