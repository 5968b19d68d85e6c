"""Masks: which pixels are worth a feature. Sources by name, and their comparison with hand-made masks."""
