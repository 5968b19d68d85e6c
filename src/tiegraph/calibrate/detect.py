"""The corners of a board in one image, by OpenCV's detectors."""

from functools import lru_cache

import cv2
import numpy as np
from scipy.spatial import cKDTree

from tiegraph.calibrate.board import APRILGRID, CHARUCO, Board
from tiegraph.calibrate.tuning import BoardTuning
from tiegraph.scene.targets import CENTRE, refined

Corners = tuple[np.ndarray, np.ndarray]
"""Numbers (K,) of corners of the board, and where they are, (K, 2) COLMAP's pixels."""


def detect(pixels: np.ndarray, board: Board, tuning: BoardTuning) -> Corners:
    """The corners that are seen in an image (H, W) u1; none if they are too few to hold a pose."""
    find = {CHARUCO: _charuco, APRILGRID: _aprilgrid}.get(board.kind, _checker)
    numbers, xy = find(pixels, board, tuning)
    if len(numbers) >= tuning.least_corners:
        places = board.points[numbers, :2]
        spread = np.linalg.svd(places - places.mean(axis=0), compute_uv=False)
        if spread[1] >= 0.15 * spread[0]:  # along a line they hold no pose
            return numbers, xy.astype(float) + CENTRE
    return np.zeros(0, int), np.zeros((0, 2))


def _charuco(pixels: np.ndarray, board: Board, tuning: BoardTuning) -> Corners:
    xy, numbers, _, _ = _charuco_detector(board.counts, board.marker, board.dictionary, board.legacy).detectBoard(
        pixels
    )
    if numbers is None or xy is None or len(numbers) < tuning.least_corners:
        return np.zeros(0, int), np.zeros((0, 2))
    xy = xy.reshape(-1, 2)
    # OpenCV's own windows reach into the markers: 0.09 px of error where these have 0.03 (tests/calibrate).
    return numbers.ravel().astype(int), _refined(pixels, xy, (1 - board.marker) / 2 * _nearest(xy), tuning)


@lru_cache
def _charuco_detector(
    counts: tuple[int, int], marker: float, dictionary: str, legacy: bool
) -> cv2.aruco.CharucoDetector:
    made = cv2.aruco.CharucoBoard(counts, 1.0, marker, _dictionary(dictionary))
    made.setLegacyPattern(legacy)
    return cv2.aruco.CharucoDetector(made)


def _dictionary(name: str) -> cv2.aruco.Dictionary:
    return cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, name))


def _checker(pixels: np.ndarray, board: Board, tuning: BoardTuning) -> Corners:
    for effort in (0, cv2.CALIB_CB_EXHAUSTIVE):
        flags = cv2.CALIB_CB_NORMALIZE_IMAGE | cv2.CALIB_CB_ACCURACY | effort
        found, xy = cv2.findChessboardCornersSB(pixels, board.counts, flags=flags)
        if found:
            xy = xy.reshape(-1, 2)
            return np.arange(len(board.points)), _refined(pixels, xy, tuning.trimmed * _nearest(xy), tuning)
    return np.zeros(0, int), np.zeros((0, 2))


def _aprilgrid(pixels: np.ndarray, board: Board, tuning: BoardTuning) -> Corners:
    quads, tags, _ = _tag_detector(board.dictionary).detectMarkers(pixels)
    inside = [] if tags is None else [(int(t), q) for t, q in zip(tags.ravel(), quads) if t < len(board.points) // 4]
    if not inside:
        return np.zeros(0, int), np.zeros((0, 2))
    numbers = (4 * np.array([tag for tag, _ in inside])[:, None] + np.arange(4)).ravel()
    sides = [np.linalg.norm(q.reshape(4, 2) - np.roll(q.reshape(4, 2), 1, axis=0), axis=1).min() for _, q in inside]
    bit = float(min(sides)) / 10  # along the side of a tag, with its borders
    return numbers, _refined(pixels, np.concatenate([q.reshape(4, 2) for _, q in inside]), bit * 2, tuning)


def _nearest(xy: np.ndarray) -> float:
    """Smallest distance between two corners (K, 2)."""
    return float(cKDTree(xy).query(xy, 2)[0][:, 1].min())


def _refined(pixels: np.ndarray, xy: np.ndarray, free_px: float, tuning: BoardTuning) -> np.ndarray:
    """Corners (K, 2), each where black and white meet like on a checkerboard; about each so much is free of others."""
    return refined(pixels, xy, free_px, tuning.refine_share, tuning.refine_px)


@lru_cache
def _tag_detector(dictionary: str) -> cv2.aruco.ArucoDetector:
    parameters = cv2.aruco.DetectorParameters()
    parameters.markerBorderBits = 2
    return cv2.aruco.ArucoDetector(_dictionary(dictionary), parameters)
