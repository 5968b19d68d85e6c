"""Boards: their words, Kalibr's file, and what is refused."""

import numpy as np
import pytest

from tiegraph.calibrate.board import APRILGRID, CHECKER, read_board
from tiegraph.errors import InputError

GRID = "target_type: 'aprilgrid' #gridtype\ntagCols: 6\ntagRows: 5\ntagSize: 0.088  # [m]\ntagSpacing: 0.3\n"


def test_charuco_has_the_corners_between_squares():
    board = read_board("charuco:7x5:0.04:0.03:4x4_50")
    assert board.points.shape == (24, 3)
    np.testing.assert_allclose(board.points[[0, 1, 6]], [[0.04, 0.04, 0], [0.08, 0.04, 0], [0.04, 0.08, 0]])
    assert (board.dictionary, board.legacy, board.turnable) == ("DICT_4X4_50", False, False)
    assert read_board("charuco:7x4:0.04:0.03:legacy").legacy


def test_checkerboard_of_an_odd_and_an_even_count_has_one_way_up():
    assert not read_board("checker:9x6:0.03").turnable
    assert read_board("checker:8x6:0.03").turnable
    assert read_board("checker:9x7:0.03").turnable


def test_kalibrs_files(tmp_path):
    grid, checker = tmp_path / "grid.yaml", tmp_path / "checker.yml"
    grid.write_text(GRID)
    board = read_board(str(grid))
    assert (board.kind, len(board.points)) == (APRILGRID, 120)
    # tag 7 is the second of the second row from below; its corners go round from the lower right one
    low = np.array([0.088 * 1.3, 0.088 * 1.3, 0])
    corners = low + 0.088 * np.array([[1, 0, 0], [0, 0, 0], [0, 1, 0], [1, 1, 0]])
    np.testing.assert_allclose(board.points[28:32], corners)
    checker.write_text(
        "target_type: checkerboard\ntargetCols: 6\ntargetRows: 7\nrowSpacingMeters: 0.05\ncolSpacingMeters: 0.06\n"
    )
    board = read_board(str(checker))
    assert board.kind == CHECKER
    np.testing.assert_allclose(board.points[[1, 6]], [[0.06, 0, 0], [0, 0.05, 0]])


@pytest.mark.parametrize(
    ("text", "said"),
    [
        ("chess:9x6:0.03", "charuco:7x5"),
        ("checker:9x6", "side of a square"),
        ("checker:9by6:0.03", "'9by6'"),
        ("checker:9x6:30", "30 m"),
        ("checker:9x6:nan", "'nan'"),
        ("checker:1x6:0.03", "1 x 6"),
        ("charuco:7x5:0.03:0.04", "not smaller"),
        ("charuco:7x5:0.04:0.03:DICT_9X9", "DICT_9X9"),
        ("charuco:20x20:0.04:0.03:DICT_4X4_50", "200 markers"),
        ("missing.yaml", "missing.yaml"),
    ],
)
def test_malformed_boards_are_refused_with_the_form_or_the_value(text, said):
    with pytest.raises(InputError, match="--board") as error:
        read_board(text)
    assert said in str(error.value)


@pytest.mark.parametrize(
    ("text", "said"),
    [
        (GRID.replace("aprilgrid", "circlegrid"), "circlegrid"),
        (GRID.replace("tagSize", "size"), "tagSize is missing"),
        (GRID.replace("0.3", "30"), "tagSpacing = 30"),
        ("", "no target_type"),
    ],
)
def test_malformed_target_files_are_refused(tmp_path, text, said):
    path = tmp_path / "grid.yaml"
    path.write_text(text)
    with pytest.raises(InputError, match=said):
        read_board(str(path))
