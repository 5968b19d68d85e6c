"""Coded targets and scale bars as their files name them, and corners of what is printed black on white.

A target is named by its family and number, ``tag36h11:12`` or ``4x4_50:7``; the families are OpenCV's dictionaries. A
scale bar is two names and a length. The corners serve boards (``calibrate``) and targets (``targets``) alike.
"""
