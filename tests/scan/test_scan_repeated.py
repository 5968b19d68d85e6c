"""Passes and images that were copied."""

import shutil
from pathlib import Path

from scan_worlds import picture, scan


def survey(root: Path, frames: int = 4) -> None:
    for sensor in ("cam0", "cam1"):
        for k in range(frames):
            picture(root / "up" / sensor / f"{k:06d}.jpg")


def test_a_copied_pass_is_named_with_the_figure(tmp_path: Path) -> None:
    survey(tmp_path)
    shutil.copytree(tmp_path / "up", tmp_path / "up2")
    scene = scan(tmp_path)
    said = [n for n in scene.notes if "repeats" in n]
    assert said == [
        "pass up2 repeats pass up: 8 of 8 images are identical files; pairs between them carry no base, so they are"
        " left out"
    ]
    assert scene.sequences == ("up",) and len(scene) == 8


def test_a_partly_copied_camera_and_a_frozen_one(tmp_path: Path) -> None:
    survey(tmp_path)
    shutil.copy(tmp_path / "up/cam0/000000.jpg", tmp_path / "up/cam1/000002.jpg")
    for k in (2, 3):
        shutil.copy(tmp_path / "up/cam0/000001.jpg", tmp_path / f"up/cam0/{k:06d}.jpg")
    notes = scan(tmp_path).notes
    assert any(n.startswith("folder up/cam1 repeats folder up/cam0: 1 of 4 images") for n in notes)
    assert any(n.startswith("folder up/cam0: 2 of 4 images repeat others of it") for n in notes)


def test_nothing_is_said_of_different_images(tmp_path: Path) -> None:
    survey(tmp_path)
    assert not any("repeat" in n for n in scan(tmp_path).notes)
