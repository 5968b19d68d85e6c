"""Damaged COLMAP models are refused at once."""

import os
from pathlib import Path

import pycolmap
import pytest

from said import refused
from tiegraph.scene.colmapmodel import is_model, read_model


def test_whole_cut_and_odd_models(tmp_path: Path) -> None:
    assert not is_model(tmp_path)
    pycolmap.Reconstruction().write_binary(tmp_path)
    assert is_model(tmp_path) and read_model(tmp_path).num_images() == 0
    (tmp_path / "points3D.bin").write_bytes((10**12).to_bytes(8, "little"))
    with refused("points3D.bin: the file is cut off"):
        read_model(tmp_path)
    (tmp_path / "points3D.bin").unlink()
    with refused("not a readable COLMAP model"):
        read_model(tmp_path)


def model(folder: Path) -> None:
    """Two cameras on a rig, two frames, one point."""
    made = pycolmap.synthesize_dataset(
        pycolmap.SyntheticDatasetOptions(num_rigs=1, num_cameras_per_rig=2, num_frames_per_rig=2, num_points3D=5)
    )
    made.write_binary(folder)


def as_text(folder: Path, images: str, cameras: str = "1 SIMPLE_RADIAL 64 48 70 32 24 0.01\n") -> Path:
    for name, text in ("images", images), ("cameras", cameras):
        (folder / f"{name}.txt").write_bytes(text.encode("utf-8"))
    return folder


def image(k: int, name: str, points: str = "\n") -> str:
    return f"{k} 1 0 0 0 {k} 0 0 1 {name}\n{points}"


@pytest.mark.parametrize(
    ("without", "begin", "end"), [("\n", "", "\n"), ("", "", "\n"), ("\n", "\ufeff# list\n", "\r\n")]
)
def test_text_as_other_programs_write_it(tmp_path: Path, without: str, begin: str, end: str) -> None:
    """Names with blanks; images without points have an empty line or none."""
    images = image(1, "A (1).jpg", without) + image(2, "A (2).jpg", "1 2 -1\n") + image(7, "sub dir/b  c.jpg", without)
    images = (begin + images).replace("\n", end)
    found = read_model(as_text(tmp_path, images)).images  # without points3D.txt
    assert {k: (i.name, i.projection_center().tolist()) for k, i in found.items()} == {
        1: ("A (1).jpg", [-1, 0, 0]),
        2: ("A (2).jpg", [-2, 0, 0]),
        7: ("sub dir/b  c.jpg", [-7, 0, 0]),
    }
    assert found[2].num_points2D() == 1


def test_text_of_rigs_is_read_as_binary_is(tmp_path: Path) -> None:
    (tmp_path / "text").mkdir()
    model(tmp_path)
    binary = read_model(tmp_path)
    binary.write_text(tmp_path / "text")
    text = read_model(tmp_path / "text")
    assert (text.num_frames(), text.num_points3D()) == (2, 5)
    for k, one in binary.images.items():
        assert text.images[k].name == one.name
        assert text.images[k].projection_center() == pytest.approx(one.projection_center(), abs=1e-9)


@pytest.mark.parametrize(
    ("images", "cameras", "words"),
    [
        ("1 1,0 0,0 0,0 0,0 1 0 0 1 a.jpg\n", None, r"images.txt, line 1: neither an image \(.*decimal points"),
        (image(1, "a.jpg") + "1 2\n", None, "line 3: neither an image"),
        ("1 0 0 0 0 1 0 0 1 a.jpg\n", None, "line 1: 0 0 0 0 1 0 0 is no pose"),
        (image(1, "a.jpg") + image(2, "a.jpg"), None, "line 3: a.jpg or its number 2 stands there twice"),
        (image(1, "a.jpg"), "", "cameras.txt: no camera 1, which images.txt has for a.jpg"),
    ],
)
def test_text_that_cannot_be_meant(tmp_path: Path, images: str, cameras: str | None, words: str) -> None:
    as_text(tmp_path, images, *([] if cameras is None else [cameras]))
    with refused(words):
        read_model(tmp_path)


@pytest.mark.timeout(120)
@pytest.mark.parametrize("name", ["cameras", "rigs", "frames", "images", "points3D"])
def test_a_file_cut_anywhere_is_named_at_once(tmp_path: Path, name: str) -> None:
    model(tmp_path)
    assert read_model(tmp_path).num_reg_images() == 4
    path = tmp_path / f"{name}.bin"
    whole = path.read_bytes()
    for size in {*range(0, len(whole), max(1, len(whole) // 40)), len(whole) - 1}:
        path.write_bytes(whole[:size])
        with refused(f"{name}.bin: the file is cut off"):
            read_model(tmp_path)
    path.write_bytes(b"\xff" * 8 + whole[8:])
    with refused(f"{name}.bin: the file is cut off"):
        read_model(tmp_path)


@pytest.mark.timeout(60)
def test_a_pipe_among_its_files_is_refused(tmp_path: Path) -> None:
    model(tmp_path)
    (tmp_path / "images.bin").unlink()
    os.mkfifo(tmp_path / "images.bin")
    with refused("images.bin: cannot be read .a named pipe"):
        read_model(tmp_path)
