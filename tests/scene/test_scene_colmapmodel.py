"""Damaged COLMAP models are refused at once."""

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
