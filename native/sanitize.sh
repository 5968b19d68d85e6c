#!/bin/sh
# The kernel tests under address and undefined-behaviour checks: `sh native/sanitize.sh` after `sh setup.sh dev`.
set -eu
cd "$(dirname "$0")/.."
python=$PWD/.venv/bin/python
"$python" -m pip install --quiet --disable-pip-version-check cmake ninja nanobind
build=$PWD/build/sanitize
.venv/bin/cmake -G Ninja -S native -B "$build" -DSGM_SANITIZE=ON -DPython_EXECUTABLE="$python" \
    -DCMAKE_MAKE_PROGRAM="$PWD/.venv/bin/ninja" -Dnanobind_DIR="$("$python" -m nanobind --cmake_dir)" >/dev/null
.venv/bin/cmake --build "$build"
# Python itself is not built with the checks: their library comes first, and its leaks are its own affair.
LD_PRELOAD="$(c++ -print-file-name=libasan.so) $(c++ -print-file-name=libubsan.so)" ASAN_OPTIONS=detect_leaks=0 \
    "$python" - "$build" <<'END'
import importlib.util
import pathlib
import sys

import pytest

path = next(pathlib.Path(sys.argv[1]).glob("_sgm*.so"))
spec = importlib.util.spec_from_file_location("tiegraph.dense._sgm", path)
sys.modules["tiegraph.dense._sgm"] = module = importlib.util.module_from_spec(spec)
spec.loader.exec_module(module)
import tiegraph.dense

tiegraph.dense._sgm = module
sys.exit(pytest.main(["-q", "-p", "no:cacheprovider", "tests/dense/test_dense_sgm.py", "tests/dense/test_dense_tsgm.py"]))
END
