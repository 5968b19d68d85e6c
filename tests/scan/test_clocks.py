"""Clocks of cameras, receivers and trajectories that differ by days, weeks, 1024 weeks or a fraction of a second."""

from __future__ import annotations

from datetime import datetime, timezone
from pathlib import Path

import numpy as np
import pytest
from scan_worlds import exif_of, papers_rig, picture, scan

from tiegraph.scene.scene import Scene

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
    rows = (f"{t},{35.69 + STEP_DEG * (k - 2):.9f},139.77,40,0.02" for k, t in enumerate(times))
    path.write_text(f"{head},lat,lon,height,sigma\n" + "\n".join(rows) + "\n")
    return path


def moved(scene: Scene) -> np.ndarray:
    return np.diff(scene.world_from_rig[:, 1, 3])


@pytest.mark.parametrize("sub", ["", "25"])
def test_whole_seconds_of_cameras_widen_the_sigma_along_the_way(tmp_path: Path, sub: str) -> None:
    times = [iso(START + k - 2) for k in range(10)]
    scene = scan(flight(tmp_path / "in", sub=sub), gnss=track(tmp_path / "g.csv", times))
    assert moved(scene) == pytest.approx(10.0, abs=0.05)
    along = 0.02 if sub else 10 / np.sqrt(3)  # a time cut to whole seconds is late by 0 to 1 s
    np.testing.assert_allclose(
        scene.position_sigma_m, [[0.02, along, 0.04]] * 5, atol=0.06
    )  # the grid is turned by 0.7 degrees
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
    assert any("no header; by its cells the columns are image, time" in n for n in scene.notes)
