"""Types: a file of its own, because its minute is better spent beside the other slow files than at the end."""

import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.slow
def test_mypy_is_content():
    tool = Path(sys.executable).with_name("mypy")
    done = subprocess.run([tool], cwd=Path(__file__).parents[1], capture_output=True, text=True, check=False)
    assert done.returncode == 0, done.stdout[-4000:]
