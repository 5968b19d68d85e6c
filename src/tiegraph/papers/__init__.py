"""The papers' own recipes, one file a paper."""
