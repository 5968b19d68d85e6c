"""Errors that many observations share: of a lens unlike its model, and of cameras that do not stay put in their rig.

Both are random effects (variance components by maximum likelihood; Patterson and Thompson 1971): what the unknowns of
the adjustment cannot take up of an effect shows in the residuals, tells how large it is, and by that how much of it the
unknowns have taken up, which no residual shows. The noise of what shows is that of whole points (as in ``covariance``).

``effects``: what the observations say of more unknowns; ``lenses`` and ``mountings``: the two kinds of shared error.
"""
