"""Corners in rendered images against where the true camera projects them."""

import numpy as np
import pytest

from calibrate.board_world import Renderer, board_before, camera, texture
from tiegraph.calibrate.board import read_board
from tiegraph.calibrate.detect import detect
from tiegraph.calibrate.tuning import Tuning
from tiegraph.geometry import transforms

TUNING = Tuning().board
CAMERA = camera("OPENCV", [800, 802, 325, 238, -0.2, 0.05, 0.0005, -0.0003], (640, 480))
GRID = "target_type: aprilgrid\ntagCols: 6\ntagRows: 5\ntagSize: 0.03\ntagSpacing: 0.3\n"


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
    grid.write_text(GRID)
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
