"""The scan stage on a folder of videos: pictures are taken once, and again when the setting changes."""

from __future__ import annotations

from pathlib import Path

import cv2
import numpy as np
import pytest

import tiegraph
from tiegraph.api import Project
from tiegraph.errors import InputError


def film(path: Path, seconds: int) -> None:
    path.parent.mkdir(parents=True, exist_ok=True)
    out = cv2.VideoWriter(str(path), cv2.VideoWriter_fourcc(*"MJPG"), 5, (160, 120))
    rng = np.random.default_rng(len(path.name))
    for _ in range(5 * seconds):
        out.write(rng.integers(0, 255, (120, 160, 3), dtype=np.uint8))
    out.release()


def test_pictures_are_taken_and_follow_the_setting(tmp_path: Path) -> None:
    film(tmp_path / "in" / "up.avi", 4)
    (tmp_path / "in" / "broken.mp4").write_bytes(b"\0" * 5000)
    project = tiegraph.open(tmp_path / "in", tmp_path / "out", pool="serial").run("scan")
    scene = project.scene()
    assert [Path(n).name for n in scene.names] == [f"up_{k:06d}.jpg" for k in range(8)]
    assert all((tmp_path / "out" / "images" / n).exists() for n in scene.names)
    assert any("broken.mp4 cannot be decoded" in n for n in receipt_notes(project))
    slower = tiegraph.open(tmp_path / "in", tmp_path / "out", pool="serial", settings={"scan": {"video_fps": 1.0}})
    assert len(slower.run("scan").scene()) == 4


def test_videos_beside_images_are_left_out_and_said(tmp_path: Path) -> None:
    film(tmp_path / "in" / "a.avi", 1)
    for k in range(3):
        cv2.imwrite(str(tmp_path / "in" / f"{k}.png"), np.random.default_rng(k).integers(0, 255, (90, 120, 3)))
    project = tiegraph.open(tmp_path / "in", tmp_path / "out", pool="serial").run("scan")
    assert len(project.scene()) == 3
    assert any("1 videos beside the images are left out" in n for n in receipt_notes(project))


def test_only_broken_videos_are_an_error_that_names_them(tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    (tmp_path / "in" / "broken.mp4").write_bytes(b"\0" * 5000)
    with pytest.raises(InputError, match="broken.mp4 cannot be decoded.*H.264"):
        tiegraph.open(tmp_path / "in", tmp_path / "out", pool="serial").run("scan")


def receipt_notes(project: Project) -> list[str]:
    return {name: receipt for name, _, receipt in project.status()}["scan"]["notes"]
