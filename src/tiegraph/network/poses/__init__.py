"""Pairs from prior poses (paper 003), and whether previews agree with them."""
