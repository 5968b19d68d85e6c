"""Coded targets in the images: where they are, to tenths of a pixel, and how well that is known.

OpenCV's detector names the targets of the families asked for (ArUco, AprilTag). The four corners of a target's black
square are then refined like those of a calibration board, and its place is where the diagonals meet: after distortion
is taken out, for the middle of a large target in the corner of a wide image lies a pixel beside where they cross in
the picture. What moves all four corners outwards alike (blur, overexposure) leaves it where it is.

The sigma of a corner follows from the noise of the grey values around it, carried through the refinement, and what
rendered targets are off by without any noise. That of the crossing of two diagonals is less by the square root of 2.

A name seen at two places of one image was printed twice, and which of them was surveyed nobody can tell: none is used.
Families contain each other (4x4_50 is a part of 4x4_100), and a small one is found by chance in gravel: only names that
the file has are taken.
"""
