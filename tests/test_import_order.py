"""pycolmap loaded before the system's zlib ends the process at the first PNG; tiegraph loads zlib first."""

import subprocess
import sys


def _run(code: str) -> subprocess.CompletedProcess:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)


def test_png_can_be_written_after_tiegraph_and_pycolmap_are_imported(tmp_path):
    target = tmp_path / "x.png"
    code = f"import tiegraph, pycolmap, cv2, numpy; cv2.imwrite({str(target)!r}, numpy.arange(900.).reshape(30, 30))"
    done = _run(code)
    assert done.returncode == 0, done.stderr
    assert target.stat().st_size > 0
