"""The ladder of real surveys: what stands in its table, its errors, its sets, and what is said of a missing one."""

import json
from pathlib import Path

import numpy as np
import pycolmap
import pytest
from benchmarks.accuracy import mark_error
from benchmarks.datasets import Mark
from benchmarks.real import __main__ as ladder
from benchmarks.real.sets import Survey, middlebury, surveys
from benchmarks.real.table import DOCUMENT, MARKERS, sources, table, write
from PIL import Image

from tiegraph.errors import InputError

_ROW = {"set": "ET", "status": "done", "largest": 9, "points": 900, "pairs": {"verified": 30, "inliers": 6000}}


def test_the_table_has_tiegraph_beside_the_others_and_its_share_of_colmap() -> None:
    rows = [
        {**_ROW, "competitor": "tiegraph", "cpu_s": 3.0, "ate_m": 0.5},
        {**_ROW, "competitor": "colmap_spatial", "cpu_s": 6.0, "ate_m": None, "marks": {"rmse_m": 1.0}},
        {"set": "ET", "competitor": "openmvg", "status": "failed", "reason": "code -11"},
    ]
    text = table({"machine": {"cores": 1}, "runs": rows}, list(surveys().values())).splitlines()
    assert len(text) == 5
    assert text[4] == (
        "| `ET` | 9 | 9 / 9 / - (1.00) | 900 / 900 / - (1.00) | 30 / 30 / - (1.00) | 6000 / 6000 / - (1.00) "
        "| 0.5 / 1 / - (0.50) | 3 / 6 / - (0.50) | - | - | openmvg: code -11 |"
    )


def test_there_are_many_sets_of_many_kinds_with_source_and_licence() -> None:
    found = list(surveys().values())
    assert len(found) >= 24 and len({s.kind for s in found}) >= 8
    assert all(8 <= s.count <= 520 and s.licence and "/" in s.repository for s in found)
    assert [s.count for s in found] == sorted(s.count for s in found)
    assert not any(s.name.startswith(("castle", "entry")) for s in found)
    (begin, end), _ = MARKERS
    said = f"{begin}\n{sources(found)}\n{end}"
    assert DOCUMENT.read_text().count(said) == 1, "python -m benchmarks.real --write"


def test_writing_replaces_what_stands_between_the_markers(tmp_path: Path) -> None:
    page = tmp_path / "README.md"
    page.write_text("head\n" + "\n".join(f"{begin}\nold\n{end}" for begin, end in MARKERS) + "\ntail\n")
    write("figures", [_survey(1)], page)
    text = page.read_text()
    assert "old" not in text and text.startswith("head\n") and text.endswith("tail\n")
    assert text.count("figures\n") == 1 and "some/where" in text


def _survey(count: int) -> Survey:
    return Survey("x", "some/where", "images", "k", "c", (4, 3), count, "none", below_mib=0.01)


def test_a_missing_set_says_how_to_get_it_and_a_changed_one_is_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="git clone .*github.com/some/where"):
        _survey(2).files(tmp_path)
    folder = tmp_path / "where" / "images"
    folder.mkdir(parents=True)
    for name in ("a.JPG", "b.png", "notes.txt", "large.jpg"):
        (folder / name).write_bytes(bytes(20_000 if name == "large.jpg" else 9))
    assert list(_survey(2).files(tmp_path)) == ["a.JPG", "b.png"]
    with pytest.raises(InputError, match="2 images .* the ladder has 3"):
        _survey(3).files(tmp_path)


def test_a_row_is_kept_as_soon_as_its_run_ends(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    images = tmp_path / "where" / "images"
    images.mkdir(parents=True)
    Image.new("RGB", (4, 3)).save(images / "a.png")
    asked: list[str] = []

    def one(dataset: object, competitor: str, *_: object) -> dict:
        asked.append(competitor)
        if len(asked) > 2:
            raise KeyboardInterrupt
        stages = [{"stage": "sparse", "peak_mib": 12.0}]
        return {"set": "x", "competitor": competitor, "status": "done", "wall_s": 1.0, "stages": stages}

    monkeypatch.setattr(ladder, "surveys", lambda: {"x": _survey(1)})
    monkeypatch.setattr(ladder.run, "run_one", one)
    monkeypatch.setattr(ladder.os, "sched_setaffinity", lambda *_: None)
    words = ["--root", str(tmp_path), "--work", str(tmp_path / "work"), "-o", str(tmp_path / "r.json")]
    with pytest.raises(KeyboardInterrupt):
        ladder.main([*words, "--sets", "x"])
    rows = json.loads((tmp_path / "r.json").read_text())["runs"]
    assert [(r["competitor"], r["images"], r["peak_mib"]) for r in rows] == [
        ("tiegraph", 1, 12.0),
        ("colmap_exhaustive", 1, 12.0),
    ]


def _model(turned: bool) -> pycolmap.Reconstruction:
    """Four cameras 1 m apart at height 0 that look along z, 40 x 30 pixels, or 30 x 40 if ``turned``."""
    model = pycolmap.Reconstruction()
    size = (30, 40) if turned else (40, 30)
    camera = pycolmap.Camera(model="PINHOLE", width=size[0], height=size[1], params=[50, 50, size[0] / 2, size[1] / 2])
    camera.camera_id = 1
    model.add_camera_with_trivial_rig(camera)
    for k in range(4):
        pose = pycolmap.Rigid3d(pycolmap.Rotation3d(), np.array([-float(k), 0, 0]))
        image = pycolmap.Image(name=f"{k}.jpg", camera_id=1, image_id=k + 1)
        model.add_image_with_trivial_frame(image, pose)
    return model


@pytest.mark.parametrize("turned", [False, True])
def test_control_points_measure_a_model_in_stored_and_in_upright_images(turned: bool) -> None:
    """The marks are pixels of the upright image, 30 x 40, of an image that EXIF turns by 90 degrees (8)."""
    model = _model(turned)
    places = np.array([[1.0, 0.2, 9], [2.0, -0.5, 11], [0.5, 0.9, 10], [1.7, 0.4, 8]])
    marks = []
    for place, error in zip(places, (0.0, 0.0, 0.0, 0.3)):
        surveyed = tuple((3 * (place + [error, 0, 0]) + [100, 200, 5]).tolist())
        for image in model.images.values():
            x, y = image.project_point(place)
            upright = (x, y) if turned else (y, 40 - x)
            marks.append(Mark(image.name, surveyed, upright, 8))
    found = mark_error(model, tuple(marks))
    assert found["points"] == 4 and found["marks"] == 16 and found["median_px"] < 1e-6
    assert 0.02 < found["rmse_m"] < 0.9  # 0.3 model units of one point, at the scale 3, partly taken up by the fit


def test_published_poses_are_read(tmp_path: Path) -> None:
    k, r = "1500 0 300 0 1500 200 0 0 1", "0 -1 0 1 0 0 0 0 1"
    (tmp_path / "par.txt").write_text(f"1\na.png {k} {r} 0.1 0.2 0.3\n")
    (pose,) = middlebury(tmp_path / "par.txt").values()
    np.testing.assert_allclose(pose, [[0, -1, 0, 0.1], [1, 0, 0, 0.2], [0, 0, 1, 0.3], [0, 0, 0, 1]])
