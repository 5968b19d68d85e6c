"""One thread for linear algebra in this process and all that it starts; in force once imported.

A product or an inverse that OpenBLAS makes on two threads differs in its last digits from that on one, so that results
would depend on the number of cores. The parallelism is elsewhere: images and blocks of pairs run side by side.
"""

import ctypes
import os
import sys

_VARIABLES = ("OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS", "BLIS_NUM_THREADS", "VECLIB_MAXIMUM_THREADS")
# OpenBLAS as NumPy's and SciPy's wheels name it, and by its own name, with 64-bit integers and without.
_SETTERS = tuple(f"{p}openblas_set_num_threads{s}" for p in ("scipy_", "") for s in ("64_", ""))


def one_thread() -> None:
    """Set the variables that the libraries read when they are loaded, and tell those that are loaded already."""
    os.environ.update(dict.fromkeys(_VARIABLES, "1"))
    if "numpy" not in sys.modules:
        return
    for path in _loaded():
        try:
            library = ctypes.CDLL(path)
        except OSError:
            continue
        for name in _SETTERS:
            if hasattr(library, name):
                getattr(library, name)(1)


def _loaded() -> set[str]:
    """Paths of the OpenBLAS libraries of this process; none where the system does not tell (not Linux)."""
    try:
        with open("/proc/self/maps", encoding="utf-8", errors="surrogateescape") as maps:
            paths = (line.split(maxsplit=5)[5].strip() for line in maps if line.count("/"))
            return {p for p in paths if "openblas" in os.path.basename(p)}
    except OSError:
        return set()


one_thread()
