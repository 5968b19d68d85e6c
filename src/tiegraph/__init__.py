"""tiegraph: from a folder of survey images to a georeferenced point cloud, by first estimating which images tie to which."""

# zlib must be loaded before pycolmap: its extension module exports a second zlib, and libz would bind to it and
# abort the process at the first PNG written (tests/test_import_order.py shows it in a child process).
import zlib  # noqa: F401  isort: skip

__version__ = "0.1.0"
