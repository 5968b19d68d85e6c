"""``python -m tests.mutants``: make each mistake in a copy of the sources and run the test that must notice it."""

from __future__ import annotations

import argparse
import os
import shutil
import subprocess
import sys
import tempfile
from concurrent.futures import ThreadPoolExecutor
from pathlib import Path

from .table import MUTANTS, Mutant

ROOT = Path(__file__).resolve().parents[2]
# The finder of an editable install stands before PYTHONPATH, in child processes too.
_SITE = "import sys\nsys.meta_path = [f for f in sys.meta_path if type(f).__module__ != '_editable_skbc_tiegraph']\n"
_LIMIT_S = 600


def copied(folder: Path) -> Path:
    """A tree with sources of its own; all else are links."""
    folder.mkdir(parents=True)
    for path in ROOT.iterdir():
        if path.name not in ("src", ".git", ".venv"):
            (folder / path.name).symlink_to(path)
    shutil.copytree(ROOT / "src", folder / "src", ignore=shutil.ignore_patterns("__pycache__"))
    (folder / "site").mkdir()
    (folder / "site" / "sitecustomize.py").write_text(_SITE)
    return folder


def run(test: str, tree: Path) -> subprocess.CompletedProcess:
    """A test with the sources of a tree."""
    paths = os.pathsep.join(str(tree / name) for name in ("site", "src", "."))
    command = [sys.executable, "-m", "pytest", "-x", "-q", "-p", "no:cacheprovider", *test.split()]
    environment = {**os.environ, "PYTHONPATH": paths}
    return subprocess.run(command, cwd=tree, env=environment, capture_output=True, text=True, timeout=_LIMIT_S)


def caught(mutant: Mutant, tree: Path) -> bool:
    """Whether the test of a mistake fails with it."""
    path = tree / mutant.file
    before = path.read_text()
    _write(path, before.replace(mutant.original, mutant.replaced))
    try:
        return run(mutant.test, tree).returncode == 1
    finally:
        _write(path, before)


def _write(path: Path, text: str) -> None:
    """With no byte code left: a mistake of the same size within the same second would not be seen."""
    path.write_text(text)
    for old in (path.parent / "__pycache__").glob(f"{path.stem}.*"):
        old.unlink()


def main(argv: list[str] | None = None) -> int:
    """0 if every mistake is noticed."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--only", nargs="*", default=[""], help="papers (002), or words of what is mistaken")
    parser.add_argument("--jobs", type=int, default=1)
    args = parser.parse_args(argv)
    asked = [m for m in MUTANTS if any(w in f"{m.paper} {m.what} {m.file}" for w in args.only)]
    with tempfile.TemporaryDirectory(prefix="mutants-") as folder:
        trees = [copied(Path(folder) / str(k)) for k in range(args.jobs)]
        tests = sorted({m.test for m in asked})
        broken = [t for t in tests if run(t, trees[0]).returncode != 0]
        if broken:
            sys.stdout.write(f"fail without any mistake: {'; '.join(broken)}\n")
            return 2
        shares = [asked[k :: args.jobs] for k in range(args.jobs)]
        with ThreadPoolExecutor(args.jobs) as pool:
            found = pool.map(lambda share, tree: [(m, caught(m, tree)) for m in share], shares, trees)
            results = [row for part in found for row in part]
    survivors = [m for m, noticed in results if not noticed]
    for m in survivors:
        sys.stdout.write(f"survived: {m.paper}, {m.what} ({m.file}: {m.original!r} -> {m.replaced!r}), {m.test}\n")
    sys.stdout.write(f"{len(asked)} mistakes, {len(survivors)} survived\n")
    return 1 if survivors else 0


if __name__ == "__main__":
    sys.exit(main())
