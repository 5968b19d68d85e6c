"""The lowest versions that pyproject.toml allows, as constraints for pip: `python packaging/lowest.py > lowest.txt`."""

import re
import sys
from pathlib import Path

PROJECT = Path(__file__).resolve().parents[1] / "pyproject.toml"


def lowest(text: str) -> list[str]:
    """``name==version.*`` for each dependency of a pyproject.toml; read without a TOML library, which 3.10 lacks."""
    block = text.partition("\ndependencies = [")[2].partition("\n]")[0]
    return [f"{name}=={version}.*" for name, version in re.findall(r'"([\w-]+)(?:\[\w+\])?>=([\d.]+)', block)]


if __name__ == "__main__":
    sys.stdout.write("\n".join(lowest(PROJECT.read_text())) + "\n")
