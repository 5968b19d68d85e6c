"""Frame offsets between cameras and passes: previews on a lattice of frames, an interpolated surface, a path through
it."""
