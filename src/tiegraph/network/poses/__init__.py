"""Pairs from prior poses (paper 003), and their check by previews."""
