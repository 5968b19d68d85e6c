"""What is known of places and times before any model: positions, poses, trajectories, frame times, start models."""
