"""Where the model is on the Earth: evidence, similarity, adjustment with positions and control points."""
