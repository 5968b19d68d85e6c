"""Boards: their words, Kalibr's file, what is refused; corners in rendered images against the true camera's."""

import numpy as np
import pytest

from calibrate.board_world import Renderer, board_before, camera, texture
from tiegraph.calibrate.board import APRILGRID, CHECKER, detect, read_board
from tiegraph.calibrate.tuning import Tuning
from tiegraph.errors import InputError
from tiegraph.geometry import transforms

GRID = "target_type: 'aprilgrid' #gridtype\ntagCols: 6\ntagRows: 5\ntagSize: 0.088  # [m]\ntagSpacing: 0.3\n"


def test_charuco_has_the_corners_between_squares():
    board = read_board("charuco:7x5:0.04:0.03:4x4_50")
    assert board.points.shape == (24, 3)
    np.testing.assert_allclose(board.points[[0, 1, 6]], [[0.04, 0.04, 0], [0.08, 0.04, 0], [0.04, 0.08, 0]])
    assert (board.dictionary, board.legacy, board.turnable) == ("DICT_4X4_50", False, False)
    assert read_board("charuco:7x4:0.04:0.03:legacy").legacy


def test_checkerboard_of_an_odd_and_an_even_count_has_one_way_up():
    assert [read_board(f"checker:{n}:0.03").turnable for n in ("9x6", "8x6", "9x7")] == [False, True, True]


def test_kalibrs_files(tmp_path):
    grid, checker = tmp_path / "grid.yaml", tmp_path / "checker.yml"
    grid.write_text(GRID)
    board = read_board(str(grid))
    assert (board.kind, len(board.points)) == (APRILGRID, 120)
    # tag 7 is the second of the second row from below; its corners go round from the lower right one
    low = np.array([0.088 * 1.3, 0.088 * 1.3, 0])
    corners = low + 0.088 * np.array([[1, 0, 0], [0, 0, 0], [0, 1, 0], [1, 1, 0]])
    np.testing.assert_allclose(board.points[28:32], corners)
    squares = "rowSpacingMeters: 0.05\ncolSpacingMeters: 0.06\n"
    checker.write_text(f"target_type: checkerboard\ntargetCols: 6\ntargetRows: 7\n{squares}")
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


TUNING = Tuning().board
CAMERA = camera("OPENCV", [800, 802, 325, 238, -0.2, 0.05, 0.0005, -0.0003], (640, 480))


def errors(text: str, spread: float, seeds: range) -> tuple[np.ndarray, float]:
    """Errors (K, 2) of all corners, pixels, and the share of those in the image that were found."""
    board = read_board(text)
    render, off, there = Renderer(CAMERA, texture(board)), [], 0
    for seed in seeds:
        rng = np.random.default_rng(seed)
        pose = board_before(board, CAMERA, rng, tilt_deg=35, depth_m=(0.42, 0.5), spread=spread)
        numbers, xy = detect(render(pose, 2.0, rng), board, TUNING)
        true = np.asarray(CAMERA.img_from_cam(transforms.apply(pose, board.points)))
        there += int(((true > 0) & (true < (640, 480))).all(axis=1).sum())
        off.append(xy - true[numbers])
    found = np.concatenate(off)
    return found, len(found) / there


@pytest.mark.slow
def test_charuco_and_aprilgrid_are_found_to_hundredths_of_a_pixel_though_cut_off(tmp_path):
    grid = tmp_path / "aprilgrid.yaml"
    grid.write_text(GRID.replace("0.088", "0.03"))
    for text in ("charuco:9x7:0.03:0.022", str(grid)):
        off, share = errors(text, 0.6, range(6))
        assert 0.01 < np.sqrt(np.mean(off**2)) < 0.05, text
        assert np.abs(off.mean(axis=0)).max() < 0.01, text
        assert share > 0.75, text


@pytest.mark.slow
def test_a_checkerboard_is_numbered_alike_however_it_is_turned():
    """Its numbers may begin at either end, but always at the same; and a trimmed edge draws no corner to it."""
    board = read_board("checker:9x6:0.02")
    render, kinds = Renderer(CAMERA, texture(board, trimmed=0.4)), set()
    for seed, turn in enumerate((0.0, 0.5, 1.6, 3.1, 4.5)):
        rng = np.random.default_rng(seed)
        pose = board_before(board, CAMERA, rng, tilt_deg=20, depth_m=(0.42, 0.5), spread=0.1)
        middle = board.points.mean(axis=0)
        spin = np.array([[np.cos(turn), -np.sin(turn), 0], [np.sin(turn), np.cos(turn), 0], [0, 0, 1]])
        pose = pose @ transforms.rigid(spin, middle - spin @ middle)
        numbers, xy = detect(render(pose, 2.0, rng), board, TUNING)
        true = np.asarray(CAMERA.img_from_cam(transforms.apply(pose, board.points)))
        rms = [np.sqrt(np.mean((xy - order[numbers]) ** 2)) for order in (true, true[::-1])]
        assert 0.01 < min(rms) < 0.04
        kinds.add(int(np.argmin(rms)))
    assert len(kinds) == 1


def test_nothing_is_found_where_there_is_no_board():
    noise = np.random.default_rng(0).integers(0, 255, (240, 320), np.uint8)
    for text in ("charuco:9x7:0.03:0.022", "checker:9x6:0.02"):
        numbers, xy = detect(noise, read_board(text), TUNING)
        assert len(numbers) == 0 and xy.shape == (0, 2)
