"""How good a calibration is: held-out instants, coverage of the images, what the views leave open, and advice."""

from dataclasses import dataclass

import numpy as np

from tiegraph.calibrate.adjust import Adjusted, State, adjust, place_boards, view_residuals
from tiegraph.calibrate.covariance import Precision, precision
from tiegraph.calibrate.observations import Observations
from tiegraph.calibrate.tuning import Tuning
from tiegraph.errors import ReconstructionError
from tiegraph.geometry.align import CAUCHY_SIGMAS

CELLS = 10
"""Along the longer side of an image, for the coverage and the mean residuals."""
_DOWN, _ACROSS = ("upper", "middle", "lower"), ("left", "centre", "right")


@dataclass(frozen=True)
class CameraVerdict:
    """Of one camera: views and corners, root mean square of a residual's coordinate (pixels) of the adjusted and of
    held-out instants, share of its image in which corners were seen, largest tilt of the board (deg)."""

    views: int
    corners: int
    rms_px: float
    held_out_px: float
    coverage: float
    tilt_deg: float


@dataclass(frozen=True)
class Verdict:
    """Of all cameras, in their order; what to do better, in words."""

    cameras: tuple[CameraVerdict, ...]
    precision: Precision
    advice: tuple[str, ...]


def judge(done: Adjusted, tuning: Tuning) -> Verdict:
    """Sigmas, cross-validation, coverage and advice.

    Raises ReconstructionError if the views leave a focal length open.
    """
    exact = precision(done, tuning.adjust)
    # Largest angle, degrees, between the board's normal and the line of sight to its middle, of each camera
    tilts = [0.0] * len(done.seen.cameras)
    for view in done.seen.views:
        pose = done.state.camera_from_board(view)
        sight = pose[:3, :3] @ done.seen.board.points.mean(axis=0) + pose[:3, 3]
        cosine = abs(float(pose[:3, 2] @ sight)) / float(np.linalg.norm(sight))
        tilts[view.camera] = max(tilts[view.camera], float(np.degrees(np.arccos(min(cosine, 1.0)))))
    for number, images in enumerate(done.seen.cameras):
        share = relative_focal_sigma(done, exact, number)
        if not share <= 0.01:
            focal = done.state.cameras[number].mean_focal_length()
            raise ReconstructionError(
                f"{images.name}: these views do not determine its focal length: {focal:.0f} px with a sigma of "
                f"{100 * share:.2g} %. The board was tilted by {tilts[number]:.0f} degrees at most against the line of "
                "sight: take views with 30 to 45 degrees, to all four sides, and near ones that fill the image"
            )
    inside, held_out = view_residuals(done.seen, done.state), held_out_residuals(done, tuning)
    cameras = []
    for number, images in enumerate(done.seen.cameras):
        own = [k for k, view in enumerate(done.seen.views) if view.camera == number]
        longer = max(images.size)
        across, down = (max(1, round(CELLS * side / longer)) for side in images.size)
        cameras.append(
            CameraVerdict(
                views=len(own),
                corners=sum(len(inside[k]) for k in own),
                rms_px=_rms([inside[k] for k in own]),
                held_out_px=_rms([held_out[k] for k in own]),
                coverage=float((seen_cells(done.seen, number, (across, down)) > 0).mean()),
                tilt_deg=tilts[number],
            )
        )
    return Verdict(tuple(cameras), exact, tuple(_advice(done, cameras, exact)))


def _rms(found: list[np.ndarray]) -> float:
    return float(np.sqrt(np.nanmean(np.concatenate(found) ** 2)))


def held_out_residuals(done: Adjusted, tuning: Tuning) -> list[np.ndarray]:
    """(K, 2) residuals of every view from cameras and rig that were adjusted without its instant, to which only the
    board's place was fitted, pixels."""
    out: dict[str, np.ndarray] = {}
    scale = max(CAUCHY_SIGMAS * done.sigma_px, tuning.adjust.least_scale_px)
    instants = done.seen.instants()
    for fold in range(min(5, len(instants))):
        held = set(instants[fold::5])
        kept, asked = done.seen.among(set(instants) - held), done.seen.among(held)
        found = adjust(kept, done.state.at(kept.instants()), tuning.adjust, (scale,))
        boards = {k: done.state.rig_from_board[k] for k in held}
        placed = place_boards(asked, State(found.cameras, found.sensor_from_rig, boards), tuning.adjust, scale)
        out |= {v.name: r for v, r in zip(asked.views, view_residuals(asked, placed))}
    return [out[view.name] for view in done.seen.views]


def relative_focal_sigma(done: Adjusted, exact: Precision, camera: int) -> float:
    """Sigma of a camera's focal length over it, the larger of both directions."""
    found = done.state.cameras[camera]
    names = [n.strip() for n in found.params_info.split(",")]
    at = list(found.focal_length_idxs())
    return float(np.max(exact.of(camera, *(names[k] for k in at)) / np.abs(found.params[at])))


# --- coverage and advice --------------------------------------------------------------------------------------------


def seen_cells(seen: Observations, camera: int, cells: tuple[int, int]) -> np.ndarray:
    """(rows, columns) number of corners in each cell of a camera's image."""
    xy = np.concatenate([v.xy for v in seen.views if v.camera == camera])
    width, height = seen.cameras[camera].size
    across, down = cells
    return np.histogram2d(xy[:, 1], xy[:, 0], (down, across), ((0, height), (0, width)))[0]


def _advice(done: Adjusted, cameras: list[CameraVerdict], exact: Precision) -> list[str]:
    out = []
    for number, (images, verdict) in enumerate(zip(done.seen.cameras, cameras)):
        name = images.name
        empty = _empty_thirds(done.seen, number)
        if empty:
            out.append(f"{name}: no corner in the {' and the '.join(empty)} of the image: move the board there")
        if verdict.views < 10:  # the least of OpenCV's tutorial
            out.append(f"{name}: {verdict.views} views of the board: take 20")
        if verdict.tilt_deg < 20:
            out.append(f"{name}: the board was tilted by {verdict.tilt_deg:.0f} degrees at most: tilt it by 30 to 45")
        share = relative_focal_sigma(done, exact, number)
        if share > 0.001:
            out.append(f"{name}: the focal length has a sigma of {100 * share:.2g} %: more views, nearer and tilted")
        if verdict.held_out_px > 1.5 * verdict.rms_px:
            out.append(
                f"{name}: held-out instants are off by {verdict.held_out_px:.2f} px, the adjusted ones by "
                f"{verdict.rms_px:.2f} px: too few views for model {images.model}; take more, or a simpler model"
            )
    # The images whose corners fit much worse than those of the others of their camera
    rms = np.array([_rms([off]) for off in view_residuals(done.seen, done.state)])
    camera = np.array([view.camera for view in done.seen.views])
    usual = {int(c): float(np.median(rms[camera == c])) for c in np.unique(camera)}
    return out + [
        f"{view.name}: its corners are {off:.2f} px off (RMS), those of others {usual[view.camera]:.2f} px: is it "
        "blurred, or something before the board?"
        for view, off in zip(done.seen.views, rms)
        if off > 3 * usual[view.camera]
    ]


def _empty_thirds(seen: Observations, camera: int) -> list[str]:
    """Parts of the image, thirds across and down, without a corner; of fisheye images those that the lens may light."""
    count = seen_cells(seen, camera, (3, 3))
    width, height = seen.cameras[camera].size
    # Of half the shorter side: beyond it, what a fisheye lens may leave dark
    reach = 1.18 * min(width, height) / 2 if "FISHEYE" in seen.cameras[camera].model else np.inf
    return [
        f"{_DOWN[row]} {_ACROSS[column]}"
        for row, column in zip(*np.nonzero(count == 0))
        if np.hypot((column - 1) * width / 3, (row - 1) * height / 3) < reach
    ]
