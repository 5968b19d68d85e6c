"""`tiegraph run --plan`: what a run would need, without making anything."""

import json
import shutil
from collections import namedtuple

import cv2
import numpy as np
import pytest

from tiegraph.cli.main import main
from tiegraph.pipeline import plan as forecast


@pytest.fixture
def images(tmp_path):
    folder = tmp_path / "images"
    folder.mkdir()
    for k in range(6):
        cv2.imwrite(str(folder / f"{k}.png"), np.full((300, 400, 3), k, np.uint8))
    return folder


def plan(images, capsys, *more):
    code = main(["run", str(images), "-o", str(images.parent / "out"), "--plan", *more])
    return code, "".join(capsys.readouterr())


def test_images_disk_and_time_are_said_and_nothing_is_made(images, capsys):
    code, said = plan(images, capsys)
    assert code == 0 and "images: 6" in said and "enough" in said and not (images.parent / "out").exists()
    row = json.loads(plan(images, capsys, "--json")[1].splitlines()[-1])
    assert row["images"] == 6 and 6 * 400 * 300 * 4 < row["dense_bytes"] < 6 * 400 * 300 * 9
    assert 6 * 150e3 < row["model_bytes"] < 6 * 500e3 and row["there_bytes"] == 0
    more = json.loads(plan(images, capsys, "--json", "--features.max-features", "64")[1].splitlines()[-1])
    assert more["model_bytes"] < row["model_bytes"] and more["dense_bytes"] == row["dense_bytes"]


def test_a_disk_that_is_too_small_is_said(images, capsys, monkeypatch):
    usage = namedtuple("usage", "total used free")
    monkeypatch.setattr(shutil, "disk_usage", lambda path: usage(10**9, 10**9 - 10**6, 10**6))
    code, said = plan(images, capsys)
    assert code == 1 and "NOT ENOUGH" in said


def test_what_is_there_already_counts(images, capsys):
    run = images.parent / "out"
    run.mkdir()
    (run / "tiegraph.toml").write_text("")
    (run / "database.db").write_bytes(b"x" * 10**6)
    assert forecast._size(run) == 10**6
    (run / "link").symlink_to(run / "database.db")
    assert forecast._size(run) == 10**6


def test_frames_of_videos_are_counted_by_scan(images, capsys):
    (images / "drive.mp4").write_bytes(b"none is looked at")
    code, said = plan(images, capsys)
    assert code == 0 and "counted by the stage scan" in said and not (images.parent / "out").exists()
