"""`tiegraph calibrate` beside OpenCV's calibrateCamera and stereoCalibrate on OpenCV's own photographs of a chessboard.

    .venv/bin/python -m benchmarks.boards FOLDER -o benchmarks/results/boards.json

FOLDER holds left01.jpg to left14.jpg and right01.jpg to right14.jpg: Debian's package opencv-doc has them in
/usr/share/doc/opencv-doc/examples/data. Three calibrations with one lens model (k1, k2, p1, p2):

* ``tiegraph``: detector and adjustment of `tiegraph calibrate`;
* ``opencv``: stereoCalibrate after calibrateCamera, on the corners of ``tiegraph``;
* ``sample``: the same on the corners that OpenCV's sample stereo_calib.cpp finds (cornerSubPix, windows of 23 pixels).

All are judged alike, by OpenCV alone, on the corners of ``tiegraph``: a pose of the board is fitted to what the left
camera sees of a pair and transferred to the right one (``transfer``), and the rows of both cameras are compared after
rectification (``rows``). ``halves``: calibrated on seven pairs drawn at random, judged on the other six.
"""

from __future__ import annotations

import argparse
import json
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
import pycolmap

import tiegraph  # noqa: F401  before pycolmap
from tiegraph.calibrate.adjust import State, adjust_robustly, start
from tiegraph.calibrate.board import CameraImages, Observations, View, detect, read_board
from tiegraph.calibrate.judge import Precision, judge, parameters, precision
from tiegraph.calibrate.summary import lens_of
from tiegraph.geometry import transforms
from tiegraph.scene.targets import CENTRE

SIDES = ("left", "right")
BOARD = "checker:9x6:0.025"
SIZE = (640, 480)
SPLITS = 20


@dataclass(frozen=True)
class Stereo:
    """A stereo head in OpenCV's terms: matrices and distortions of both cameras, right_from_left (4, 4)."""

    matrices: tuple[np.ndarray, ...]
    distortions: tuple[np.ndarray, ...]
    right_from_left: np.ndarray

    def state(self) -> State:
        """The same as COLMAP's cameras."""
        cameras = []
        for matrix, terms in zip(self.matrices, self.distortions):
            middle = [matrix[0, 0], matrix[1, 1], matrix[0, 2] + CENTRE, matrix[1, 2] + CENTRE]
            width, height = SIZE
            params = [*middle, *terms.ravel()[:4]]
            cameras.append(pycolmap.Camera(model="OPENCV", width=width, height=height, params=params))
        return State(tuple(cameras), np.stack([np.eye(4), self.right_from_left]), {})


def main() -> None:
    """The command line above."""
    parser = argparse.ArgumentParser(description=__doc__.split("\n")[0])
    parser.add_argument("folder", type=Path)
    parser.add_argument("-o", "--out", type=Path, required=True)
    args = parser.parse_args()
    cv2.setNumThreads(1)
    ours, sample = observed(args.folder, _ours), observed(args.folder, _sample)
    results = {
        "images": {side: sum(v.camera == k for v in ours.views) for k, side in enumerate(SIDES)},
        "opencv": cv2.__version__,
        "single": [single(ours, side) for side in range(2)],
        "pair": pair(ours, sample),
        "halves": halves(ours, sample),
    }
    text = json.dumps(results, indent=1, default=float)
    args.out.write_text(text + "\n")
    print(text)  # noqa: T201


# --- corners --------------------------------------------------------------------------------------------------------


def _ours(pixels: np.ndarray) -> np.ndarray:
    return detect(pixels, read_board(BOARD))[1]


def _sample(pixels: np.ndarray) -> np.ndarray:
    flags = cv2.CALIB_CB_ADAPTIVE_THRESH | cv2.CALIB_CB_NORMALIZE_IMAGE
    found, xy = cv2.findChessboardCorners(pixels, (9, 6), flags=flags)
    if not found:
        return np.zeros((0, 2))
    end = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 30, 0.01)
    return cv2.cornerSubPix(pixels, xy, (11, 11), (-1, -1), end).reshape(-1, 2).astype(float) + CENTRE


def observed(folder: Path, find: Callable[[np.ndarray], np.ndarray]) -> Observations:
    """The corners of all images, numbered as ``_ours`` does."""
    board, views = read_board(BOARD), []
    for camera, side in enumerate(SIDES):
        for file in sorted(folder.glob(f"{side}[01][0-9].jpg")):
            pixels = cv2.imread(str(file), cv2.IMREAD_GRAYSCALE)
            xy, like = find(pixels), _ours(pixels)
            if not len(xy):
                continue
            if len(like) and np.hypot(*(xy - like).T).mean() > np.hypot(*(xy[::-1] - like).T).mean():
                xy = xy[::-1]
            views.append(View(camera, int(file.stem[-2:]), file.name, np.arange(len(xy)), xy))
    images = tuple(CameraImages(s, s, "OPENCV", SIZE, sum(v.camera == k for v in views)) for k, s in enumerate(SIDES))
    return Observations(board, images, tuple(views))


def _arrays(seen: Observations) -> tuple[list[np.ndarray], tuple[list[np.ndarray], ...]]:
    """What OpenCV takes: places on the board of each instant, corners of each camera."""
    points = [seen.board.points.astype(np.float32) for _ in seen.instants()]
    by = {(v.camera, v.instant): (v.xy - CENTRE).astype(np.float32) for v in seen.views}
    cameras = range(len(seen.cameras))
    return points, tuple([by[camera, k] for k in seen.instants()] for camera in cameras)


# --- calibrations ---------------------------------------------------------------------------------------------------


def tiegraphs(seen: Observations) -> tuple[Stereo, Precision]:
    """By `tiegraph calibrate`'s adjustment."""
    done = adjust_robustly(seen, start(seen))
    lenses = [lens for camera in done.state.cameras if (lens := lens_of(camera)) is not None]
    matrices = tuple(np.array([[m[0], 0, m[2]], [0, m[1], m[3]], [0, 0, 1]]) for m in (lens.middle for lens in lenses))
    terms = tuple(np.array(lens.terms) for lens in lenses)
    return Stereo(matrices, terms, done.state.sensor_from_rig[-1]), precision(done)


def opencvs(seen: Observations) -> Stereo:
    """By calibrateCamera of each camera, then stereoCalibrate of all."""
    points, xy = _arrays(seen)
    alone = [cv2.calibrateCamera(points, one, SIZE, None, None, flags=cv2.CALIB_FIX_K3)[1:3] for one in xy]  # type: ignore[call-overload]
    (k1, d1), (k2, d2) = alone
    flags = cv2.CALIB_USE_INTRINSIC_GUESS | cv2.CALIB_FIX_K3
    end = (cv2.TERM_CRITERIA_COUNT + cv2.TERM_CRITERIA_EPS, 200, 1e-9)
    _, k1, d1, k2, d2, turn, place, *_ = cv2.stereoCalibrate(  # type: ignore[call-overload]
        points, xy[0], xy[1], k1, d1, k2, d2, SIZE, flags=flags, criteria=end
    )
    return Stereo((k1, k2), (d1.ravel()[:4], d2.ravel()[:4]), transforms.rigid(turn, place.ravel()))


def single(seen: Observations, side: int) -> dict[str, Any]:
    """One camera by both: parameters, RMS of a coordinate, and how halves of the images differ in sigmas."""
    own = seen.of_camera(side)
    done = adjust_robustly(own, start(own))
    verdict = judge(done)
    values, sigma, rms = _opencv_single(own)
    exact = verdict.precision
    ours = np.array([p.value for p in exact.parameters])
    apart = {"tiegraph": [], "opencv": []}
    for one, two in _drawn(own.instants()):
        halves_ = [own.among(instants) for instants in (one, two)]
        found = [adjust_robustly(half, start(half)) for half in halves_]
        sigmas = [precision(half).sigma for half in found]
        values_ = [np.array([p.value for p in parameters(half.state)]) for half in found]
        apart["tiegraph"].append((values_[0] - values_[1]) / np.hypot(*sigmas))
        (a, sa, _), (b, sb, _) = (_opencv_single(half) for half in halves_)
        apart["opencv"].append((a - b) / np.hypot(sa, sb))
    return {
        "camera": SIDES[side],
        "rms_px": {"tiegraph": verdict.cameras[0].rms_px, "opencv": rms},
        "held_out_px": {"tiegraph": verdict.cameras[0].held_out_px},
        "parameters": _compared([p.name for p in exact.parameters], ours, exact.sigma, values, sigma),
        "halves_apart_in_sigmas_rms": {name: _rms(np.array(rows)) for name, rows in apart.items()},
    }


def _opencv_single(seen: Observations) -> tuple[np.ndarray, np.ndarray, float]:
    """Values and sigmas in the order of COLMAP's OPENCV, and RMS of a coordinate."""
    points, (xy,) = _arrays(seen)
    rms, matrix, terms, _, _, sigma, *_ = cv2.calibrateCameraExtended(  # type: ignore[call-overload]
        points, xy, SIZE, None, None, flags=cv2.CALIB_FIX_K3
    )
    middle = [matrix[0, 0], matrix[1, 1], matrix[0, 2] + CENTRE, matrix[1, 2] + CENTRE]
    return np.array([*middle, *terms.ravel()[:4]]), sigma.ravel()[:8], float(rms / np.sqrt(2))


def pair(ours: Observations, sample: Observations) -> dict[str, Any]:
    """The head by all three: parameters, and how they are judged on all pairs."""
    (found, exact), opencv, theirs = tiegraphs(ours), opencvs(ours), opencvs(sample)
    values, other = ([p.value for p in parameters(s.state())] for s in (found, opencv))
    names = [f"{SIDES[p.camera]} {p.name}" for p in exact.parameters]
    table = _compared(names, np.array(values), exact.sigma, np.array(other))
    judged = {"tiegraph": found, "opencv": opencv, "sample": theirs}
    return {"parameters": table, **{name: judged_on(stereo, ours) for name, stereo in judged.items()}}


def halves(ours: Observations, sample: Observations) -> dict[str, Any]:
    """Calibrated on one half, judged on the other: means over the draws, and how often each is better than OpenCV."""
    rows: dict[str, list[dict[str, float]]] = {"tiegraph": [], "opencv": [], "sample": []}
    for one, two in _drawn(ours.instants()):
        asked = ours.among(two)
        rows["tiegraph"].append(judged_on(tiegraphs(ours.among(one))[0], asked))
        rows["opencv"].append(judged_on(opencvs(ours.among(one)), asked))
        rows["sample"].append(judged_on(opencvs(sample.among(one)), asked))
    out: dict[str, Any] = {"draws": SPLITS}
    for name, found in rows.items():
        out[name] = {key: float(np.mean([r[key] for r in found])) for key in found[0]}
        better = [r["rows_rms_px"] < o["rows_rms_px"] for r, o in zip(found, rows["opencv"])]
        out[name]["rows_better_than_opencv"] = int(sum(better))
    return out


# --- judgement ------------------------------------------------------------------------------------------------------


def judged_on(stereo: Stereo, seen: Observations) -> dict[str, float]:
    """RMS of a coordinate in the left images and, transferred, in the right ones; row differences once rectified."""
    points, xy = _arrays(seen)
    turn, place = stereo.right_from_left[:3, :3], stereo.right_from_left[:3, 3]
    (k1, k2), (d1, d2) = stereo.matrices, stereo.distortions
    r1, r2, p1, p2, *_ = cv2.stereoRectify(k1, d1, k2, d2, SIZE, turn, place[:, None])
    off: tuple[list[np.ndarray], ...] = ([], [], [])
    for board, left, right in zip(points, *xy):
        _, turned, moved = cv2.solvePnP(board, left, k1, d1)
        pose = stereo.right_from_left @ transforms.rigid(cv2.Rodrigues(turned)[0], moved.ravel())
        off[0].append(left - cv2.projectPoints(board, turned, moved, k1, d1)[0][:, 0])
        seen_right = cv2.projectPoints(board, cv2.Rodrigues(pose[:3, :3])[0], pose[:3, 3], k2, d2)[0][:, 0]
        off[1].append(right - seen_right)
        flat = [
            cv2.undistortPoints(*side)[:, 0, 1]
            for side in ((left, k1, d1, None, r1, p1), (right, k2, d2, None, r2, p2))
        ]
        off[2].append(flat[0] - flat[1])
    names = ("left_rms_px", "transfer_rms_px", "rows_rms_px")
    return {name: _rms(np.concatenate(found)) for name, found in zip(names, off)}


def _compared(
    names: Sequence[str], ours: np.ndarray, sigma: np.ndarray, other: np.ndarray, theirs: np.ndarray | None = None
) -> dict[str, dict[str, float]]:
    """By name: both values, our sigma, theirs where there is one, the difference in our sigmas."""
    out = {}
    for k, name in enumerate(names):
        row = {
            "tiegraph": ours[k],
            "opencv": other[k],
            "sigma": sigma[k],
            "apart_in_sigmas": (ours[k] - other[k]) / sigma[k],
        }
        out[name] = row if theirs is None else {**row, "opencv_sigma": theirs[k]}
    return out


def _drawn(instants: Sequence[int]) -> list[tuple[list[int], list[int]]]:
    """Halves of the instants, drawn with a seed: the first has the odd one."""
    rng, out = np.random.default_rng(0), []
    for _ in range(SPLITS):
        mixed = rng.permutation(instants).tolist()
        half = (len(mixed) + 1) // 2
        out.append((sorted(mixed[:half]), sorted(mixed[half:])))
    return out


def _rms(values: np.ndarray) -> float:
    return float(np.sqrt(np.mean(values**2)))


if __name__ == "__main__":
    main()
