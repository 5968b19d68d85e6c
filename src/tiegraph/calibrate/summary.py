"""What is told and written of a calibration: a summary, and files for other programs."""

import re
from collections.abc import Mapping, Sequence
from urllib.parse import quote

import cv2
import numpy as np
import pycolmap
from matplotlib.figure import Figure

from tiegraph.calibrate.adjust import Adjusted, view_residuals
from tiegraph.calibrate.judge import CELLS, PLACE, TURN, Precision, Verdict
from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import invert
from tiegraph.scene.results import png
from tiegraph.scene.targets import CENTRE
from tiegraph.text import one_line

_CAMERA = ("views", "corners", "RMS px", "RMS held out px", "image covered", "largest tilt deg")
_PLACES = (
    "Places: of the projection centre in the frame of the first camera. Turns: rotation vector of the camera against "
    "the first one; their sigmas are about the camera's own axes."
)


def summary(done: Adjusted, verdict: Verdict, board: str, notes: Sequence[str], pictures: Mapping[str, str]) -> str:
    """Markdown: cameras, advice, parameters, what was left out; ``pictures``: file names by camera."""
    names = [c.name for c in done.seen.cameras]
    cameras = [
        [name, v.views, v.corners, f"{v.rms_px:.3f}", f"{v.held_out_px:.3f}", f"{v.coverage:.0%}", f"{v.tilt_deg:.0f}"]
        for name, v in zip(names, verdict.cameras)
    ]
    bend = []
    if done.bent_m.any():  # how far the corners were found from a flat board
        seen = 1000 * done.bent_m[done.seen.corners()]
        across, inside = np.abs(seen[:, 2]), np.linalg.norm(seen[:, :2], axis=1)
        bend.append(
            f"The board is not held flat: its corners were found up to {across.max():.2f} mm off its plane (RMS "
            f"{np.sqrt(np.mean(across**2)):.2f} mm) and up to {inside.max():.2f} mm from their places in it."
        )
    parts = [
        "# Calibration",
        f"Board `{board}`, {len(done.seen.instants())} instants, {len(done.seen.views)} views. Sigma of one coordinate "
        f"of a corner: {done.sigma_px:.3f} px.",
        _word(lengths(done)),
        *bend,
        _table(("camera", *_CAMERA), cameras),
        "RMS: of one coordinate, of all corners. Held out: instants that took no part in the adjustment, to which only "
        "the place of the board was fitted.",
        "## What to do better",
        _bullets(verdict.advice) or "Nothing.",
        "## Parameters",
        *([_PLACES] if len(names) > 1 else []),
        _table(COLUMNS, parameter_rows(verdict.precision, names)),
        *(f"![{_word(name)}]({quote(pictures[name])})" for name in names),
        "## Left out",
        _bullets([f"{name}: {reason}" for name, reason in done.left_out]) or "Nothing.",
        "## How the images were read",
        _bullets(notes),
    ]
    return "\n\n".join(parts) + "\n"


def lengths(done: Adjusted) -> str:
    """What the size of the board's squares decides, and how to notice that it is wrong."""
    names = [c.name for c in done.seen.cameras]
    if len(names) == 1:
        return "The size of the squares plays no part: a single camera's calibration has no lengths."
    apart = np.linalg.norm([transforms.centre(pose) for pose in done.state.sensor_from_rig], axis=1)
    far = int(np.argmax(apart))
    middle = done.seen.board.points.mean(axis=0)
    depths = [float(np.linalg.norm(transforms.apply(done.state.camera_from_board(v), middle))) for v in done.seen.views]
    return (
        f"All lengths come from the size of the board's squares, which no image can check. By it {names[0]} and "
        f"{names[far]} are {apart[far]:.4g} m apart, and the board was {min(depths):.2g} to {max(depths):.2g} m away: "
        "lay a ruler there, and over many squares."
    )


COLUMNS = ("camera", "parameter", "value", "sigma", "strongest correlation", "with")


def parameter_rows(exact: Precision, names: Sequence[str]) -> list[list[str]]:
    """Every parameter with its sigma and what it is most correlated with."""
    rows = []
    others = np.abs(exact.correlation - np.eye(len(exact.sigma)))
    for k, (parameter, sigma) in enumerate(zip(exact.parameters, exact.sigma)):
        most = int(np.argmax(others[k]))
        other = exact.parameters[most]
        said = [f"{parameter.value:.9g}", f"{sigma:.2g}", f"{exact.correlation[k, most]:.2f}"]
        rows.append([names[parameter.camera], parameter.name, *said, f"{names[other.camera]} {other.name}"])
    return rows


def rig_sigmas(exact: Precision, camera: int) -> tuple[float, float]:
    """(deg of each axis, m of each coordinate) of a camera in the rig."""
    turn, place = (float(np.sqrt(np.mean(exact.of(camera, *names) ** 2))) for names in (TURN, PLACE))
    return turn, place


def _table(columns: Sequence[str], rows: Sequence[Sequence[object]]) -> str:
    lines = [columns, ["---"] * len(columns), *([_word(cell) for cell in row] for row in rows)]
    return "\n".join(f"| {' | '.join(line)} |" for line in lines)


def _bullets(texts: Sequence[str]) -> str:
    return "\n".join(f"* {_word(text)}" for text in texts)


def _word(text: object) -> str:
    """Words that Markdown shows as they are: names of cameras may hold what it would act on."""
    return re.sub(r"([\\`*_\[\]<>|$])", r"\\\1", one_line(str(text)))


def residual_picture(done: Adjusted, camera: int) -> bytes:
    """PNG of one camera."""
    images = done.seen.cameras[camera]
    own = [k for k, view in enumerate(done.seen.views) if view.camera == camera]
    xy = np.concatenate([done.seen.views[k].xy for k in own])
    off = np.concatenate([r for k, r in enumerate(view_residuals(done.seen, done.state)) if k in own])
    side = max(images.size) / CELLS
    # Mean places and residuals of the corners in each cell that holds three: one or two say nothing of the lens
    good = np.isfinite(off).all(axis=1)
    _, number = np.unique(np.floor(xy[good] / side), axis=0, return_inverse=True)
    count, columns = np.bincount(number.ravel()), np.hstack([xy[good], off[good]]).T
    means = np.stack([np.bincount(number.ravel(), column) / count for column in columns], axis=1)
    at, mean = np.hsplit(means[count >= min(3, count.max())], 2)
    longest = max(float(np.hypot(*mean.T).max()), 1e-9)
    width, height = images.size
    figure = Figure(figsize=(7.0, 0.6 + 6.4 * height / width), dpi=110, layout="constrained")
    axes = figure.add_subplot()
    axes.plot(*xy.T, ".", ms=2, color="#c9d1d9")
    scale = longest / (0.8 * side)  # of a cell: the longest mean vector
    arrows = axes.quiver(*at.T, *mean.T, angles="xy", scale_units="xy", scale=scale, color="#1b6ca8", width=0.004)
    rounded = float(f"{longest:.1g}")
    axes.quiverkey(arrows, 0.9, 1.03, rounded, f"{rounded:g} px", labelpos="W")
    axes.set(xlim=(0, width), ylim=(height, 0), aspect="equal")
    axes.set_title(f"{images.name}: mean residuals, seen minus adjusted", loc="left", fontsize=10)
    return png(figure)


# Kalibr's camchain.yaml and OpenCV's YAML, the inverse of what ``scan`` reads. Both count pixels from the centre of the
# first one, and hold fewer lenses than COLMAP: polynomials of the radius with two tangential terms, and Kannala's of
# the angle.


_RADTAN_TERMS = 4  # of Kalibr: k1 k2 p1 p2


def lens_of(camera: pycolmap.Camera) -> tuple[tuple[float, ...], tuple[float, ...], bool] | None:
    """A camera in OpenCV's terms: fx, fy, cx, cy; k1 k2 p1 p2 [k3 k4 k5 k6], of a fisheye k1 k2 k3 k4; whether it is
    one. None if its model has no such form."""
    focal = [camera.params[k] for k in camera.focal_length_idxs()]
    centre = (camera.principal_point_x - CENTRE, camera.principal_point_y - CENTRE)
    middle = tuple(float(v) for v in (focal[0], focal[-1], *centre))
    terms = [float(camera.params[k]) for k in camera.extra_params_idxs()]
    radial = {"SIMPLE_PINHOLE", "PINHOLE", "SIMPLE_RADIAL", "RADIAL", "OPENCV", "FULL_OPENCV"}
    angular = {"SIMPLE_FISHEYE", "FISHEYE", "SIMPLE_RADIAL_FISHEYE", "RADIAL_FISHEYE", "OPENCV_FISHEYE"}
    if camera.model.name not in radial | angular:
        return None
    terms += [0.0] * (_RADTAN_TERMS - len(terms))
    return middle, tuple(terms), camera.model.name in angular


def opencv_yaml(camera: pycolmap.Camera) -> str | None:
    """A camera as OpenCV's sample ``camera_calibration`` writes it; None if its model has no such form."""
    lens = lens_of(camera)
    if lens is None:
        return None
    (fx, fy, cx, cy), terms, fisheye = lens
    storage = cv2.FileStorage(".yaml", cv2.FILE_STORAGE_WRITE | cv2.FILE_STORAGE_MEMORY)
    storage.write("image_width", camera.width)
    storage.write("image_height", camera.height)
    storage.write("fisheye_model", int(fisheye))
    storage.write("camera_matrix", np.array([[fx, 0, cx], [0, fy, cy], [0, 0, 1]]))
    storage.write("distortion_coefficients", np.array(terms)[:, None])
    return str(storage.releaseAndGetString())


def kalibr_yaml(cameras: Sequence[pycolmap.Camera], sensor_from_rig: np.ndarray) -> str | None:
    """A rig as Kalibr's camchain.yaml; None if one of its cameras has no such form."""
    lines: list[str] = []
    for number, camera in enumerate(cameras):
        lens = lens_of(camera)
        if lens is None or len(lens[1]) > _RADTAN_TERMS:
            return None
        middle, terms, fisheye = lens
        lines.append(f"cam{number}:")
        if number:
            chain = sensor_from_rig[number] @ invert(sensor_from_rig[number - 1])
            lines += ["  T_cn_cnm1:", *(f"  - {_list(row)}" for row in chain)]
        lines += [
            "  camera_model: pinhole",
            f"  distortion_model: {'equidistant' if fisheye else 'radtan'}",
            f"  distortion_coeffs: {_list(terms)}",
            f"  intrinsics: {_list(middle)}",
            f"  resolution: [{camera.width}, {camera.height}]",
        ]
    return "\n".join(lines) + "\n"


def _list(values: Sequence[float] | np.ndarray) -> str:
    return f"[{', '.join(repr(float(v)) for v in values)}]"
