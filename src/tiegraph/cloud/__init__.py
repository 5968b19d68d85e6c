"""From depth maps to a point cloud: fusion and outlier filters.

Depth maps are fused tile by tile into voxels of six sizes, so that memory does not grow with the survey. Points lie
in files for some 400 million at a time, 24 bytes each, so that the scratch space does not grow either. A search tree of
the points of a tile is asked once for both outlier filters. LAS files carry no date, so that two runs give the same
bytes.
"""
