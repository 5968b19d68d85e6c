import cv2
import numpy as np
import pytest
from PIL import Image

from masks_world import write
from tiegraph.errors import InputError
from tiegraph.masks.folder import candidates, check_folder, find_mask, read_folder_mask, read_mask_file

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
    write(tmp_path / "cam0.png", half())
    write(tmp_path / "up/cam0/a.jpg.png", 255 - half())
    assert find_mask(tmp_path, NAME) == tmp_path / "up/cam0/a.jpg.png"
    assert find_mask(tmp_path, "up/cam0/b.jpg") == tmp_path / "cam0.png"


def test_images_folder_of_the_name_may_be_left_away(tmp_path):
    write(tmp_path / "up/cam0/a.jpg.png", half())
    assert find_mask(tmp_path, "images/" + NAME) is not None
    assert candidates("a.jpg") == ["a.jpg.png", "a_mask.png", "a.mask.png", "a.png"]


def test_missing_masks_are_listed(tmp_path):
    write(tmp_path / "up/cam0/a.jpg.png", half())
    names = [NAME] + [f"up/cam0/{k}.jpg" for k in range(7)]
    with pytest.raises(InputError) as error:
        check_folder(tmp_path, names)
    text = str(error.value)
    assert "7 of 8" in text and "up/cam0/4.jpg and 2 more" in text and "up/cam0/5.jpg" not in text
    assert "up/cam0/0_mask.png" in text and "cam0.png" in text
    with pytest.raises(InputError, match=r"up/cam0/6\.jpg"):
        read_folder_mask(tmp_path, names[-1], SIZE)


def test_missing_folder(tmp_path):
    with pytest.raises(InputError, match="no such folder"):
        check_folder(tmp_path / "nowhere", [NAME])


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
    for image in (
        Image.fromarray(half()).convert("1"),
        Image.fromarray(half()).convert("RGB"),
        Image.fromarray(half()).convert("RGBA"),
        Image.fromarray(half()).convert("P"),
    ):
        image.save(path)
        assert (read_mask_file(path) == (half() > 0)).all(), image.mode


def test_more_than_two_levels(tmp_path):
    grey = half()
    grey[:, 30:34] = [60, 120, 180, 220]
    path = write(tmp_path / "m.png", grey)
    with pytest.raises(InputError, match=r"m\.png: 6 different values .*keep_labels"):
        read_mask_file(path)
    with pytest.raises(InputError, match=r"2 different values \(0, 128\)"):
        read_mask_file(write(path, half(128)))
    with pytest.raises(InputError, match="65535"):
        read_mask_file(write(path, half().astype(np.uint16) * 257))


def test_colours_transparency_and_broken_files(tmp_path):
    path = write(tmp_path / "m.png", np.dstack([half(), half(), 255 - half()]))
    with pytest.raises(InputError, match="colours"):
        read_mask_file(path)
    write(path, np.dstack([half()] * 4))
    with pytest.raises(InputError, match="transparent"):
        read_mask_file(path)
    path.write_bytes(b"not a png")
    with pytest.raises(InputError, match=r"m\.png.*cannot be read"):
        read_mask_file(path)
    whole = cv2.imencode(".png", np.random.default_rng(1).integers(0, 2, SIZE).astype(np.uint8))[1].tobytes()
    path.write_bytes(whole[: len(whole) // 2])
    with pytest.raises(InputError, match=r"m\.png.*cannot be read"):
        read_mask_file(path)


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
