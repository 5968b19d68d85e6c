"""A textured mesh of a finished survey.

Poisson's surface of the fused points (COLMAP has it) goes through noise as a smooth mean and closes small gaps; it is
cut to where points are, for beyond them it is a guess, and simplified by quadric errors (`surface.py`). A Delaunay
surface keeps every stray of the cloud as a spike, and a surface of each depth map has seams.

Each face has its colour from one image that sees it whole: drawn into the image as a depth buffer the mesh itself tells
what is hidden, and the image's own depth map tells what stands before it that the mesh does not have, such as people
(`views.py`). Of those images the one counts most that has the most pixels on the face, straight from in front;
neighbours agree on few images, so that patches are large and seams few. What no image sees and what reaches the border
of the mesh is cut away.

A patch is a rectangle of its image (`texture.py`), as Waechter, Moehrle and Goesele (2014) have it: nothing is
unwrapped, so no picture is stretched. Finer images are reduced until all
fits on a few textures, with pixels of one size on the object. Their colours are levelled across seams.

The mesh is one piece in memory: 2 GB for the 1.1 million points of the example; larger clouds are thinned.
"""
