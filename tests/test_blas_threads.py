"""Linear algebra runs on one thread, so that its last digits do not depend on the machine or the pool."""

import os
import subprocess
import sys

import pytest

_TOLD = """
import ctypes, os, psutil
said = set()
for path in {m.path for m in psutil.Process().memory_maps() if "openblas" in os.path.basename(m.path)}:
    library = ctypes.CDLL(path)
    for name in ("scipy_openblas_get_num_threads64_", "scipy_openblas_get_num_threads"):
        if hasattr(library, name):
            said.add(getattr(library, name)())
print(said)
"""


@pytest.mark.slow
@pytest.mark.skipif(not os.path.exists("/proc/self/maps"), reason="the threads are asked of the loaded libraries")
@pytest.mark.parametrize("first", ["import tiegraph, numpy, scipy.linalg", "import numpy, scipy.linalg, tiegraph"])
def test_one_thread_whichever_is_imported_first(first):
    environment = {**os.environ, "OPENBLAS_NUM_THREADS": "2"}
    run = subprocess.run([sys.executable, "-c", first + _TOLD], env=environment, capture_output=True, text=True)
    assert run.stdout.strip() in ("{1}", "set()"), run.stderr  # nothing: another library than OpenBLAS
