import numpy as np

from masks_world import DECK, HORIZON, frame, sequence, share
from tiegraph.masks.frames import block_share, from_blocks, grey, masked_neighbours, opened_closed, without_small
from tiegraph.masks.settings import MasksSettings
from tiegraph.masks.sources import Camera
from tiegraph.masks.tuning import Tuning
from tiegraph.papers.meguro2024 import difference_mask, mask_of_camera, prepare, prepare_difference

TUNING = Tuning()


def test_what_stays_is_masked_and_what_moves_is_used(tmp_path):
    mask = prepare_difference(sequence(tmp_path), MasksSettings(source="meguro2024"), TUNING)
    assert share(mask, slice(DECK + 8, None)) < 0.01
    assert share(mask, slice(0, HORIZON - 8)) < 0.01
    assert share(mask, slice(HORIZON + 8, DECK - 8)) > 0.9


def test_light_change_breaks_it_as_the_papers_method_does(tmp_path):
    a, b = grey(frame(0)), grey(frame(1, gain=0.8))
    assert share(difference_mask(a, b, 8, TUNING.meguro2024), slice(DECK, None)) > 0.5


def test_nothing_of_a_camera_that_looks_up_is_used(tmp_path):
    """Paper 000: "the images from the five side cameras are used"."""
    images = tuple(sequence(tmp_path))
    both = prepare({0: Camera(images), 5: Camera(images, upward=True)}, MasksSettings(source="meguro2024"), TUNING)
    assert both[0].any() and not both[5].any() and both[0].shape == both[5].shape
    assert not mask_of_camera(images[0], both[5], MasksSettings(source="meguro2024"), TUNING, "").any()


def test_small_areas_of_both_colours_go():
    a = np.zeros((200, 200), np.uint8)
    b = a.copy()
    b[:, 100:] = 255  # right half differs
    b[50:62, 30:42] = 255  # a white island of 144 px, under 0.5 % of the image
    b[50:62, 150:162] = 0  # a black one
    mask = difference_mask(a, b, 20, TUNING.meguro2024)
    assert not mask[:, :100].any() and mask[:, 100:].all()
    c = b.copy()
    c[20:50, 20:50] = 255  # 900 px stay
    assert difference_mask(a, c, 20, TUNING.meguro2024)[35, 35]


def test_lines_thinner_than_the_square_go_however_long():
    a = np.zeros((200, 200), np.uint8)
    b = a.copy()
    b[:, 100:] = 255
    b[:, 40:45] = 255  # 1000 px of white, 5 px wide
    b[:, 150:155] = 0  # and of black
    mask = difference_mask(a, b, 20, TUNING.meguro2024)
    assert TUNING.meguro2024.square_px == 7
    assert not mask[:, :100].any() and mask[:, 100:].all()


def test_threshold_is_the_smallest_difference_used():
    a = np.full((64, 64), 100, np.uint8)
    assert difference_mask(a, a + np.uint8(20), 20, TUNING.meguro2024).all()
    assert not difference_mask(a, a + np.uint8(19), 20, TUNING.meguro2024).any()


def test_opening_before_closing():
    speck = np.zeros((40, 40), bool)
    speck[10:13, 10:13] = True
    assert not opened_closed(speck, 7).any()
    assert opened_closed(~speck, 7).all()
    stripes = np.tile(np.arange(40) % 4 == 0, (40, 1))  # closing first would join them
    assert not opened_closed(stripes, 7).any()


def test_without_small_counts_pixels_and_joins_corners():
    white = np.zeros((10, 10), bool)
    white[1, 1] = white[2, 2] = white[3, 3] = True
    assert without_small(white, 3).sum() == 3
    assert without_small(white, 4).sum() == 0
    assert without_small(np.zeros((5, 5), bool), 1).sum() == 0


def test_blocks_at_the_edges_are_counted_by_their_own_size():
    white = np.ones((20, 21), bool)
    white[:, 16:] = False
    shares = block_share(white, 8)
    assert shares.shape == (3, 3)
    assert (shares[:, :2] == 1).all() and (shares[:, 2] == 0).all()
    assert (from_blocks(shares > 0.5, 8, white.shape) == white).all()


def test_neighbours_share_a_side():
    blocks = np.array([[1, 1, 1], [1, 0, 0], [0, 0, 0]], bool)
    assert masked_neighbours(blocks).tolist() == [[2, 2, 1], [1, 2, 1], [1, 0, 0]]
