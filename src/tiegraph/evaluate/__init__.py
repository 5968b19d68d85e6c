"""Figures of merit: trajectories, clouds, back-projection (paper 000)."""
