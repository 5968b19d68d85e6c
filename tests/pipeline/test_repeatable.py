"""The same input, settings and version make the same bytes: whatever the pool, the order of hashes and of workers."""

import os
import subprocess
import sys

import pytest

from artefacts import artefacts

pytestmark = pytest.mark.slow
_PATIENCE_S = 400


def test_serial_and_processes_make_the_same_bytes(finished, server, tmp_path):
    """With a rig that is not known, to the world; ``test_resume`` says so of all stages and of a calibrated rig."""
    survey = finished.inputs

    def command(pool: str) -> list[str]:
        asked = ["run", survey / "images", "-o", tmp_path / pool, "--pool", pool, "--until", "georef", "--quiet"]
        given = [word for name in ("gnss", "times") for word in (f"--{name}", survey / f"{name}.csv")]
        return [str(word) for word in (*asked, *given)]

    # The server's order of hashes is drawn.
    serial = server.run(command("serial"), tmp_path / "said", _PATIENCE_S)
    assert serial.good, serial
    subprocess.run(
        [sys.executable, "-m", "tiegraph", *command("local:2")],
        env={**os.environ, "PYTHONHASHSEED": "2"}, timeout=_PATIENCE_S, check=True,
    )  # fmt: skip
    a, b = artefacts(tmp_path / "serial"), artefacts(tmp_path / "local:2")
    assert sorted(a) == sorted(b) and {"world.json", "database.db", "sparse/0/images.bin"} <= set(a)
    assert [name for name in a if a[name] != b[name]] == []
