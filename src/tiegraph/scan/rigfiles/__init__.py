"""Rigs and cameras as files give them, one reader a format: rig.toml, COLMAP, Kalibr, OpenCV, ROS, Metashape."""
