"""From depth maps to a point cloud: fusion and outlier filters."""
