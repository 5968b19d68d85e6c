"""Boards rendered through pycolmap's cameras, with truth: texture, lens, blur, noise."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

import cv2
import numpy as np
import pycolmap
from scipy.spatial.transform import Rotation

from tiegraph.calibrate.adjust import State
from tiegraph.calibrate.board import APRILGRID, CHARUCO, Board, CameraImages, Observations, View
from tiegraph.geometry import transforms
from tiegraph.scene.rig import on_plane

OVERSAMPLING = 2
BACKGROUND = 150


@dataclass(frozen=True)
class Texture:
    """Grey values (H, W), and the pixel (3, 3) of a place (x, y, 1) on the board, metres."""

    pixels: np.ndarray
    pixel_from_board: np.ndarray


def texture(board: Board, square_px: int = 100, trimmed: float = 1.0) -> Texture:
    """What is printed: by OpenCV of ChArUco boards, else square by square; of the outermost squares of a checkerboard
    so much is left."""
    if board.kind == CHARUCO:
        name = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
        drawn = cv2.aruco.CharucoBoard(board.counts, 1.0, board.marker, name)
        across, down = (square_px * n for n in board.counts)
        return _framed(drawn.generateImage((across, down)), square_px / board.points[0, 0])
    if board.kind == APRILGRID:
        return _aprilgrid(board, square_px)
    across, down = board.counts
    x, y = np.meshgrid(np.arange(across + 1), np.arange(down + 1))
    squares = np.kron(255 * ((x + y) % 2), np.ones((square_px, square_px))).astype(np.uint8)
    cut = round((1 - trimmed) * square_px)
    squares = squares[cut : len(squares) - cut, cut : squares.shape[1] - cut]
    side = board.points[1, 0] * (1 - cut / square_px)
    found = _framed(squares, square_px / board.points[1, 0])
    moved = np.eye(3)
    moved[:2, 2] = side
    return Texture(found.pixels, found.pixel_from_board @ moved)


def _framed(pixels: np.ndarray, per_metre: float) -> Texture:
    """A board whose upper left edge is its origin, with a white margin."""
    margin = pixels.shape[0] // 8
    framed = cv2.copyMakeBorder(pixels, margin, margin, margin, margin, cv2.BORDER_CONSTANT, value=255)
    place = np.array([[per_metre, 0, margin - 0.5], [0, per_metre, margin - 0.5], [0, 0, 1]])
    return Texture(framed, place)


def _aprilgrid(board: Board, tag_px: int) -> Texture:
    """As kalibr_create_target_pdf draws it: y up, borders of two bits, squares in the gaps between corners."""
    across, down = board.counts
    size = board.points[0, 0]  # the first corner is the lower right one
    pitch = board.points[4 * across, 1] if down > 1 else board.points[5, 0]
    gap = round((pitch / size - 1) * tag_px)
    step = tag_px + gap
    out = np.full((down * step + gap, across * step + gap), 255, np.uint8)
    for row in range(down + 1):
        for column in range(across + 1):
            top, left = out.shape[0] - row * step - gap, column * step
            out[top : top + gap, left : left + gap] = 0
    dictionary = cv2.aruco.getPredefinedDictionary(getattr(cv2.aruco, board.dictionary))
    for tag in range(across * down):
        row, column = divmod(tag, across)
        top, left = out.shape[0] - (row + 1) * step, column * step + gap
        drawn = cv2.aruco.generateImageMarker(dictionary, tag, tag_px, borderBits=2)
        out[top : top + tag_px, left : left + tag_px] = np.rot90(drawn, 2)
    margin = step
    out = cv2.copyMakeBorder(out, margin, margin, margin, margin, cv2.BORDER_CONSTANT, value=255)
    scale = tag_px / size
    lower = out.shape[0] - margin - gap
    return Texture(out, np.array([[scale, 0, margin + gap - 0.5], [0, -scale, lower - 0.5], [0, 0, 1]]))


class Renderer:
    """Images of a board through one camera; its rays are computed once."""

    def __init__(self, camera: pycolmap.Camera, texture: Texture) -> None:
        self.camera, self.texture = camera, texture
        self.plane = _plane(camera).astype(np.float32)

    def __call__(self, camera_from_board: np.ndarray, noise: float, rng: np.random.Generator) -> np.ndarray:
        """(H, W) u1."""
        to_texture = self.texture.pixel_from_board @ np.linalg.inv(camera_from_board[:3, [0, 1, 3]])
        height, width = self.texture.pixels.shape
        coarse = _on_texture(self.plane[::_COARSE, ::_COARSE], to_texture)
        seen = np.argwhere(((coarse > 0) & (coarse < (width, height))).all(axis=2))
        low = np.maximum(_COARSE * (seen.min(axis=0) - 1), 0)
        high = _COARSE * (seen.max(axis=0) + 2)
        rows, columns = (slice(a, b) for a, b in zip(low, high))
        fine = np.full(self.plane.shape[:2], BACKGROUND, np.float32)
        xy = _on_texture(self.plane[rows, columns], to_texture)
        fine[rows, columns] = cv2.remap(self.texture.pixels, xy, None, cv2.INTER_LINEAR, borderValue=BACKGROUND)
        blurred = cv2.GaussianBlur(fine, (0, 0), 0.6 * OVERSAMPLING)
        small = cv2.resize(blurred, (self.camera.width, self.camera.height), interpolation=cv2.INTER_AREA)
        noisy = 30 + 0.75 * small + noise * rng.standard_normal(small.shape, np.float32)
        return np.clip(noisy, 0, 255).round().astype(np.uint8)


_COARSE = 16


def _plane(camera: pycolmap.Camera) -> np.ndarray:
    """The rays of all samples on the plane z = 1 (rows, columns, 2), linear between the middles of the pixels: within
    0.0002 px of the lens for OPENCV of this folder, at the edges too."""
    x, y = (np.arange(-1, n + 1) + 0.5 for n in (camera.width, camera.height))  # one more at each edge
    grid = np.stack(np.meshgrid(x, y), axis=-1)
    middles = on_plane(camera, grid.reshape(-1, 2)).reshape(grid.shape)
    fine = cv2.resize(middles, None, fx=OVERSAMPLING, fy=OVERSAMPLING, interpolation=cv2.INTER_LINEAR)
    return fine[OVERSAMPLING:-OVERSAMPLING, OVERSAMPLING:-OVERSAMPLING]


def _on_texture(plane: np.ndarray, to_texture: np.ndarray) -> np.ndarray:
    """Pixels (rows, columns, 2) of the print under places on the plane z = 1."""
    return cv2.perspectiveTransform(np.ascontiguousarray(plane), to_texture)


def camera(model: str, params: list[float], size: tuple[int, int]) -> pycolmap.Camera:
    """A true camera."""
    made = pycolmap.Camera(model=model, width=size[0], height=size[1], params=params)
    made.has_prior_focal_length = True
    return made


def rig_pose(turn_deg: tuple[float, float, float], centre_m: tuple[float, float, float]) -> np.ndarray:
    """sensor_from_rig (4, 4) of a camera turned (about x, y, z) and placed in the rig."""
    rotation = Rotation.from_euler("xyz", turn_deg, degrees=True).as_matrix()
    return transforms.invert(transforms.rigid(rotation, np.array(centre_m)))


def board_before(
    board: Board,
    camera: pycolmap.Camera,
    rng: np.random.Generator,
    *,
    tilt_deg: float,
    depth_m: tuple[float, float],
    spread: float = 0.7,
) -> np.ndarray:
    """camera_from_board (4, 4) of a board whose middle is somewhere in the image, tilted in any direction."""
    aim = rng.uniform(0.5 - spread / 2, 0.5 + spread / 2, 2) * (camera.width, camera.height)
    ray = np.append(on_plane(camera, aim[None])[0], 1.0)
    around = rng.uniform(0, 2 * np.pi)
    axis = np.array([np.cos(around), np.sin(around), 0])
    turn = Rotation.from_rotvec(np.radians(rng.uniform(0.6, 1) * tilt_deg) * axis)
    upright = np.diag([1.0, -1.0, -1.0]) if board.kind == APRILGRID else np.eye(3)  # its y points up
    spin = Rotation.from_rotvec([0, 0, rng.uniform(-1.6, 1.6)])
    rotation = (turn * spin).as_matrix() @ upright
    place = rng.uniform(*depth_m) * ray / ray[2] - rotation @ board.points.mean(axis=0)
    return transforms.rigid(rotation, place)


def boards_of_rig(
    board: Board,
    cameras: list[pycolmap.Camera],
    sensors: list[np.ndarray],
    *,
    count: int,
    seed: int,
    tilt_deg: float = 40.0,
    depth_m: tuple[float, float] = (0.35, 0.6),
) -> dict[int, np.ndarray]:
    """rig_from_board by instant: before each camera in turn, and in the middle between neighbours."""
    rng, poses = np.random.default_rng(seed), [transforms.invert(s) for s in sensors]
    half = [transforms.interpolate(np.array([0.0, 1]), np.stack(p), np.array([0.5]))[0] for p in zip(poses, poses[1:])]
    seen_from = [(pose, 0.7) for pose in poses] + [(pose, 0.15) for pose in half]
    out = {}
    for k in range(count):
        pose, spread = seen_from[k % len(seen_from)]
        how = {"tilt_deg": tilt_deg, "depth_m": depth_m, "spread": spread}
        out[k] = pose @ board_before(board, cameras[k % len(cameras)], rng, **how)  # type: ignore[arg-type]
    return out


def observed(board: Board, truth: State, names: list[str], *, noise_px: float, seed: int = 0) -> Observations:
    """The corners as a detector with normal errors would find them."""
    rng, views = np.random.default_rng(seed), []
    for instant in truth.rig_from_board:
        for k, camera in enumerate(truth.cameras):
            view = View(k, instant, f"{names[k]}/{instant:03d}.png", np.zeros(0, int), np.zeros((0, 2)))
            inside = transforms.apply(truth.camera_from_board(view), board.points)
            xy = np.asarray(camera.img_from_cam(inside), float)
            good = (inside[:, 2] > 0) & (xy > 0).all(axis=1) & (xy < (camera.width, camera.height)).all(axis=1)
            if good.sum() >= 8:
                noisy = xy[good] + rng.normal(0, noise_px, (good.sum(), 2))
                views.append(View(k, instant, view.name, np.flatnonzero(good), noisy))
    images = tuple(
        CameraImages(n, n, c.model.name, (c.width, c.height), len(truth.rig_from_board))
        for n, c in zip(names, truth.cameras)
    )
    return Observations(board, images, tuple(views))


def render_rig(folder: Path, board: Board, truth: State, names: list[str], *, noise: float = 2.0, seed: int = 0) -> int:
    """Write ``<name>/<instant>.png`` of every camera that sees some of the board; their number."""
    rng, printed, count = np.random.default_rng(seed), texture(board), 0
    for k, (name, camera) in enumerate(zip(names, truth.cameras)):
        render = Renderer(camera, printed)
        (folder / name).mkdir(parents=True, exist_ok=True)
        for instant, pose in truth.rig_from_board.items():
            seen = truth.sensor_from_rig[k] @ pose
            inside = transforms.apply(seen, board.points)
            if (inside[:, 2] < 0.05).any():
                continue
            xy = np.asarray(camera.img_from_cam(inside), float)
            if ((xy > 0).all(axis=1) & (xy < (camera.width, camera.height)).all(axis=1)).sum() < 6:
                continue
            cv2.imwrite(str(folder / name / f"{instant:03d}.png"), render(seen, noise, rng))
            count += 1
    return count
