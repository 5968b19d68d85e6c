import numpy as np
import pytest

from masks_world import write
from tiegraph.errors import InputError
from tiegraph.masks.compare import compare, table_text


def mask(used_columns, shape=(10, 20)):
    out = np.zeros(shape, np.uint8)
    out[:, used_columns] = 255
    return out


def test_figures_per_camera_and_together(tmp_path):
    found, truth = tmp_path / "found", tmp_path / "truth"
    write(found / "up/cam0/a.jpg.png", mask(slice(0, 10)))
    write(truth / "up/cam0/a.jpg.png", mask(slice(5, 20)))
    write(found / "up/cam1/a.jpg.png", mask(slice(0, 20)))
    write(truth / "up/cam1/a.png", mask(slice(0, 20)))
    write(found / "up/cam1/b.jpg.png", mask(slice(0, 20)))  # no truth: left out
    result = compare(found, truth)
    cam0, cam1, both = result.rows
    assert [r.camera for r in result.rows] == ["cam0", "cam1", "all"]
    assert [r.images for r in result.rows] == [1, 1, 2]
    assert (cam0.accuracy, cam0.iou) == (0.25, 0.25)
    assert (cam0.useful_lost, cam0.useless_kept) == (pytest.approx(10 / 15), 1.0)
    assert (cam1.accuracy, cam1.iou, cam1.useful_lost) == (1.0, 1.0, 0.0)
    assert np.isnan(cam1.useless_kept)
    assert both.accuracy == pytest.approx(25 / 40) and both.iou == pytest.approx(25 / 40)
    assert result.table()["rows"][1] == ["cam1", 1, 100.0, 100.0, 0.0, None]
    lines = table_text(result.table()).splitlines()
    assert len(lines) == 4 and len({len(line) for line in lines}) == 1 and lines[2].endswith("-")


def test_labels_as_truth_and_given_cameras(tmp_path):
    labels = np.repeat(np.arange(5, dtype=np.uint8), 4)[None] * np.ones((10, 1), np.uint8)
    write(tmp_path / "truth/a.png", labels)
    write(tmp_path / "found/a.jpg.png", mask(slice(16, 20)))
    rows = compare(tmp_path / "found", tmp_path / "truth", {"a.jpg": "left"}, keep_labels=(4,)).rows
    assert rows[0].camera == "left" and rows[0].accuracy == 1.0


def test_errors(tmp_path):
    found, truth = tmp_path / "found", tmp_path / "truth"
    with pytest.raises(InputError, match="no such folder"):
        compare(found, truth)
    write(found / "cam0/a.jpg.png", mask(slice(0, 5)))
    with pytest.raises(InputError, match="no true mask for any of 1"):
        compare(found, truth)
    write(truth / "cam0/a.jpg.png", mask(slice(0, 5), (12, 20)))
    with pytest.raises(InputError, match=r"a\.jpg\.png: 20 x 10 pixels, but .* has 20 x 12"):
        compare(found, truth)
    write(truth / "cam0/b.jpg.png", mask(slice(0, 5)))
    with pytest.raises(InputError, match=r"no mask for cam0/b\.jpg, which has a true one"):
        compare(found, truth, {"cam0/b.jpg": "cam0"})
