#!/bin/sh
# Makes .venv beside this file and installs tiegraph into it. `setup.sh dev`: editable, with what the tests need.
set -eu
cd "$(dirname "$0")"
python=${PYTHON:-python3}
"$python" -c 'import sys; sys.exit(sys.version_info < (3, 10))' || {
    echo "tiegraph needs Python 3.10 or newer; $("$python" --version) found. Set PYTHON=/path/to/python3." >&2
    exit 1
}
install() {
    as_root=""
    [ "$(id -u)" = 0 ] || as_root=sudo
    $as_root apt-get update -q && $as_root apt-get install -q -y "$@"
}
# Debian and Ubuntu ship venv in a package of its own.
"$python" -c 'import ensurepip, venv' 2>/dev/null || install python3-venv
# The native matchers are built here; without a compiler everything else still installs.
headers='import os, sys, sysconfig; sys.exit(not os.path.exists(os.path.join(sysconfig.get_path("include"), "Python.h")))'
if ! command -v "${CXX:-c++}" >/dev/null || ! "$python" -c "$headers"; then
    install g++ python3-dev || echo "No C++ compiler: the dense stage will use OpenCV's matcher, features are matched by NumPy." >&2
fi
[ -x .venv/bin/python ] || "$python" -m venv .venv
if [ "${1:-}" = dev ]; then
    .venv/bin/python -m pip install --quiet --disable-pip-version-check -e '.[dev]'
else
    .venv/bin/python -m pip install --quiet --disable-pip-version-check . ./examples/canal
fi
