"""Rows of an image that are worked on together: what a step holds beside its result does not grow with the image."""


def row_strips(shape: tuple[int, ...], pixels: int = 1 << 18) -> list[slice]:
    """Rows of an image (height, width) in order, about ``pixels`` at a time; at least one row."""
    height, width = shape
    rows = max(1, pixels // width)
    return [slice(top, min(top + rows, height)) for top in range(0, height, rows)]
