"""The size of the house: ``python -m benchmarks.house [CHECKOUT ...]`` prints one column a checkout of the project.

Lines and files of Python under ``src``, the 90th percentile of the lines of a function, fields of settings and of
Tuning classes, module constants that are numbers outside them, and file names that stand more than once.
"""

from __future__ import annotations

import argparse
import ast
import sys
from collections import Counter
from collections.abc import Iterator
from pathlib import Path

import numpy as np

_ROWS = (
    "lines", "files", "lines of sfm", "lines of network", "files of more than 400 lines", "lines of a function, 90 %",
    "settings", "constants in Tuning", "module constants that are numbers", "file names twice",
)  # fmt: skip


def house(root: Path) -> dict[str, float]:
    """The figures of a checkout by name (``_ROWS``)."""
    files = sorted((root / "src").rglob("*.py"))
    size = {f: len(f.read_text().splitlines()) for f in files}
    trees = {f: ast.parse(f.read_text()) for f in files}
    spans = [n.end_lineno - n.lineno + 1 for t in trees.values() for n in _functions(t) if n.end_lineno]
    fields: Counter[bool] = Counter()
    for file, tree in trees.items():
        for cls in (n for n in ast.walk(tree) if isinstance(n, ast.ClassDef) and _is_section(n)):
            constants = "tuning" in str(file.relative_to(root)) or cls.name.endswith("Tuning")
            fields[constants] += sum(isinstance(n, ast.AnnAssign) for n in cls.body)
    names = Counter(f.name for f in files if f.name != "__init__.py")
    found = (
        sum(size.values()), len(files), _within(size, "sfm"), _within(size, "network"),
        sum(n > 400 for n in size.values()), float(np.percentile(spans, 90)), fields[False], fields[True],
        sum(_is_number(n) for t in trees.values() for n in t.body), sum(n > 1 for n in names.values()),
    )  # fmt: skip
    return dict(zip(_ROWS, found))


def _functions(tree: ast.AST) -> Iterator[ast.FunctionDef]:
    return (n for n in ast.walk(tree) if isinstance(n, ast.FunctionDef))


def _is_section(cls: ast.ClassDef) -> bool:
    return any(isinstance(b, ast.Name) and b.id in ("Section", "Settings", "BaseModel") for b in cls.bases)


def _within(size: dict[Path, int], package: str) -> int:
    return sum(n for f, n in size.items() if package in f.parts)


def _is_number(node: ast.stmt) -> bool:
    value = getattr(node, "value", None) if isinstance(node, (ast.Assign, ast.AnnAssign)) else None
    value = value.operand if isinstance(value, ast.UnaryOp) else value
    return isinstance(value, ast.Constant) and type(value.value) in (int, float)


def main(argv: list[str] | None = None) -> int:
    """Command line; 0."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("checkouts", nargs="*", type=Path, default=[Path(__file__).parents[1]], metavar="CHECKOUT")
    args = parser.parse_args(argv)
    for root in (r for r in args.checkouts if not (r / "src").is_dir()):
        parser.error(f"{root}: no checkout of the project, it has no folder src")
    found = [house(root) for root in args.checkouts]
    for row in _ROWS:
        sys.stdout.write(f"| {row} | " + " | ".join(f"{f[row]:g}" for f in found) + " |\n")
    return 0


if __name__ == "__main__":
    sys.exit(main())
