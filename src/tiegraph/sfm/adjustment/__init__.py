"""The adjustment: what is solved for, and all that is known beside the images.

Everything here enters COLMAP's bundle adjustment or is linearised from it. Where a model comes from and what becomes
of it is not known here: start, rig, sigmas and the adjustment in the world all stand on this package.

**The final adjustment** (``adjust``) is robust, with free principal points.

**Priors** (``constraints.add_priors`` adds them all). What rig.toml gives with a sigma (``rigpriors``), in the final
adjustment and in the one with positions; what lenses look like (``lens``).

**Lever-arm prior from the rig's shape** (``leverarmprior``). The cameras look outwards from one body. The middle, the
distance along the axis and the scatter of the cameras, unknowns of the same adjustment, are what is expected of the
place of one that hardly shares a point with them. On ``canal`` 16 tracks tie the up camera (sigma 44 mm): it stood
66 mm off without the prior, 12 mm with it. On PandaSet, whose cameras stand anywhere and are well tied, nothing moves.

**Normal equations** at the solution (``jacobians``, ``normal``): sigmas and the test of the rig are made of them.
"""
