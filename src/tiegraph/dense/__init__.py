"""Depth maps: partners, rectification, matching engines, consistency over views."""
