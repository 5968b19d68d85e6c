"""Runs the notebooks of docs/notebooks and writes what they print and draw into them:
`python docs/notebooks.py FOLDER`. They run one after another in FOLDER, so that they share its run folder.

The cells of a notebook run in one namespace, without Jupyter: printed text, the value of the last line, figures.
"""

import ast
import base64
import contextlib
import io
import json
import os
import sys
from pathlib import Path
from typing import Any

import matplotlib

FOLDER = Path(__file__).with_name("notebooks")
DPI, QUALITY = 80, 85


def notebooks() -> list[Path]:
    """In the order in which they run."""
    return sorted(FOLDER.glob("*.ipynb"))


def execute(notebook: dict[str, Any]) -> None:
    """Run the cells of a notebook in the present folder and replace their outputs. An error of a cell is raised."""
    matplotlib.use("Agg")
    namespace: dict[str, Any] = {"__name__": "notebook"}
    count = 0
    for cell in notebook["cells"]:
        if cell["cell_type"] == "code":
            count += 1
            cell["execution_count"] = count
            cell["outputs"] = _outputs("".join(cell["source"]), namespace, count)


def _outputs(source: str, namespace: dict[str, Any], count: int) -> list[dict[str, Any]]:
    from matplotlib import pyplot

    body = ast.parse(source).body
    last = body.pop() if body and isinstance(body[-1], ast.Expr) and not source.rstrip().endswith(";") else None
    printed, value = io.StringIO(), None
    with contextlib.redirect_stdout(printed):
        exec(compile(ast.Module(body, []), "cell", "exec"), namespace)
        if isinstance(last, ast.Expr):
            value = eval(compile(ast.Expression(last.value), "cell", "eval"), namespace)
    outputs: list[dict[str, Any]] = []
    if printed.getvalue():
        outputs.append({"name": "stdout", "output_type": "stream", "text": _lines(printed.getvalue())})
    if value is not None:
        shown = {"text/plain": _lines(repr(value))}
        if hasattr(value, "_repr_html_"):
            shown["text/html"] = _lines(value._repr_html_())
        outputs.append({"data": shown, "execution_count": count, "metadata": {}, "output_type": "execute_result"})
    for number in pyplot.get_fignums():
        picture = io.BytesIO()
        pyplot.figure(number).savefig(
            picture, format="jpeg", dpi=DPI, bbox_inches="tight", pil_kwargs={"quality": QUALITY}
        )
        data = {"image/jpeg": base64.b64encode(picture.getvalue()).decode()}
        outputs.append({"data": data, "metadata": {}, "output_type": "display_data"})
    pyplot.close("all")
    return outputs


def _lines(text: str) -> list[str]:
    return text.splitlines(keepends=True)


def main(folder: Path) -> None:
    """Run all notebooks in a folder and write their outputs into them."""
    folder.mkdir(parents=True, exist_ok=True)
    os.chdir(folder)
    for path in notebooks():
        notebook = json.loads(path.read_text("utf-8"))
        execute(notebook)
        path.write_text(json.dumps(notebook, indent=1, ensure_ascii=False) + "\n", "utf-8")


if __name__ == "__main__":
    main(Path(sys.argv[1]))
