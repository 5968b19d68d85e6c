"""The tie graph: candidate pairs from several sources, sections of the survey, and the rig checked against the images.

Numbers of preview matches cannot distinguish true ties from repeated walls; geometry can. The network is found in
four steps:

1. Previews are matched on a coarse grid of frames (``scorematrix``) for every pair of cameras and passes, smoothed
and interpolated (``offsets``); by retrieval for loops and loose photographs (``retrieval``); by prior poses if there
are any (``poses``, checked by previews in ``posecheck``).
2. The best pairs of each image make a coarse model of the survey (``coarse.search`` chooses them and judges the
result; the stage coarse maps them with the mapper and rig of the later stages).
3. Its poses and points predict the surface that every two images share (``coarse.visible``). The prediction replaces
the match counts wherever the model explains the strong previews of neighbouring frames; elsewhere the counts decide,
and the receipt says so.
4. Its calibration replaces guessed values of cameras and rig.

The stages are ``candidates.find_candidates`` (1), ``coarse.search.Search`` (2 to 4) and ``network.join_network``.

One limit, ``axes_deg``, holds for the axes of cameras before there is a model, and for the views of a shared surface
after that. ``coarse.visible`` also serves prior poses, with points at an assumed range (paper 003).

Sources of pairs are functions found by name in ``candidates.SOURCES``.
"""
