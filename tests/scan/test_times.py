"""Times of frames by file, name and EXIF; clocks that differ by days, weeks, 1024 weeks or a fraction of a second."""

from __future__ import annotations

import re
from datetime import datetime, timezone
from pathlib import Path

import numpy as np
import pytest
from scan_worlds import Survey, exif_of, papers_rig, picture, scan

from said import refused, says
from tiegraph.scan.priors.times import time_in_name
from tiegraph.scene.scene import Scene
from tiegraph.scene.times import out_of_order

START = 1714564800.0  # 2024-05-01 12:00:00 UTC
STEP_DEG = 10 / 111_000  # 10 m to the north, which is the speed a second


def iso(seconds: float) -> str:
    return datetime.fromtimestamp(seconds, timezone.utc).isoformat()


def flight(folder: Path, start: float = START, sub: str = "") -> Path:
    """Five photographs, one a second."""
    for k in range(5):
        stamp = datetime.fromtimestamp(start + k, timezone.utc).strftime("%Y:%m:%d %H:%M:%S")
        picture(folder / f"{k}.jpg", exif=exif_of(time=stamp, **({"subsec": sub} if sub else {})))
    return folder


def track(path: Path, times: list[str], head: str = "time") -> Path:
    rows = (f"{t},{35.69 + STEP_DEG * (k - 2):.9f},139.77,40,0.02\n" for k, t in enumerate(times))
    path.write_text(f"{head},lat,lon,height,sigma\n" + "".join(rows))
    return path


def moved(scene: Scene) -> np.ndarray:
    return np.diff(scene.world_from_rig[:, 1, 3])


@pytest.mark.parametrize("sub", ["", "25"])
def test_whole_seconds_of_cameras_widen_the_sigma_along_the_way(tmp_path: Path, sub: str) -> None:
    times = [iso(START + k - 2) for k in range(10)]
    scene = scan(flight(tmp_path / "in", sub=sub), gnss=track(tmp_path / "g.csv", times))
    assert moved(scene) == pytest.approx(10.0, abs=0.05)
    along = 0.02 if sub else 10 / np.sqrt(3)  # a time cut to whole seconds is late by 0 to 1 s
    # the grid is turned by 0.7 degrees
    np.testing.assert_allclose(scene.position_sigma_m, [[0.02, along, 0.04]] * 5, atol=0.06)
    said = [n for n in scene.notes if "have whole seconds, in which the receiver moved 5.8 m" in n]
    assert len(said) == (not sub)


@pytest.mark.parametrize("weeks", [1024, 2048])
def test_a_log_1024_weeks_back_is_brought_forward(tmp_path: Path, weeks: int) -> None:
    times = [iso(START + 0.5 + k - 2 - weeks * 604800) for k in range(10)]
    scene = scan(flight(tmp_path / "in", sub="50"), gnss=track(tmp_path / "g.csv", times))
    assert moved(scene) == pytest.approx(10.0, abs=0.05)
    assert any(f"its dates lie {weeks} weeks before the frames'" in n for n in scene.notes)


def test_times_of_day_beside_dated_frames(tmp_path: Path) -> None:
    midnight = START + 43200
    times = [iso(midnight + k - 4)[11:19] for k in range(10)]  # 23:59:56 to 00:00:05
    scene = scan(flight(tmp_path / "in", midnight - 2), gnss=track(tmp_path / "g.csv", times))
    assert moved(scene) == pytest.approx(10.0, abs=0.05) and scene.time_s[0] == midnight - 2


@pytest.mark.parametrize("first", [-2, 1], ids=["frames cross midnight", "frames begin after it"])
@pytest.mark.parametrize("week", [False, True])
def test_rows_and_frames_pass_midnight_at_different_rows(tmp_path: Path, first: int, week: bool) -> None:
    images, turn = papers_rig(tmp_path / "in", ("up",), 1, 6), 604800 if week else 86400

    def clock(k: int) -> str:
        return str(k % turn) if week else iso(k % turn)[11:19]

    name = "gps_sow" if week else "time"
    rows = "".join(f"{k:06d}.jpg,{clock(first + k)}\n" for k in range(6))
    (tmp_path / "t.csv").write_text(f"image,{name}\n{rows}")
    gnss = track(tmp_path / "g.csv", [clock(k) for k in range(-10, 12)], name)
    scene = scan(images, gnss=gnss, times=tmp_path / "t.csv")
    assert moved(scene) == pytest.approx(10.0, abs=0.05)
    (tmp_path / "a.tum").write_text(
        f"{name} x y z qx qy qz qw\n" + "".join(f"{clock(k)} 0 {10 * k} 0 0 0 0 1\n" for k in range(-10, 12))
    )
    scene = scan(images, trajectory=tmp_path / "a.tum", times=tmp_path / "t.csv")
    np.testing.assert_allclose(scene.world_from_rig[:, 1, 3], 10.0 * (first + np.arange(6)), atol=1e-6)
    assert any("a.tum: columns read: " in n for n in scene.notes)


def test_names_below_the_folder_in_which_exiftool_was_called(tmp_path: Path) -> None:
    images = papers_rig(tmp_path / "in", ("up",), 1, 3)
    rows = "".join(f"./in/up/cam0/{k:06d}.jpg,{35.69 + STEP_DEG * k:.9f},139.77,40\n" for k in range(3))
    (tmp_path / "g.csv").write_text("SourceFile,GPSLatitude,GPSLongitude,GPSAltitude\n" + rows)
    assert moved(scan(images, gnss=tmp_path / "g.csv")) == pytest.approx(10.0, abs=0.05)


@pytest.mark.parametrize(
    "text", ["000000.jpg;12:00:00,5\n000001.jpg;12:00:01,5\n", "000000.jpg 43200.5\n000001.jpg 43201.5\n"]
)
def test_times_without_a_header(tmp_path: Path, text: str) -> None:
    images = papers_rig(tmp_path / "in", ("up",), 1, 2)
    (tmp_path / "t.csv").write_text(text)
    scene = scan(images, times=tmp_path / "t.csv")
    assert scene.time_s.tolist() == [43200.5, 43201.5]
    assert says(scene.notes, "no header; by its cells the columns are image, time")


FRAMES = 8  # of ``one_pass``


def times_text(*lines: str, frames: int = FRAMES) -> str:
    return "\n".join(["pass,frame,time", *(f"up,{k:06d},{100 + k}" for k in range(frames)), *lines]) + "\n"


def scan_times(survey: Survey, folder: Path, text: str) -> Scene:
    (folder / "t.csv").write_text(text)
    return survey.scan(times=folder / "t.csv")


@pytest.mark.parametrize(
    "text, words",
    [
        (times_text().replace("up", "down"), r"line 2: none of its 8 rows.*\(down/0\).*the passes here are up"),
        (times_text("up,3,500"), r"line 10: up/3 has the time 500 s, but 103 s in line 5: keep the right one"),
        (times_text("up,8,nan"), r"line 10: 'nan' is no time"),
        (times_text("up,8,inf"), r"line 10: 'inf' is no time"),
        (times_text("up,8,1e308"), r"line 10: '1e308' is no time.*leave out rows without"),
        (times_text("up,8,1,5"), r"line 10: 4 cells below a header of 3"),
        (re.sub(r",\d+\n", ",7\n", times_text()), r"line 2: all 8 frames have the time 7 s: write the time of each"),
        ("image,time\nup/cam0/000001.jpg,1\nup/cam0/000001.jpg,2\n", r"line 3: up/cam0/000001.jpg has the time 2 s"),
        ("frame,time,time\n1,1,2\n", "the column 'time' 2 times"),
    ],
)  # fmt: skip
def test_times_that_cannot_be_meant(one_pass: Survey, tmp_path: Path, text: str, words: str) -> None:
    with refused(words, "t.csv"):
        scan_times(one_pass, tmp_path, text)


@pytest.mark.parametrize(
    "text, words",
    [
        (times_text("down,000001,5"), r"line 10: 1 of 9 rows name frames or images that are not here, such as down/1"),
        (times_text("up,99,500"), r"line 10: 1 of 9 rows .* such as up/99"),
        (times_text("up,3,103"), r"line 10: up/3 is listed twice, with one time"),
        (times_text("up,000007,106", frames=7), r"line 8, 9: two frames of one pass have the time 106 s"),
        (times_text("up,000007,107000", frames=7), r"line 9: time 107000 s is far from the 103.5 s of its pass"),
        ("image,time\nup/cam0/000001.jpg,1\nup/cam1/000001.jpg,31\nup/cam0/000002.jpg,40\n",
         r"line 2, 3: images of one frame are 30.00 s apart"),
    ],
)  # fmt: skip
def test_times_that_are_said(one_pass: Survey, tmp_path: Path, text: str, words: str) -> None:
    scene = scan_times(one_pass, tmp_path, text)
    assert says(scene.notes, words) and np.isfinite(scene.time_s).any(), scene.notes


def test_good_times_say_nothing(one_pass: Survey, two_passes: Survey, tmp_path: Path) -> None:
    for text in (times_text(), times_text().replace("up,", ",")):
        scene = scan_times(one_pass, tmp_path, text)
        assert scene.time_s.tolist() == [100.0 + k for k in range(FRAMES)]
        assert [n for n in scene.notes if "t.csv" in n] == ["t.csv: columns read: pass, frame, time"]
    rows = [f"{p},{k},{t + k}\n" for p, t in (("up", 0), ("down", 90000)) for k in range(3)]
    both = "pass,frame,time\n" + "".join(rows)
    assert not says(scan_times(two_passes, tmp_path, both).notes, "t.csv(?!: columns read)")
    scene = scan_times(two_passes, tmp_path, both + "sideways,0,1\n")
    assert says(scene.notes, r"line 8: 1 of 7 rows .* such as sideways/0")


def test_a_pass_whose_folders_have_no_name(one_pass: Survey, tmp_path: Path) -> None:
    bare = Survey(one_pass.images / "up")
    scene = scan_times(bare, tmp_path, times_text())
    assert scene.sequences == ("all",) and says(scene.notes, "line 2: pass 'up' is taken as the only pass here")
    with refused("the passes here are all"):
        scan_times(bare, tmp_path, times_text("down,0,500"))


@pytest.mark.parametrize(
    "names, exif, words",
    [
        ("{k}.jpg", {"time": "2024:01:01 10:00:00"}, "EXIF: all 3 frames.* the same, 2024-01-01 10:00:00: not used"),
        ("20240101_100000_{k}.jpg", {}, "file names: all 3 frames.* the same, 2024-01-01 10:00:00: not used"),
    ],
)
def test_one_time_for_all_photographs_is_not_used(tmp_path: Path, names: str, exif: dict, words: str) -> None:
    for k in range(3):
        picture(tmp_path / names.format(k=k), exif=exif_of(**exif))
    scene = scan(tmp_path)
    assert says(scene.notes, words) and np.isnan(scene.time_s).all()


@pytest.mark.parametrize(
    "text, message",
    [
        ("name,when\na,1\n", "found the columns name, when; expected time and image"),
        ("frame,time\n0,1\n", "2 passes: add a column pass"),
        ("pass,frame,time\nup,0,soon\n", "line 2: 'soon' is no time"),
        ("image,time\nx.jpg,1\n", "none of its 1 rows names an image"),
    ],
)
def test_times_files_that_cannot_be_used(two_passes: Survey, tmp_path: Path, text: str, message: str) -> None:
    with refused(message):
        scan_times(two_passes, tmp_path, text)


def test_times_by_image_and_frames_in_time_order(tmp_path: Path) -> None:
    survey = Survey(papers_rig(tmp_path / "in", ("up",), 2, 3))
    rows = "up/cam0/000000.jpg,30\nup/cam1/000001.jpg,20\nup/cam0/000002.jpg,10\n"
    scene = scan_times(survey, tmp_path, f"image,time\n{rows}")
    assert scene.time_s.tolist() == [10, 20, 30] and scene.sequence_index.tolist() == [0, 1, 2]
    assert scene.names[int(np.flatnonzero(scene.frame == 0)[0])] == "up/cam0/000002.jpg"
    assert says(scene.notes, "ordered by time")


@pytest.mark.parametrize(
    "stem, seconds",
    [("1557539956.400135", 1557539956.400135), ("cam_1557539956400135", 1557539956.400135),
     ("1557539956400", 1557539956.4), ("1557539956400135123", 1557539956.400135), ("IMG_20230915_010000", 1694739600.0),
     ("20230915010000500", 1694739600.5),
     ("000123", np.nan), ("9999999999", np.nan), ("IMG_20239915_010000", np.nan)],
)  # fmt: skip
def test_times_in_names(stem: str, seconds: float) -> None:
    assert time_in_name(stem) == pytest.approx(seconds, abs=1e-5, nan_ok=True)


@pytest.mark.parametrize(
    "times, odd", [([0, 1, 90, 3, 4], [2]), ([9, 1, 2, 3], [0]), ([0, 1, 3, 2, 4], [3]), ([5, 4, 3, 2], [1, 2, 3]),
                   ([0, 1, 1, 2], []), ([], [])]
)  # fmt: skip
def test_a_time_too_large_is_blamed_itself(times: list[float], odd: list[int]) -> None:
    assert out_of_order(np.array(times, float)).tolist() == odd
