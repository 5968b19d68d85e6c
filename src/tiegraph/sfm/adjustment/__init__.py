"""The bundle adjustment: its unknowns, and what is known of them beside the images.

Everything here enters COLMAP's bundle adjustment or is linearised from it. The package knows neither where a model
comes from nor what is done with it: start, rig, sigmas and the adjustment in the world all use it.

**The final adjustment** (``adjust``) is robust, with free principal points.

**Priors** (``constraints.add_priors`` adds them all). Values of rig.toml with a sigma
(``constraints.rig_priors``), used in the final adjustment and in the one with positions; typical lens parameters
(``lens``).

**Lever-arm prior from the rig's shape** (``leverarmprior``). The cameras look outwards from one body. The middle of
the cameras, their distance from it along the optical axis and the scatter are unknowns of the same adjustment; they
predict the place of a camera that shares hardly any point with the others. On ``canal`` 16 tracks tie the up camera
(sigma 44 mm): it was 66 mm off without the prior and 12 mm with it. On PandaSet, whose cameras follow no such rule
and are well tied, nothing moves.

**Normal equations** at the solution (``jacobians``, ``normal``): the sigmas and the test of the rig use them.
"""
