"""Boards, their files and corners; start, adjustment, sigmas and verdict on corners of known truth."""

from dataclasses import replace

import numpy as np
import pycolmap
import pytest

from calibrate.board_world import Renderer, board_before, boards_of_rig, camera, observed, rig_pose, texture
from tiegraph.calibrate.adjust import State, adjust_robustly, place_boards, start
from tiegraph.calibrate.board import APRILGRID, CHECKER, check_views, detect, read_board
from tiegraph.calibrate.judge import judge, parameters, precision
from tiegraph.calibrate.summary import kalibr_yaml, opencv_yaml, parameter_rows
from tiegraph.errors import InputError, ReconstructionError
from tiegraph.geometry import transforms
from tiegraph.scan.rigfiles.camerafile import read_camera_file
from tiegraph.scan.rigfiles.rigfile import read_rig_file
from tiegraph.scan.tuning import Tuning as ScanTuning

BOARD = read_board("charuco:9x7:0.03:0.022")
SIZE = (640, 480)
OPENCV = [800.0, 802.0, 325.0, 238.0, -0.2, 0.05, 0.0005, -0.0003]
NAMES = ["left", "middle", "right"]


def rig(count: int = 30, seed: int = 1) -> State:
    """Three cameras in a fan: the outer ones never see the board together."""
    cameras = [camera("OPENCV", [v + k for v in OPENCV[:4]] + OPENCV[4:], SIZE) for k in range(3)]
    sensors = [np.eye(4), rig_pose((1, 28, -2), (0.12, 0.005, 0.01)), rig_pose((-2, 56, 1), (0.23, -0.004, -0.03))]
    return State(tuple(cameras), np.stack(sensors), boards_of_rig(BOARD, cameras, sensors, count=count, seed=seed))


def lone(model: str, params: list[float], tilt_deg: float = 40.0, count: int = 20, seed: int = 0) -> State:
    """One camera."""
    made, rng = camera(model, params, SIZE), np.random.default_rng(seed)
    boards = {k: board_before(BOARD, made, rng, tilt_deg=tilt_deg, depth_m=(0.35, 0.6)) for k in range(count)}
    return State((made,), np.eye(4)[None], boards)


def calibrated(seen):
    return adjust_robustly(seen, start(seen))


@pytest.fixture(scope="module")
def done():
    truth = rig()
    seen = observed(BOARD, truth, NAMES, noise_px=0.05)
    together = {(a.camera, b.camera) for a in seen.views for b in seen.views if a.instant == b.instant}
    assert (0, 2) not in together
    return truth, calibrated(seen)


@pytest.mark.slow
def test_a_rig_whose_outer_cameras_share_no_view_is_found_within_its_sigmas(done):
    truth, found = done
    exact = precision(found)
    values = np.array([[p.value for p in parameters(s)] for s in (found.state, truth)])
    off = (values[0] - values[1]) / exact.sigma
    assert 0.5 < np.sqrt(np.mean(off**2)) < 1.6 and 0.045 < found.sigma_px < 0.055
    assert np.abs(values[0, :2] / values[1, :2] - 1).max() < 5e-4
    assert np.allclose(np.diag(exact.correlation), 1) and np.abs(exact.correlation).max() < 1 + 1e-9


@pytest.mark.slow
def test_sigmas_are_those_of_many_calibrations():
    """Root mean square of error over sigma, over noise: 1 for true sigmas, of lenses, places and turns each."""
    cameras = [camera("OPENCV", OPENCV, SIZE)] * 2
    sensors = [np.eye(4), rig_pose((1, 15, -2), (0.12, 0.005, 0.01))]
    boards = boards_of_rig(BOARD, cameras, sensors, count=12, seed=1)
    truth, off = State(tuple(cameras), np.stack(sensors), boards), []
    true = np.array([p.value for p in parameters(truth)])
    for seed in range(6):
        found = calibrated(observed(BOARD, truth, NAMES, noise_px=0.1, seed=seed))
        values = np.array([p.value for p in parameters(found.state)])
        off.append((values - true) / precision(found).sigma)
    lenses, places, turns = (np.sqrt(np.mean(part**2)) for part in np.split(np.stack(off), (16, 19), axis=1))
    assert 0.8 < lenses < 1.2 and 0.65 < places < 1.35 and 0.65 < turns < 1.35


@pytest.mark.slow
def test_errors_that_the_corners_of_a_view_share_widen_the_sigmas():
    truth = lone("OPENCV", OPENCV)
    plain = observed(BOARD, truth, ["camera"], noise_px=0.1)
    bent = replace(BOARD, points=BOARD.points + [0, 0, 1] * (0.0008 * np.sin(30 * BOARD.points[:, :1])))
    warped = replace(observed(bent, truth, ["camera"], noise_px=0.1), board=BOARD)
    sigmas = []
    for seen in (plain, warped):
        found = calibrated(seen)
        sigmas.append(precision(found).of(0, "fx")[0] / found.sigma_px)
    assert sigmas[1] > 1.3 * sigmas[0]


@pytest.mark.slow
@pytest.mark.parametrize(
    ("model", "params"),
    [
        ("SIMPLE_RADIAL", [700.0, 322.0, 243.0, -0.15]),
        ("FULL_OPENCV", [*OPENCV, 0.0, 0.0, 0.0, 0.0]),
        ("OPENCV_FISHEYE", [210.0, 211.0, 322.0, 243.0, -0.01, 0.004, -0.001, 0.0002]),
        ("EUCM", [300.0, 300.0, 322.0, 243.0, 0.6, 1.1]),
    ],
)
def test_every_lens_starts_from_nothing(model, params):
    """Compared are pixels and not parameters: those of FULL_OPENCV stand for each other."""
    truth = lone(model, params)
    found = calibrated(observed(BOARD, truth, ["camera"], noise_px=0.05))
    assert found.left_out == ()
    grid = np.stack(np.meshgrid(np.linspace(150, 490, 9), np.linspace(120, 360, 7)), axis=-1).reshape(-1, 2)
    rays = np.column_stack([truth.cameras[0].cam_from_img(grid), np.ones(len(grid))])
    off = np.asarray(found.state.cameras[0].img_from_cam(rays)) - grid
    assert 1e-4 < np.abs(off - off.mean(axis=0)).max() < 0.5
    assert abs(found.state.cameras[0].mean_focal_length() / truth.cameras[0].mean_focal_length() - 1) < 2e-3


@pytest.mark.slow
def test_corners_seen_once_or_never_and_cameras_without_a_view_are_no_trouble(done):
    """pycolmap refuses points of one image, and aborts for held ones of none."""
    _, found = done
    alone = next(v for v in found.seen.views if sum(w.instant == v.instant for w in found.seen.views) == 1)
    few = found.seen.among({alone.instant})
    state = found.state.at({alone.instant})
    pushed = state.rig_from_board[alone.instant].copy()
    pushed[:3, 3] += 0.004
    placed = place_boards(few, replace(state, rig_from_board={alone.instant: pushed}), 1.0)
    off = placed.rig_from_board[alone.instant][:3, 3] - state.rig_from_board[alone.instant][:3, 3]
    assert np.linalg.norm(off) < 3e-4


@pytest.mark.slow
def test_an_image_of_another_instant_is_left_out_and_named():
    """Of two images of one instant either may be the wrong one."""
    seen = observed(BOARD, rig(), NAMES, noise_px=0.05)
    instants = [view.instant for view in seen.views]
    number = next(k for k, v in enumerate(seen.views) if v.camera == 1 and instants.count(v.instant) == 2)
    moved = replace(seen.views[number], xy=seen.views[number].xy + 6.0)
    found = calibrated(replace(seen, views=(*seen.views[:number], moved, *seen.views[number + 1 :])))
    ((name, reason),) = found.left_out
    assert name in [v.name for v in seen.views if v.instant == moved.instant] and "px off" in reason
    assert 0.045 < found.sigma_px < 0.055


@pytest.mark.slow
def test_the_verdict_names_the_empty_part_of_the_image_and_the_held_out_error(done):
    _, found = done
    verdict = judge(found)
    for of_camera in verdict.cameras:
        assert 0.045 < of_camera.rms_px < of_camera.held_out_px < 0.07
        assert 0.6 < of_camera.coverage <= 1
    rows = parameter_rows(verdict.precision, NAMES)
    assert len(rows) == 3 * 8 + 2 * 6
    cut = [v for v in found.seen.views if v.camera != 1]
    cut += [
        replace(v, corners=v.corners[keep], xy=v.xy[keep])
        for v in found.seen.views
        if v.camera == 1 and (keep := (v.xy > 165).any(axis=1) & ((v.xy[:, 0] > 220) | (v.xy[:, 1] > 165))).any()
    ]
    advice = judge(replace(found, seen=replace(found.seen, views=tuple(cut)))).advice
    assert any(a.startswith("middle: no corner in the upper left of the image: move the board there") for a in advice)


@pytest.mark.slow
def test_a_board_that_is_never_tilted_leaves_the_focal_length_open():
    truth = lone("OPENCV", OPENCV, tilt_deg=0.3)
    found = calibrated(observed(BOARD, truth, ["front"], noise_px=0.3))
    with pytest.raises(ReconstructionError, match="front: these views do not determine its focal length.*sigma of"):
        judge(found)


def test_what_cannot_be_calibrated_is_said_at_the_start():
    seen = observed(BOARD, rig(12), NAMES, noise_px=0.05)

    def refused(views, said, board=BOARD):
        with pytest.raises(InputError, match=said):
            check_views(replace(seen, views=tuple(views), board=board))

    check_views(seen)
    refused([v for v in seen.views if v.camera != 2], "right: the board was found in none of its 12 images")
    first = next(v for v in seen.views if v.camera == 2)
    refused([*(v for v in seen.views if v.camera != 2), first], "right: the board was found in 1 of its 12 images")
    apart = [v if v.camera < 2 else replace(v, instant=v.instant + 100) for v in seen.views]
    refused(apart, r"nothing ties these cameras together: left, middle \| right")
    refused(seen.views, "looks the same after half a turn", read_board("checker:8x6:0.03"))


@pytest.mark.slow
def test_most_views_contradicting_is_an_error():
    seen = observed(BOARD, lone("OPENCV", OPENCV), ["camera"], noise_px=0.05)
    rng = np.random.default_rng(0)
    misnumbered = [replace(v, xy=v.xy[rng.permutation(len(v.xy))]) for v in seen.views[8:]]
    views = [*seen.views[:8], *misnumbered]
    with pytest.raises(ReconstructionError, match="contradict the others"):
        calibrated(replace(seen, views=tuple(views)))


@pytest.mark.parametrize("model", ["SIMPLE_RADIAL", "OPENCV", "FULL_OPENCV", "OPENCV_FISHEYE", "RADIAL_FISHEYE"])
def test_opencvs_file_reads_back_as_the_same_lens(tmp_path, model):
    made = camera(model, {
        "SIMPLE_RADIAL": [700, 322, 243, -0.15], "OPENCV": OPENCV, "FULL_OPENCV": [*OPENCV, 0.01, 0.02, 0.03, 0.04],
        "OPENCV_FISHEYE": [300, 301, 322, 243, 0.01, 0.02, 0.003, 0.004], "RADIAL_FISHEYE": [300, 322, 243, 0.01, 0.02],
    }[model], SIZE)  # fmt: skip
    path = tmp_path / "camera.yaml"
    path.write_text(opencv_yaml(made) or "")
    (read,) = read_camera_file(path, "camera")
    assert read.size == SIZE
    grid = np.random.default_rng(0).uniform(-0.3, 0.3, (50, 2))
    rays = np.column_stack([grid, np.ones(50)])
    np.testing.assert_allclose(camera(read.model, list(read.params), SIZE).img_from_cam(rays), made.img_from_cam(rays))


def test_kalibrs_file_reads_back_as_the_same_rig(tmp_path):
    truth = rig(3)
    path = tmp_path / "camchain.yaml"
    path.write_text(kalibr_yaml(truth.cameras, truth.sensor_from_rig) or "")
    (read,) = read_rig_file(path, ScanTuning().rig)
    for k, sensor in enumerate(read.sensors):
        assert sensor.body_from_sensor is not None and sensor.params is not None
        np.testing.assert_allclose(sensor.body_from_sensor, transforms.invert(truth.sensor_from_rig[k]), atol=1e-12)
        np.testing.assert_allclose(sensor.params, truth.cameras[k].params)
    assert kalibr_yaml((camera("EUCM", [300, 300, 322, 243, 0.6, 1.1], SIZE),), np.eye(4)[None]) is None


@pytest.mark.slow
def test_the_bend_of_a_board_is_found_and_taken_out():
    """A board that sags by 1.5 mm: held flat, it makes the lens wrong and the residuals large."""
    place = BOARD.points[:, :2] - BOARD.points[:, :2].mean(axis=0)
    sag = 0.0015 * (1 - np.sum(place**2, axis=1) / np.sum(place**2, axis=1).max())
    bent = replace(BOARD, points=BOARD.points + np.outer(sag - sag.mean(), [0, 0, 1]))
    truth = lone("OPENCV", OPENCV)
    seen = replace(observed(bent, truth, ["one"], noise_px=0.05), board=BOARD)
    begin = start(seen)
    flat, free = (adjust_robustly(seen, begin, sigma) for sigma in (0.0, 0.001))
    assert flat.sigma_px > 3 * free.sigma_px and 0.04 < free.sigma_px < 0.06
    off = np.abs([f.state.cameras[0].params[0] / OPENCV[0] - 1 for f in (flat, free)])
    assert 1e-6 < off[1] < 1e-3 and off[1] < off[0] / 2, off
    assert 0.0 < np.sqrt(np.mean((free.bent_m[:, 2] - (sag - sag.mean())) ** 2)) < 1e-4
    assert not flat.bent_m.any()


def lens_of(focal: float = 1000.0, cx: float = 480.0, k1: float = -0.1, size: tuple[int, int] = (960, 720)):
    params = [focal, focal, cx, size[1] / 2, k1, 0.0, 0.0, 0.0]
    return pycolmap.Camera(model="OPENCV", width=size[0], height=size[1], params=params)


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


CAMERA = camera("OPENCV", [800, 802, 325, 238, -0.2, 0.05, 0.0005, -0.0003], (640, 480))


def errors(text: str, spread: float, seeds: range) -> tuple[np.ndarray, float]:
    """Errors (K, 2) of all corners, pixels, and the share of those in the image that were found."""
    board = read_board(text)
    render, off, there = Renderer(CAMERA, texture(board)), [], 0
    for seed in seeds:
        rng = np.random.default_rng(seed)
        pose = board_before(board, CAMERA, rng, tilt_deg=35, depth_m=(0.42, 0.5), spread=spread)
        numbers, xy = detect(render(pose, 2.0, rng), board)
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
        off, share = errors(text, 0.6, range(3))
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
        numbers, xy = detect(render(pose, 2.0, rng), board)
        true = np.asarray(CAMERA.img_from_cam(transforms.apply(pose, board.points)))
        rms = [np.sqrt(np.mean((xy - order[numbers]) ** 2)) for order in (true, true[::-1])]
        assert 0.01 < min(rms) < 0.04
        kinds.add(int(np.argmin(rms)))
    assert len(kinds) == 1


@pytest.mark.slow
def test_nothing_is_found_where_there_is_no_board():
    noise = np.random.default_rng(0).integers(0, 255, (240, 320), np.uint8)
    for text in ("charuco:9x7:0.03:0.022", "checker:9x6:0.02"):
        numbers, xy = detect(noise, read_board(text))
        assert len(numbers) == 0 and xy.shape == (0, 2)
