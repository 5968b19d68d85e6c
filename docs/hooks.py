"""What the site has beside `docs/*.md` (a hook of mkdocs): DESIGN.md, CONTRIBUTING.md, notebooks, a chapter for each
package.

A chapter is made of the docstrings of the package and of its modules, in which the reasons stand. They are read as
text: nothing of the package is imported, and nothing is downloaded.
"""

import ast
import json
from pathlib import Path
from typing import Any

from mkdocs.config.defaults import MkDocsConfig
from mkdocs.structure.files import File, Files

ROOT = Path(__file__).parents[1]
SOURCE = ROOT / "src" / "tiegraph"
PAGES = {"DESIGN.md": "design.md", "CONTRIBUTING.md": "contributing.md"}
CHAPTERS = ("project", "pipeline", "scan", "masks", "network", "design", "features", "sfm", "dense", "cloud")
CHAPTERS += (
    "products",
    "mesh",
    "evaluate",
    "report",
    "calibrate",
    "plan",
    "lidar",
    "odometry",
    "watch",
    "targets",
    "stations",
    "export",
    "view",
    "scene",
    "geometry",
    "papers",
    "cli",
)


def on_config(config: MkDocsConfig) -> MkDocsConfig:
    """The chapters into the table of contents."""
    for entry in config.nav or ():
        if isinstance(entry, dict):
            for key in (k for k, pages in entry.items() if not pages):
                entry[key] = [{name: f"reasons/{name}.md"} for name in CHAPTERS]
    return config


def on_files(files: Files, config: MkDocsConfig) -> Files:
    """The pages that lie elsewhere, or are made here."""
    for name, page in PAGES.items():
        files.append(File.generated(config, page, content=inside((ROOT / name).read_text())))
    for path in sorted((ROOT / "docs" / "notebooks").glob("*.ipynb")):
        content = shown(json.loads(path.read_text("utf-8")), path.name)
        files.append(File.generated(config, f"notebooks/{path.stem}.md", content=content))
    for name in CHAPTERS:
        files.append(File.generated(config, f"reasons/{name}.md", content=chapter(name)))
    return files


def on_page_markdown(markdown: str, **_: object) -> str:
    """Links from docs/ to the files beside it."""
    return markdown.replace("../DESIGN.md", "design.md").replace("](../benchmarks/README.md)", "](benchmarks.md)")


def inside(text: str) -> str:
    """A page of the root folder, with the links that it needs in docs/."""
    for name, page in PAGES.items():
        text = text.replace(f"]({name})", f"]({page})")
    return text.replace("](docs/", "](").replace("](benchmarks/README.md)", "](benchmarks.md)")


def chapter(name: str) -> str:
    """The docstrings of a package and of its modules; those that say no more than their first line are a list."""
    package = SOURCE / name
    parts = [f"# {name}", ""]
    short: list[str] = []
    for path in sorted(package.rglob("*.py"), key=lambda p: (p.parent.parts, p.name != "__init__.py", p.name)):
        module = ".".join(path.relative_to(SOURCE.parent).with_suffix("").parts).removesuffix(".__init__")
        said = ast.get_docstring(ast.parse(path.read_text())) or ""
        if "\n\n" in said or path.name == "__init__.py":
            parts += [f"::: {module}", ""]
        else:
            short.append(f"* `{module}`: {' '.join(said.split())}")
    return "\n".join([*parts, *(["## Other modules", "", *short] if short else []), ""])


def shown(notebook: dict[str, Any], name: str) -> str:
    """A notebook as a page: its text, its code and what that gave when `docs/notebooks.py` ran it."""
    parts = []
    for cell in notebook["cells"]:
        source = "".join(cell["source"])
        code = cell["cell_type"] == "code"
        parts.append(f"```python\n{source}\n```" if code else source.replace(".ipynb)", ".md)"))
        parts += [_output(output.get("data", {"text/plain": output.get("text")})) for output in cell.get("outputs", ())]
    return "\n\n".join([*parts, f"Run it yourself: [{name}]({name}).", ""])


def _output(data: dict[str, Any]) -> str:
    if "image/jpeg" in data:
        return f'<p><img alt="" src="data:image/jpeg;base64,{data["image/jpeg"]}"></p>'
    if "text/html" in data:
        return "<div>" + "".join(line.strip() for line in data["text/html"]) + "</div>"
    return "```text\n" + "".join(data["text/plain"]).rstrip() + "\n```"
