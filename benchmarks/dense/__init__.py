"""Stereo matching: our matcher beside OpenCV's and CNES libsgm."""
