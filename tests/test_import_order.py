"""What is imported in which order, and what not: pycolmap loaded before the system's zlib ends the process at the first
PNG, so tiegraph loads zlib first."""

import subprocess
import sys

import pytest

pytestmark = pytest.mark.slow


def _run(code: str) -> subprocess.CompletedProcess:
    return subprocess.run([sys.executable, "-c", code], capture_output=True, text=True, timeout=60)


def test_png_can_be_written_after_tiegraph_and_pycolmap_are_imported(tmp_path):
    target = tmp_path / "x.png"
    code = f"import tiegraph, pycolmap, cv2, numpy; cv2.imwrite({str(target)!r}, numpy.arange(900.).reshape(30, 30))"
    done = _run(code)
    assert done.returncode == 0, done.stderr
    assert target.stat().st_size > 0


def test_a_child_starts_without_what_few_functions_need():
    """Every child and worker of every run pays for what is loaded at its start; these would cost 0.4 CPU s more."""
    done = _run("import sys, tiegraph.pipeline.features, tiegraph.sfm.mapper; print(*sys.modules)")
    few = {"scipy.optimize", "scipy.interpolate", "scipy.fft", "scipy.stats", "pyproj", "matplotlib", "laspy"}
    loaded = set(done.stdout.split())
    assert "scipy.spatial" in loaded and not few & loaded, done.stderr


def test_a_child_starts_without_validators_that_it_does_not_need():
    """Constants are built at first use, each class once: as the default of a field it would be built at import."""
    code = "import tiegraph.project.settings as s; print(s.Settings.__pydantic_complete__, end=' '); s.Settings()"
    done = _run(f"{code}; print(s.Settings.__pydantic_complete__, s.SceneTuning.__pydantic_complete__)")
    assert done.stdout.split() == ["False", "True", "True"], done.stderr


def test_all_engines_load_without_the_native_modules():
    """As installed where there is no C++ compiler, and on Windows."""
    hidden = "import sys; sys.modules.update({'tiegraph.dense._sgm': None, 'tiegraph.features._nearest': None})"
    loaded = "import tiegraph.arrays, tiegraph.pipeline; tiegraph.pipeline.load(None)"
    done = _run(f"{hidden}; {loaded}; from tiegraph.cli.doctor import findings; print(*findings(), sep='\\n')")
    assert done.returncode == 0, done.stderr
    assert "OpenCV's matcher" in done.stdout and "NumPy finds the nearest descriptors" in done.stdout
