"""Methods of other packages: the example plug-in as it is installed, and plug-ins that are not there or broken."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import pytest

import tiegraph
from tiegraph.dense.engine import ENGINES
from tiegraph.errors import EngineMissing, SettingsError
from tiegraph.pipeline.files import read_mask
from tiegraph.plugins import chosen
from worlds import make_survey

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

EXAMPLE = Path(__file__).parents[1] / "examples" / "plugin"


def install(folder: Path, groups: dict[str, dict[str, str]]) -> None:
    """What pip leaves of a package for those who look for entry points."""
    info = folder / "tiegraph_caption-0.1.0.dist-info"
    info.mkdir()
    (info / "METADATA").write_text("Metadata-Version: 2.1\nName: tiegraph-caption\nVersion: 0.1.0\n")
    lines = [
        line for group, names in groups.items() for line in (f"[{group}]", *(f"{n} = {v}" for n, v in names.items()))
    ]
    (info / "entry_points.txt").write_text("\n".join(lines) + "\n")


@pytest.mark.slow
def test_the_example_plugin_masks_the_images(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    survey = make_survey(tmp_path / "images", passes=("up",), frames=2, size=(160, 120))
    with pytest.raises(SettingsError, match="valid are auto, learnt.*no plug-in is installed"):
        tiegraph.open(survey.images, tmp_path / "out", settings={"masks": {"source": "caption"}})
    groups = tomllib.loads((EXAMPLE / "pyproject.toml").read_text())["project"]["entry-points"]
    install(tmp_path, groups)
    for folder in (tmp_path, EXAMPLE):
        monkeypatch.syspath_prepend(folder)
    project = tiegraph.open(survey.images, tmp_path / "out", settings={"masks": {"source": "caption"}})
    project.run(until="masks")
    masks = [read_mask(project.folder, name) for name in project.scene().names]
    assert len(masks) == 4 and all(m[:113].all() and not m[113:].any() for m in masks)


@pytest.mark.slow
def test_another_version_of_a_plugin_makes_the_stage_run_again(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    survey = make_survey(tmp_path / "images", passes=("up",), frames=1, size=(64, 48))
    install(tmp_path, {"tiegraph.masks": {"caption": "tiegraph_caption:SOURCE"}})
    for folder in (tmp_path, EXAMPLE):
        monkeypatch.syspath_prepend(folder)
    metadata = tmp_path / "tiegraph_caption-0.1.0.dist-info" / "METADATA"

    def states(source: str) -> list[str]:
        project = tiegraph.open(survey.images, tmp_path / source, settings={"masks": {"source": source}}, pool="serial")
        before = [why for name, why, _ in project.status() if name in ("scan", "masks", "preview")]
        assert project.run(until="preview").receipt("masks")["software"].get("tiegraph-caption") == (
            re.search("Version: (.*)", metadata.read_text().partition("Name")[2])[1] if source == "caption" else None
        )
        return before

    assert states("caption") == states("none") == ["not run yet"] * 3
    metadata.write_text(metadata.read_text().replace("0.1.0", "0.2.0"))
    assert states("none") == states("caption")[:1] * 3 == [""] * 3
    metadata.write_text(metadata.read_text().replace("0.2.0", "0.3.0"))
    assert states("caption") == ["", "changed: the plug-in of masks.source", "masks is out of date"]
    assert states("caption") == [""] * 3


def test_plugins_that_cannot_be_used_are_named(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    install(tmp_path, {"tiegraph.dense": {"deep": "no_such_module:ENGINE"}})
    monkeypatch.syspath_prepend(tmp_path)
    assert tiegraph.open(tmp_path, tmp_path, settings={"dense": {"engine": "deep"}}).settings.dense.engine == "deep"
    with pytest.raises(EngineMissing, match="'deep' of the group tiegraph.dense cannot be loaded.*no_such_module"):
        chosen("dense", "deep", ENGINES)
    with pytest.raises(EngineMissing, match="no plug-in 'deeper'"):
        chosen("dense", "deeper", ENGINES)
    with pytest.raises(SettingsError, match="valid are tsgm, sgbm; installed plug-ins: deep"):
        tiegraph.open(tmp_path, tmp_path, settings={"dense": {"engine": "deeper"}})
