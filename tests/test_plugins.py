"""Methods of other packages: the example plug-in as it is installed, and plug-ins that are not there or broken."""

from __future__ import annotations

import re
import sys
from pathlib import Path

import numpy as np
import pytest

import tiegraph
from features_world import features, filled_database, scene
from tiegraph.dense.engine import ENGINES
from tiegraph.errors import EngineMissing, InputError, SettingsError
from tiegraph.evaluate.reference import model_poses
from tiegraph.features.matchblocks import Rules, match_pairs
from tiegraph.features.matchers import Features, matcher
from tiegraph.features.settings import MatchSettings
from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import umeyama
from tiegraph.pipeline.dense import depth_path
from tiegraph.pipeline.files import read_mask
from tiegraph.plugins import chosen
from tiegraph.scan.rigfiles.rigspec import write_rig_toml
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.results import load_depth
from worlds import make_survey, write_gnss, write_times

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


ALL = {
    "masks": {"source": "caption"}, "candidates": {"sources": ["doubling"]}, "features": {"engine": "corners"},
    "match": {"engine": "upright"}, "dense": {"engine": "blocks"}, "products": {"extra": ["slope"]},
}  # fmt: skip


@pytest.mark.slow
@pytest.mark.usefixtures("children_are_functions")
def test_a_survey_is_made_by_the_plugins_of_the_example(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    survey = make_survey(tmp_path / "images", passes=("up",), frames=4, size=(256, 192))
    write_rig_toml(survey.rig, tmp_path / "rig.toml")
    given = {
        "rig": tmp_path / "rig.toml",
        "gnss": write_gnss(survey, tmp_path / "gnss.csv"),
        "times": write_times(survey, tmp_path / "times.csv"),
    }
    with pytest.raises(SettingsError, match="valid are auto, learnt.*no plug-in is installed"):
        tiegraph.open(survey.images, tmp_path / "out", settings=ALL)
    groups = tomllib.loads((EXAMPLE / "pyproject.toml").read_text())["project"]["entry-points"]
    assert len(groups) == len(ALL) == 6, "one of each kind"
    install(tmp_path, groups)
    for folder in (tmp_path, EXAMPLE):
        monkeypatch.syspath_prepend(folder)
    coarse = {"cloud": {"voxel_size": 0.1}}
    project = tiegraph.open(survey.images, tmp_path / "out", settings=ALL | coarse, pool="serial", **given)
    project.run(until="products")
    for stage in ALL:
        assert project.receipt(stage)["software"]["tiegraph-caption"] == "0.1.0", stage
    names = project.scene().names
    masks = [read_mask(project.folder, name) for name in names]
    assert len(masks) == 8 and all(m[:180].all() and not m[180:].any() for m in masks)
    rows = project.pairs().to_pandas(names)
    assert set(rows["source"]) == {"plugin"} and len(rows) == 10, "one and two frames on, of two cameras"
    truth = np.array([transforms.centre(survey.cam_from_world[n]) for n in names[:4]])
    centres = model_poses(project.model(), project.scene()).centres()[:4]
    error = np.linalg.norm(umeyama(centres, truth)(centres) - truth, axis=1)
    assert 1e-5 < np.sqrt(np.mean(error**2)) < 0.02, "metres, along a path of 3 m"
    found = load_depth(depth_path(project.folder, names[1]))
    ratio = found.depth_m / survey.world.depth_m(survey.rig.sensors[0].camera, survey.cam_from_world[names[1]])
    ratio = ratio[np.isfinite(found.depth_m)]
    off = np.median(np.abs(ratio / np.median(ratio) - 1))  # four positions leave the scale uncertain by 1 %
    assert len(ratio) > 20_000 and 1e-4 < off < 0.01
    assert len(list((project.folder / "products").rglob("slope/slope.tif"))) == 2


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


@pytest.fixture
def two() -> tuple[Features, Features]:
    """Features of two images; the last of the second image that match are turned by 90 degrees."""
    (_, points, of_a), (_, others, of_b) = features()[0], features()[2]
    turned = others.copy()
    turned[len(others) // 2 :, 3] = np.pi / 2
    return Features(points, of_a, (640, 480)), Features(turned, of_b, (640, 480))


def test_the_example_matcher_takes_features_that_are_turned_alike(
    two: tuple[Features, Features], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    install(tmp_path, tomllib.loads((EXAMPLE / "pyproject.toml").read_text())["project"]["entry-points"])
    for folder in (tmp_path, EXAMPLE):
        monkeypatch.syspath_prepend(folder)
    every = matcher(MatchSettings())(*two, "a", "b")
    some = matcher(MatchSettings(engine="upright"))(*two, "a", "b")
    assert 50 < len(some) < len(every) and some.dtype == np.uint32
    assert some.tolist() == [row for row in every.tolist() if row[1] < len(two[1]) // 2]


WRONG = {
    "none": ("lambda a, b, s: None", r"gave an array of \(\) object"),
    "flat": ("lambda a, b, s: np.arange(4)", r"gave an array of \(4,\) int\d+"),
    "real": ("lambda a, b, s: np.zeros((3, 2))", r"gave an array of \(3, 2\) float64"),
    "far": ("lambda a, b, s: np.array([[0, len(b)], [1, 2]])", r"gave rows from \[0 2\] to \[ *1 \d+\] of \d+ and"),
    "below": ("lambda a, b, s: np.array([[0, -1]])", r"gave rows from \[ *0 -1\]"),
    "twice": ("lambda a, b, s: np.array([[0, 1], [0, 2]])", "matched a feature twice"),
    "fails": ("lambda a, b, s: 1 / 0", "raised ZeroDivisionError"),
}


def test_a_matcher_that_fails_is_named_with_the_pair_and_the_remedy(
    two: tuple[Features, Features], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    code = "".join(f"{name} = {what}\n" for name, (what, _) in WRONG.items())
    (tmp_path / "wrong_matchers.py").write_text(f"import numpy as np\n{code}")
    groups = {"tiegraph.matchers": {n: f"wrong_matchers:{n}" for n in WRONG} | {"gone": "no_such_module:MATCH"}}
    install(tmp_path, groups)
    monkeypatch.syspath_prepend(tmp_path)
    for name, (_, said) in WRONG.items():
        what = f"match.engine = {name}: the plug-in {said}.* for x.jpg and y.jpg.*set match.engine to nearest"
        with pytest.raises(InputError, match=what):
            matcher(MatchSettings(engine=name))(*two, "x.jpg", "y.jpg")
    with pytest.raises(EngineMissing, match="'gone' of the group tiegraph.matchers cannot be loaded"):
        matcher(MatchSettings(engine="gone"))
    with pytest.raises(ValueError, match="valid are nearest; installed plug-ins: below, .*tiegraph.matchers"):
        MatchSettings(engine="elsewhere")
    with pytest.raises(ValueError, match="guided matching is COLMAP's own"):
        MatchSettings(engine="far", guided=True)


@pytest.mark.slow
@pytest.mark.usefixtures("children_are_functions")
def test_the_rows_of_a_plugin_are_verified_and_its_faults_end_the_stage(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (tmp_path / "own.py").write_text(
        "from tiegraph.features.matchers import by_nearest\ndef half(*given):\n    return by_nearest(*given)[::2]\n"
        "def fails(*given):\n    raise ValueError('no weights')\n"
    )
    install(tmp_path, {"tiegraph.matchers": {"half": "own:half", "fails": "own:fails"}})
    monkeypatch.syspath_prepend(tmp_path)
    pairs = Pairs.make([0, 2], [2, 4], "file")

    def matched(engine: str) -> np.ndarray:
        database = filled_database(tmp_path / f"{engine}.db", scene())
        rules = Rules(MatchSettings(engine=engine))
        return match_pairs(database, scene(), pairs, rules, tmp_path / "log.txt")[0].inliers

    every, half = matched("nearest"), matched("half")
    assert ((0.4 * every < half) & (half < 0.6 * every)).all()
    first, second = (scene().names[k] for k in (0, 2))
    with pytest.raises(InputError, match=f"fails: the plug-in raised ValueError.*no weights.*{first} and {second}"):
        matched("fails")
