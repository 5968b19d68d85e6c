"""A LiDAR-SLAM reference: trajectory and map of a scanner, and where it stands on the camera rig (paper 001)."""
