"""Makes the benchmarks folder importable; it is not part of the package."""

import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))
sys.path.append(
    str(Path(__file__).resolve().parents[2] / "benchmarks" / "competitors")
)  # its programs import each other
