"""Videos and the images of bags: their frames, when each was taken, and how videos of one rig lie in time."""
