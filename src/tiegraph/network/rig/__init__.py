"""What the images say about the rig: which cameras can see the same, their order, their time."""
