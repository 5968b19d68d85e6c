"""What libraries print during a run is in its log, and what tiegraph says on the terminal."""

from __future__ import annotations

import os
import sys
from pathlib import Path

import numpy as np
import pytest
from PIL import Image
from PIL.TiffImagePlugin import ImageFileDirectory_v2

from campaign.process import Server
from tiegraph.project.folder import LOG, working_in

WARNING = "TIFFReadDirectory: Warning, Unknown field with tag 50000 (0xc350) encountered."


def test_a_library_writes_to_the_log_and_we_to_the_terminal(tmp_path: Path, capfd: pytest.CaptureFixture) -> None:
    before = sys.stderr
    with working_in(tmp_path / "run"):
        os.write(2, f"{WARNING}\n".encode())
        sys.stderr.write("ours\n")
    os.write(2, b"later\n")
    said = capfd.readouterr().err
    assert "TIFF" not in said and said.count("ours") == 1 and "later" in said
    assert (tmp_path / "run" / LOG).read_text().count(WARNING) == 1
    with pytest.raises(KeyboardInterrupt), working_in(tmp_path / "run"):  # an error within gives it back
        raise KeyboardInterrupt
    os.write(2, b"back\n")
    assert sys.stderr is before and "back" in capfd.readouterr().err


@pytest.mark.slow
def test_images_with_odd_tags_do_not_fill_the_terminal(server: Server, tmp_path: Path) -> None:
    (tmp_path / "in").mkdir()
    rng = np.random.default_rng(0)
    for k in range(3):
        tags = ImageFileDirectory_v2()
        tags[50000], tags.tagtype[50000] = "hello", 2
        pixels = rng.integers(0, 4000, (48, 64)).astype(np.uint16)
        Image.fromarray(pixels).save(tmp_path / "in" / f"IMG_{k:04d}.tif", tiffinfo=tags)
    asked = ["run", tmp_path / "in", "-o", tmp_path / "out", "--until", "scan", "--pool", "serial"]
    ended = server.run(asked, tmp_path / "said", 300)
    assert ended.good and "TIFF" not in ended.text and "3 images" in ended.text, ended
    assert (tmp_path / "out" / LOG).read_text().count("Unknown field with tag 50000") >= 3
