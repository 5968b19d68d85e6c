"""`tiegraph doctor`."""

from __future__ import annotations

import os

import psutil

from tiegraph.cli.options import options_of
from tiegraph.cli.output import say
from tiegraph.project.run import software


def main(arguments: list[str]) -> int:
    """Print versions, cores and memory, and whether optional parts are there."""

    def doctor() -> None:
        """Versions, cores, memory, and what is missing."""

    options_of(doctor, "tiegraph doctor", arguments)
    import pycolmap

    for name, number in software().items():
        say(f"{name:<24} {number}")
    say(f"{'cores':<24} {os.cpu_count()}")
    say(f"{'memory':<24} {psutil.virtual_memory().total / 2**30:.1f} GiB")
    say(f"{'pycolmap with CUDA':<24} {'yes' if pycolmap.has_cuda else 'no (not needed)'}")
    try:
        import distributed

        say(f"{'dask':<24} {distributed.__version__}")
    except ImportError:
        say(f"{'dask':<24} not installed (pip install 'tiegraph[dask]' for --pool dask:<address>)")
    return 0
