"""A message names the row that is wrong, whatever stands above it: headers, comments, blank lines, other tables."""

from __future__ import annotations

import json
import re
from collections.abc import Callable
from functools import partial
from pathlib import Path

import numpy as np
import pytest
from scan_worlds import papers_rig, picture, scan

from tiegraph.errors import InputError
from tiegraph.scan.rigfiles.rigfile import read_rig_file
from tiegraph.scan.settings import ScanSettings
from tiegraph.scan.tuning import RigTuning
from tiegraph.scene.gcp import read_gcps
from tiegraph.scene.gnss import read_gnss
from tiegraph.scene.pairs import pair_lines
from tiegraph.scene.posefile import read_poses
from tiegraph.scene.times import out_of_order
from tiegraph.scene.tuning import ControlTuning, GnssTuning

RIG = RigTuning()
ABOVE = "\ufeff# what a person writes above\n\n# more\fof it\n"  # a form feed ends no line in an editor


def _line(text: str) -> int:
    return next(k for k, line in enumerate(re.split("\n", text), start=1) if "WRONG" in line)


@pytest.mark.parametrize(
    "read, text",
    [
        (partial(read_gnss, tuning=GnssTuning()), "time,lat,lon,height\n1,35,139,4\n\n# a pause\n2,35,139,4,5 WRONG\n"),
        (
            partial(read_gcps, tuning=ControlTuning()),
            "name,x,y,z,image,px,py\nA,1,2,3,a.jpg,4,5\n\n# next\nB,1,2,WRONG,a.jpg,4,5\n",
        ),
        (read_poses, "# time x y z qx qy qz qw\n1 0 0 0 0 0 0 1\n\n2 1 0 0 0 0 0 WRONG\n"),
        (pair_lines, "a.jpg b.jpg\n\n# and\na.jpg b.jpg WRONG\n"),
    ],
)
def test_every_table_counts_lines_as_an_editor_does(tmp_path: Path, read: Callable, text: str) -> None:
    path = tmp_path / "table.txt"
    path.write_text(ABOVE + text, encoding="utf-8")
    with pytest.raises(InputError, match=rf"table.txt, line {_line(ABOVE + text)}:"):
        read(path)


def test_odm_rows_too(tmp_path: Path) -> None:
    (tmp_path / "gcp_list.txt").write_text("EPSG:32654\n\n# two\n1 2 3 4 5 a.jpg\n1 2 3 WRONG 5 b.jpg\n")
    with pytest.raises(InputError, match=r"gcp_list.txt, line 5: 'WRONG' is no number"):
        read_gcps(tmp_path / "gcp_list.txt", ControlTuning())


def test_a_key_that_is_missing_is_not_looked_for_in_the_next_sensor(tmp_path: Path) -> None:
    (tmp_path / "rig.toml").write_text(
        '# name = "remark"\n[[sensors]]\nfolder = "a"\n\n[[sensors]]\nname = "b"\n[sensors.camera]\nhfov_deg = 0\n'
    )
    with pytest.raises(InputError, match=r"rig.toml, line 2: sensor 1 needs a name"):
        read_rig_file(tmp_path / "rig.toml", RIG)
    text = (tmp_path / "rig.toml").read_text().replace('folder = "a"', 'name = "a"')
    (tmp_path / "rig.toml").write_text(text)
    with pytest.raises(InputError, match=r"rig.toml, line 8: hfov_deg = 0"):
        read_rig_file(tmp_path / "rig.toml", RIG)


def test_a_camera_of_a_rig_config_is_the_object_and_not_the_next_prefix(tmp_path: Path) -> None:
    cameras = [
        {"ref_sensor": True, "image_prefix": "a/"},
        {"cam_from_rig_rotation": [1, 0, 0, 0], "cam_from_rig_translation": [0, 0], "image_prefix": "b/"},
        {"cam_from_rig_rotation": [1, 0, 0, 0], "cam_from_rig_translation": [0, 0, 0], "image_prefix": "c/"},
    ]
    path = tmp_path / "rig_config.json"
    path.write_text(json.dumps([{"cameras": cameras}], indent=1))
    wrong = next(k for k, t in enumerate(path.read_text().split("\n"), 1) if "translation" in t)
    with pytest.raises(InputError, match=rf"rig_config.json, line {wrong}: cam_from_rig_translation = \[0, 0\]"):
        read_rig_file(path, RIG)
    del cameras[1]["image_prefix"]
    path.write_text(json.dumps([{"cameras": cameras}], indent=1))
    head = [k for k, t in enumerate(path.read_text().split("\n"), 1) if t.strip() == "{"][2]
    with pytest.raises(InputError, match=rf"line {head}: camera 2 needs an image_prefix"):
        read_rig_file(path, RIG)


@pytest.mark.parametrize(
    "times, odd", [([0, 1, 90, 3, 4], [2]), ([9, 1, 2, 3], [0]), ([0, 1, 3, 2, 4], [3]), ([5, 4, 3, 2], [1, 2, 3]),
                   ([0, 1, 1, 2], []), ([], [])]
)  # fmt: skip
def test_a_time_too_large_is_blamed_itself(times: list[float], odd: list[int]) -> None:
    assert out_of_order(np.array(times, float)).tolist() == odd


def test_the_row_of_a_frame_that_stands_off_is_the_one_blamed(tmp_path: Path) -> None:
    images = papers_rig(tmp_path / "in", ("up",), 3, 2)
    rows = [f"up/cam{c}/{k:06d}.jpg,{35.69 + 1e-5 * k:.5f},139.77,40" for c in range(3) for k in range(2)]
    rows[0] = "up/cam0/000000.jpg,35.6902,139.77,40"  # 22 m off; the others of its frame agree
    (tmp_path / "g.csv").write_text("\n".join(["image,lat,lon,height", *rows]) + "\n")
    (note,) = (n for n in scan(images, gnss=tmp_path / "g.csv").notes if "of the same frame" in n)
    assert "g.csv, line 2: up/cam0/000000.jpg lies 22.2 m from up/cam1/000000.jpg" in note


def test_a_rig_is_not_named_after_its_file(tmp_path: Path) -> None:
    path = tmp_path / "final_v3 (2).toml"
    path.write_text('[[sensors]]\nname = "a"\n')
    assert read_rig_file(path, RIG)[0].name == "rig"
    path.write_text('name = "boat"\n[[sensors]]\nname = "a"\n')
    assert read_rig_file(path, RIG)[0].name == "boat"
    (tmp_path / "export17.json").write_text(json.dumps([{"cameras": [{"ref_sensor": True, "image_prefix": "a"}]}]))
    assert read_rig_file(tmp_path / "export17.json", RIG)[0].name == "rig"


# --- positions that are missing, a CRS for none ----------------------------------------------------------------------


def test_frames_without_a_position_are_named_with_how_far_the_rows_are(tmp_path: Path) -> None:
    images = papers_rig(tmp_path / "in", ("up",), 1, 6)
    (tmp_path / "t.csv").write_text("image,time\n" + "".join(f"{k:06d}.jpg,{100 + 10 * k}\n" for k in range(6)))
    times = [*range(98, 111), *range(132, 141)]  # a gap about the frame at 120, and nothing after 140
    rows = "".join(f"{t},{35.69 + 1e-6 * t:.6f},139.77,40\n" for t in times)
    (tmp_path / "g.csv").write_text("time,lat,lon,height\n" + rows)
    notes = scan(images, gnss=tmp_path / "g.csv", times=tmp_path / "t.csv").notes
    (note,) = (n for n in notes if "have no position" in n)
    assert "3 of 6 frames" in note
    assert "up/cam0/000002.jpg (nearest row 10.00 s away, in a gap of 22.00 s)" in note
    assert f"up/cam0/000005.jpg (10.00 s after the last row, line {1 + len(times)})" in note


def test_images_that_no_row_names_are_said(tmp_path: Path) -> None:
    images = papers_rig(tmp_path / "in", ("up",), 1, 8)
    rows = "".join(f"{k:06d}.jpg,{35.69 + 1e-5 * k:.5f},139.77,40\n" for k in range(3))
    (tmp_path / "g.csv").write_text("image,lat,lon,height\n" + rows)
    (note,) = (n for n in scan(images, gnss=tmp_path / "g.csv").notes if "have no position" in n)
    assert "5 of 8 frames have no position: up/cam0/000003.jpg (no row names it)" in note and "and 2 more" in note


@pytest.mark.parametrize("words, crs", [("UTM10N", "EPSG:32610"), ("utm zone 54 s", "EPSG:32754"), ("ENU", "ENU"),
                                        ("WGS84 UTM 1N", "EPSG:32601"), ("UTM61N", "UTM61N")])  # fmt: skip
def test_a_zone_by_its_name_is_its_code(words: str, crs: str) -> None:
    assert ScanSettings(crs=words).crs == crs


def test_a_zone_without_a_hemisphere_is_refused_with_what_is_accepted(tmp_path: Path) -> None:
    for k in range(3):
        picture(tmp_path / f"{k}.jpg")
    with pytest.raises(
        InputError, match=r"'UTM10': EPSG:32610 is .* north .*EPSG:32710 south.*give EPSG:n .*ENU.*auto"
    ):
        scan(tmp_path, ScanSettings(crs="UTM10"))
    assert any("EPSG:32610: nothing here has positions" in n for n in scan(tmp_path, ScanSettings(crs="UTM10N")).notes)
