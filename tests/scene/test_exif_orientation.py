"""The orientation alone, from the head of a file."""

from pathlib import Path

import pytest
from PIL import Image

from tiegraph.scene.exif import orientation_of


@pytest.mark.parametrize(("written", "read"), [(8, 8), (3, 3), (9, 1), (0, 1), (None, 1)])
def test_orientation_is_read_and_1_where_nothing_says_it(tmp_path: Path, written: int | None, read: int) -> None:
    exif = Image.Exif()
    if written is not None:
        exif[0x0112] = written
    Image.new("RGB", (4, 3)).save(tmp_path / "a.jpg", exif=exif)
    assert orientation_of(tmp_path / "a.jpg") == read
    (tmp_path / "b.jpg").write_bytes(b"no image")
    assert orientation_of(tmp_path / "b.jpg") == orientation_of(tmp_path / "none.jpg") == 1
