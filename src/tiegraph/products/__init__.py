"""Rasters of a finished survey over reference surfaces: heights, sigma, true orthophoto, terrain; and measurements.

A map, the elevation of a wall and an unrolled lining are one mechanism: a frame (u, v, w), and rasters of w over
(u, v). Of a map the axes are east, north and up; of a wall u runs along it, v up and w out of it, so that a viewer in
front of it sees u grow to the right. Only the choice in `surface.py` distinguishes the two. The frame is rigid, or
curved along the path of the cameras (`frame.py`).

Points become heights cell by cell: the points that face along w, a robust top of them, and the mean by 1 / sigma^2 of
the points at that top, which are seen from outside. Small holes are filled by a plane fitted to the cells
around each pixel: exact on any slope, the same in every tile, and its residuals measure its accuracy. Inverse
distances (GDAL's fillnodata) step on slopes, and triangles between points of a regular grid depend on the other
points in the tile.

A true orthophoto takes a pixel from an image only if the image saw the surface there: the finished surface is drawn
into each image as a depth buffer, with the faces of its steps, and the image's own depth map adds occlusions that the
surface does not have, such as a mast in front of a wall. Of the images that see a pixel the best by angle, resolution
and distance from the border gives its colour; OpenCV compensates the exposures of all at once and blends the seams.

For a map the terrain is separated from objects (`terrain.py`), and contour lines are drawn of it; profiles and
volumes are measured in the finished rasters. A volume's sigma is mostly common to all its pixels (`volumes.py`).

Everything is made by tiles with margins, so that the values do not depend on the tiles, memory does not
grow with the survey and finished tiles stay.
"""
