#!/bin/sh
# The NEON kernel on any machine: `CXX='aarch64-linux-gnu-g++' RUN='qemu-aarch64-static' sh native/arm64.sh`, or with the
# compiler of PyPI's ziglang: CXX='python -m ziglang c++ -target aarch64-linux-musl'. RUN is empty on ARM itself.
set -eu
cd "$(dirname "$0")"
build=$(mktemp -d)
trap 'rm -rf "$build"' EXIT
${CXX:-c++} -std=c++17 -O2 -ffp-contract=off -static -DSGM_ARM64 -Wall -Wextra -I . -o "$build/check" check_kernels.cpp \
    sgm/match.cpp sgm/pyramid.cpp sgm/dispatch.cpp sgm/kernel_plain.cpp sgm/kernel_neon.cpp -lpthread
${RUN:-} "$build/check"
