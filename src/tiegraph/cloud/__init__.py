"""From depth maps to a point cloud: fusion and outlier filters.

``fuse`` goes tile by tile, so that neither memory nor scratch space grow with the survey; ``voxels`` adds points up.
"""
