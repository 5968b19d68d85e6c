"""Is every frame at its place, and what becomes of those that are not, or have none."""
