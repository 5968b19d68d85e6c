"""The tie graph: candidate pairs from several sources, sections, and the design that thins them."""
