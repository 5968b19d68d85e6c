"""Transforms, alignment and geodesy on plain arrays. Knows no images, rigs or files."""
