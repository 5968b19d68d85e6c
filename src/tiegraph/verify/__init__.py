"""Verification of full-resolution matches by the rig and by loops of frames: ties on repeated walls are refused."""
