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

for package, name in (("dense", "_sgm"), ("features", "_nearest")):
    path = next(pathlib.Path(sys.argv[1]).glob(f"{name}*.so"))
    spec = importlib.util.spec_from_file_location(f"tiegraph.{package}.{name}", path)
    sys.modules[spec.name] = module = importlib.util.module_from_spec(spec)
    spec.loader.exec_module(module)
    setattr(importlib.import_module(f"tiegraph.{package}"), name, module)
tests = ["dense/test_dense_sgm.py", "dense/test_dense_matchers.py", "features/test_features_match.py"]
sys.exit(pytest.main(["-q", "-p", "no:cacheprovider", *(f"tests/{name}" for name in tests)]))
END
