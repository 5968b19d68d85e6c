"""From a folder of survey images to a georeferenced point cloud, by first estimating which images tie to which.

import tiegraph
project = tiegraph.open("survey/images", rig="ladybug5")
funnel = project.run(until="design").pairs().funnel()
"""

# One thread for linear algebra, before NumPy and pycolmap load theirs: with more, last digits depend on the machine's
# number of cores and on the pool (tests/test_blas_threads.py). Worker and child processes inherit it.
import tiegraph.blas  # noqa: F401  isort: skip

# zlib must be loaded before pycolmap: its extension module exports a second zlib, and libz would bind to it and
# abort the process at the first PNG written (tests/test_import_order.py shows it in a child process).
import zlib  # noqa: F401  isort: skip

from typing import TYPE_CHECKING, Any

from tiegraph.__version__ import __version__

if TYPE_CHECKING:
    from tiegraph import arrays
    from tiegraph.api import Project
    from tiegraph.api import open_project as open
    from tiegraph.scene.pairs import Pairs
    from tiegraph.scene.results import Cloud, Model
    from tiegraph.scene.scene import Scene

__all__ = ["Cloud", "Model", "Pairs", "Project", "Scene", "__version__", "arrays", "open"]

_PLACES = {
    "arrays": ("tiegraph.arrays", ""),
    "open": ("tiegraph.api", "open_project"),
    "Project": ("tiegraph.api", "Project"),
    "Scene": ("tiegraph.scene.scene", "Scene"),
    "Pairs": ("tiegraph.scene.pairs", "Pairs"),
    "Cloud": ("tiegraph.scene.results", "Cloud"),
    "Model": ("tiegraph.scene.results", "Model"),
}


def __getattr__(name: str) -> Any:
    """Public names are loaded when first used, so that worker processes and `tiegraph --help` start fast."""
    if name not in _PLACES:
        raise AttributeError(f"module 'tiegraph' has no attribute {name!r}")
    from importlib import import_module

    module, attribute = _PLACES[name]
    found = import_module(module)
    return getattr(found, attribute) if attribute else found


def __dir__() -> list[str]:
    """Names that are loaded when first used are shown all the same."""
    return sorted(__all__)
