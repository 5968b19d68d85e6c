"""Masks from files: found by their names, read, refused with the reason, compared with true ones."""

import cv2
import numpy as np
import pytest
from PIL import Image

from masks_world import write
from tiegraph.errors import InputError
from tiegraph.masks.folder import (
    candidates,
    check_folder,
    compare,
    find_mask,
    read_folder_mask,
    read_mask_file,
    table_text,
)

SIZE = (48, 64)
NAME = "up/cam0/a.jpg"


def half(high=255):
    mask = np.zeros(SIZE, np.uint8)
    mask[:, 32:] = high
    return mask


@pytest.mark.parametrize(
    "file", "up/cam0/a.jpg.png up/cam0/a_mask.png up/cam0/a.mask.png up/cam0/a.png up/cam0.png cam0.png".split()
)
def test_every_naming_is_found(tmp_path, file):
    write(tmp_path / file, half())
    mask = read_folder_mask(tmp_path, NAME, SIZE)
    assert mask.dtype == bool and (mask == (half() > 0)).all()
    check_folder(tmp_path, [NAME])


def test_the_mask_of_the_image_goes_before_that_of_the_camera(tmp_path):
    """And the folder images of a name may be left away."""
    write(tmp_path / "cam0.png", half())
    write(tmp_path / "up/cam0/a.jpg.png", 255 - half())
    assert find_mask(tmp_path, NAME) == tmp_path / "up/cam0/a.jpg.png"
    assert find_mask(tmp_path, "up/cam0/b.jpg") == tmp_path / "cam0.png"
    write(tmp_path / "up/cam0/a.jpg.png", half())
    assert find_mask(tmp_path, "images/" + NAME) is not None
    assert candidates("a.jpg") == ["a.jpg.png", "a_mask.png", "a.mask.png", "a.png"]


def test_missing_masks_are_listed(tmp_path):
    write(tmp_path / "up/cam0/a.jpg.png", half())
    names = [NAME] + [f"up/cam0/{k}.jpg" for k in range(7)]
    with pytest.raises(InputError) as error:
        check_folder(tmp_path, names)
    text = str(error.value)
    with pytest.raises(InputError, match="no such folder"):
        check_folder(tmp_path / "nowhere", [NAME])
    assert "7 of 8" in text and "up/cam0/4.jpg and 2 more" in text and "up/cam0/5.jpg" not in text
    assert "up/cam0/0_mask.png" in text and "cam0.png" in text
    with pytest.raises(InputError, match=r"up/cam0/6\.jpg"):
        read_folder_mask(tmp_path, names[-1], SIZE)


def test_wrong_size(tmp_path):
    write(tmp_path / "cam0.png", half())
    with pytest.raises(InputError, match=r"cam0\.png: the mask has 64 x 48 pixels, its image .*a\.jpg has 128 x 96"):
        read_folder_mask(tmp_path, NAME, (96, 128))


@pytest.mark.parametrize("high", [1, 255])
def test_two_levels(tmp_path, high):
    path = write(tmp_path / "m.png", half(high))
    assert read_mask_file(path).mean() == 0.5
    assert not read_mask_file(write(path, half(0))).any()  # masks that leave nothing are allowed
    assert read_mask_file(write(path, half(0) + np.uint8(high))).all()


def test_other_ways_of_saving_the_same_mask(tmp_path):
    path = tmp_path / "m.png"
    for mode in ("1", "RGB", "RGBA", "P"):
        Image.fromarray(half()).convert(mode).save(path)
        assert (read_mask_file(path) == (half() > 0)).all(), mode


def test_images_that_are_no_masks_are_refused_with_the_reason(tmp_path):
    grey = half()
    grey[:, 30:34] = [60, 120, 180, 220]
    for image, said in (
        (grey, r"m\.png: 6 different values .*keep_labels"),
        (half(128), r"2 different values \(0, 128\)"),
        (half().astype(np.uint16) * 257, "65535"),
        (np.dstack([half(), half(), 255 - half()]), "colours"),
        (np.dstack([half()] * 4), "transparent"),
    ):
        with pytest.raises(InputError, match=said):
            read_mask_file(write(tmp_path / "m.png", image))
    whole = cv2.imencode(".png", np.random.default_rng(1).integers(0, 2, SIZE).astype(np.uint8))[1].tobytes()
    for data in (b"not a png", whole[: len(whole) // 2]):
        (tmp_path / "m.png").write_bytes(data)
        with pytest.raises(InputError, match=r"m\.png.*cannot be read"):
            read_mask_file(tmp_path / "m.png")


def test_labels(tmp_path):
    labels = np.repeat(np.arange(4, dtype=np.uint8), 12)[:, None] * np.ones((1, 64), np.uint8)
    path = write(tmp_path / "cam0.png", labels)
    assert (read_folder_mask(tmp_path, NAME, SIZE, (1, 3)) == np.isin(labels, (1, 3))).all()
    palette = Image.fromarray(labels).convert("P")
    palette.putdata(labels.ravel().tolist())
    palette.putpalette([0, 0, 0, 200, 0, 0, 0, 200, 0, 0, 0, 200])
    palette.save(path)
    assert (read_mask_file(path, (2,)) == (labels == 2)).all()
    with pytest.raises(InputError, match="not class labels"):
        read_mask_file(write(path, half()), (4,))


def test_masks_in_jpeg_are_said(tmp_path):
    Image.new("L", (8, 6)).save(tmp_path / "a_mask.JPG")
    with pytest.raises(InputError, match="a_mask.JPG is there, but JPEG blurs the edges of masks: save PNG"):
        check_folder(tmp_path, ["a.jpg"])


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
    names = ("up/cam0/a.jpg", "up/cam1/a.jpg", "up/cam1/b.jpg")
    result = compare(found, truth, {name: name.split("/")[1] for name in names})
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
    cameras = {"cam0/a.jpg": "cam0"}
    write(found / "cam0/a.jpg.png", mask(slice(0, 5)))
    with pytest.raises(InputError, match="no true mask for any of 1"):
        compare(found, truth, cameras)
    write(truth / "cam0/a.jpg.png", mask(slice(0, 5), (12, 20)))
    with pytest.raises(InputError, match=r"a\.jpg\.png: 20 x 10 pixels, but .* has 20 x 12"):
        compare(found, truth, cameras)
    write(found / "cam0/c.jpg.png", mask(slice(0, 5)))
    write(truth / "cam0/c.jpg.png", mask(slice(0, 5)))
    result = compare(found, truth, cameras | {"cam0/c.jpg": "cam0"})  # the others are compared all the same
    assert result.rows[-1].images == 1 and len(result.unfit) == 1 and "20 x 12" in result.unfit[0]
    write(truth / "cam0/b.jpg.png", mask(slice(0, 5)))
    with pytest.raises(InputError, match=r"no mask for cam0/b\.jpg, which has a true one"):
        compare(found, truth, {"cam0/b.jpg": "cam0"})
