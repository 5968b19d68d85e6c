"""Correlated errors of many observations: lens errors beyond the camera model, and cameras that are not rigid in
their rig.

Both are random effects (variance components by maximum likelihood; Patterson and Thompson 1971). The residuals show
the part of an effect that the unknowns of the adjustment cannot absorb; from it follows the size of the effect, and
so the part that the unknowns absorbed and no residual shows. The noise of these residuals is that of whole points (as
in ``covariance``).

``effects``: the information of the observations on additional unknowns; ``lenses`` and ``mountings``: the two kinds
of error.
"""
