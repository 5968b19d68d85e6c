"""What all figures share: words in them are words."""

import warnings
from collections.abc import Iterator
from contextlib import contextmanager


@contextmanager
def plain_text() -> Iterator[None]:
    """For functions that draw, as their decorator: names of folders and cameras are no formulas (``$\\frac{`` would be
    an error), and letters that the font lacks are boxes without a warning for each."""
    import matplotlib

    with matplotlib.rc_context({"text.parse_math": False}), warnings.catch_warnings():
        warnings.filterwarnings("ignore", message="Glyph .* missing")
        yield
