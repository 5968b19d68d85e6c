"""A model started from poses that are roughly known, instead of mapped from nothing.

The start takes the poses of the coarse model, triangulates the full-resolution matches from them and adjusts in
three rounds (``stagedadjustment``): poses; then rig, focal length and distortion; then principal points. After the
first two, frames that had no pose, or stand where their matches say they do not, are placed by these.

Before that, the length of the path is checked against a rig that must not change (``pathscale``): the matches tell it,
else the positions, else the start is refused. The same test follows every mapper. Cameras that look away from each
other hardly tell a mapper that length (PandaSet's previews: wrong by factors of 16 to 40 000, which no error shows
and no adjustment corrects). What is too long or too short by a quarter is mapped again from its own poses with the
length corrected.

The acceptance test (``stagedadjustment.refusal``) asks for tied images that see points, verified pairs that agree with
the model, and plausible lenses.
"""
