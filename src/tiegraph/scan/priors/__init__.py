"""Prior places and times: positions, poses, trajectories, frame times, start models."""
