"""Frame offsets between cameras and passes: previews on a lattice of frames, a surface over them, a path through it."""
