"""Videos and the images of bags: their frames, the time of each, and the time offsets of videos of one rig."""
