"""A stand-in for CuPy that runs the kernels of ``dense.cuda`` on the CPU (``cuda_emulated.h``), compiled with g++."""

import ctypes
import shutil
import subprocess
from functools import lru_cache
from pathlib import Path
from types import SimpleNamespace

import numpy as np

HERE = Path(__file__).parent
_ARGUMENTS = 24  # more than any kernel has
_SHARED = 4 << 16


def compiler():
    """Path of the compiler; None without."""
    return shutil.which("g++")


class _Kernel:
    def __init__(self, library, name):
        self.library, self.function = library, getattr(library, name)

    def __call__(self, grid, block, arguments, shared_mem=0):
        assert shared_mem <= _SHARED and block[0] % 32 == 0 and len(arguments) <= _ARGUMENTS
        words = (ctypes.c_uint64 * _ARGUMENTS)(*(_word(a) for a in arguments))
        size = (*grid, 1)[:2]
        address = ctypes.cast(self.function, ctypes.c_void_p)
        self.library.launch(address, *(ctypes.c_uint(n) for n in size), ctypes.c_uint(block[0]), words)


def _word(argument):
    if isinstance(argument, np.ndarray):
        assert argument.flags.c_contiguous
        return argument.ctypes.data
    assert isinstance(argument, np.int32 | np.uint64), "kernels take int and u64"
    return int(argument) & 0xFFFFFFFFFFFFFFFF


class Emulated:
    """The functions of CuPy that ``dense.cuda`` uses, on arrays of NumPy."""

    empty, zeros, full = staticmethod(np.empty), staticmethod(np.zeros), staticmethod(np.full)
    asarray, asnumpy = staticmethod(np.array), staticmethod(np.array)

    def __init__(self, folder, room=1 << 40):
        self.folder, self.room = folder, room
        self.cuda = SimpleNamespace(runtime=SimpleNamespace(memGetInfo=lambda: (self.room, 1 << 40)))

    def get_default_memory_pool(self):
        return SimpleNamespace(free_bytes=lambda: 0, free_all_blocks=lambda: None)

    def RawModule(self, code, options):
        source = self.folder / "tsgm.cpp"
        source.write_text(f'#include "{HERE / "cuda_emulated.h"}"\n{code}')
        built = self.folder / "tsgm.so"
        flags = ["-O1", "-std=c++17", "-ffp-contract=off", "-shared", "-fPIC", "-w"]
        subprocess.run([compiler(), *flags, str(source), "-o", str(built)], check=True)
        library = ctypes.CDLL(str(built))

        class Module:
            get_function = staticmethod(lru_cache(maxsize=None)(lambda name: _Kernel(library, name)))

        return Module
