"""Rigs and cameras from files, one reader a format: rig.toml, COLMAP, Kalibr, OpenCV, ROS, Metashape."""
