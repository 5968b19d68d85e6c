"""A test bench against self-deception: inputs that are wrong in one known way, and whether the run says so."""
