"""Structure from motion with rigs, and where the model is on the Earth."""
