"""Damaged COLMAP models are refused at once."""

import os
from pathlib import Path

import pycolmap
import pytest

from tiegraph.errors import InputError
from tiegraph.scene.colmapmodel import is_model, read_model


def test_whole_cut_and_odd_models(tmp_path: Path) -> None:
    assert not is_model(tmp_path)
    pycolmap.Reconstruction().write_binary(tmp_path)
    assert is_model(tmp_path) and read_model(tmp_path).num_images() == 0
    (tmp_path / "points3D.bin").write_bytes((10**12).to_bytes(8, "little"))
    with pytest.raises(InputError, match="points3D.bin: the file is cut off"):
        read_model(tmp_path)
    (tmp_path / "points3D.bin").unlink()
    with pytest.raises(InputError, match="not a readable COLMAP model"):
        read_model(tmp_path)


def model(folder: Path) -> None:
    """Two cameras on a rig, two frames, one point."""
    made = pycolmap.synthesize_dataset(
        pycolmap.SyntheticDatasetOptions(num_rigs=1, num_cameras_per_rig=2, num_frames_per_rig=2, num_points3D=5)
    )
    made.write_binary(folder)


@pytest.mark.timeout(120)
@pytest.mark.parametrize("name", ["cameras", "rigs", "frames", "images", "points3D"])
def test_a_file_cut_anywhere_is_named_at_once(tmp_path: Path, name: str) -> None:
    model(tmp_path)
    assert read_model(tmp_path).num_reg_images() == 4
    path = tmp_path / f"{name}.bin"
    whole = path.read_bytes()
    for size in {*range(0, len(whole), max(1, len(whole) // 40)), len(whole) - 1}:
        path.write_bytes(whole[:size])
        with pytest.raises(InputError, match=f"{name}.bin: the file is cut off"):
            read_model(tmp_path)
    path.write_bytes(b"\xff" * 8 + whole[8:])
    with pytest.raises(InputError, match=f"{name}.bin: the file is cut off"):
        read_model(tmp_path)


@pytest.mark.timeout(60)
def test_a_pipe_among_its_files_is_refused(tmp_path: Path) -> None:
    model(tmp_path)
    (tmp_path / "images.bin").unlink()
    os.mkfifo(tmp_path / "images.bin")
    with pytest.raises(InputError, match="images.bin: cannot be read .a named pipe"):
        read_model(tmp_path)
