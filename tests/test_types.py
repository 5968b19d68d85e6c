"""Types: a file of its own, because its time is better spent beside the other slow files than at the end."""

import subprocess
import sys
from pathlib import Path

import pytest


@pytest.mark.slow
def test_pyrefly_is_content():
    tool = Path(sys.executable).with_name("pyrefly")
    command = [tool, "check", "--output-format", "min-text"]
    done = subprocess.run(command, cwd=Path(__file__).parents[1], capture_output=True, text=True, check=False)
    assert done.returncode == 0, (done.stdout + done.stderr)[-4000:]
