"""The place of every frame, tested before the final adjustment.

The verified matches of a frame, or of frames that hang together, also those that the mapper threw out, must agree with
its pose: the points that other frames made of them must be where it sees them (``verified``, ``consistency``). What
fails is left out with its reason (``doubtful``).

A mapper's model and a start are asked too: a part that stands wrong as a whole is moved by one similarity (``parts``),
single frames in doubt, and frames without a place, are placed by their matches with the others
(``start.stagedadjustment``), and only what is in doubt still is left out in the end. Of ``seneca`` (167
photographs from a wing) a coarse model had some at a wrong place, which drew others after them: 159 stood for 166.
Guided matching and tying images that hang on their rig bought nothing and are gone.
"""
