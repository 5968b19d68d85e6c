"""The two steps of a depth map, each for one image in one worker: match with partners, then compare with neighbours."""

from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np

from tiegraph.dense.consistency import Consistency, LoadDepth, check
from tiegraph.dense.engine import ENGINES, installed
from tiegraph.dense.plan import ImagePlan
from tiegraph.dense.settings import DenseSettings
from tiegraph.dense.tuning import Tuning
from tiegraph.dense.undistort import load_view
from tiegraph.plugins import chosen
from tiegraph.scene.results import DepthMap, row_strips


def depth_map(
    plan: ImagePlan, images: Path, masks: Path | None, settings: DenseSettings, tuning: Tuning, threads: int = 1
) -> DepthMap:
    """First step: match one image with its partners. ``masks`` None = use all pixels.

    ``threads`` limits OpenCV in this process. Raises InputError for an image that cannot be read.
    """
    cv2.setNumThreads(threads)
    engine = chosen("dense", installed(settings.engine)[0], ENGINES)
    reference = load_view(plan.view, images, masks, settings)
    partners = [load_view(view, images, masks, settings) for view in plan.partners]
    return engine(reference, partners, plan.depth_range, settings, tuning)  # type: ignore[no-any-return]


def confirmed_map(
    plan: ImagePlan, depth: DepthMap, load: LoadDepth, settings: DenseSettings, tuning: Tuning
) -> tuple[DepthMap, Consistency]:
    """Second step, when all first steps are done: compare with the witnesses' first maps (``load`` by name), then fit
    normals."""
    partners = [view.name for view in plan.partners]
    confirmed, counts = check(depth, partners, plan.witnesses, load, settings, tuning.rays)
    return with_normals(confirmed), counts


# --- surface normals of a depth map by local planes ------------------------------------------------------------------


_RADIUS_PX = 3  # of the window that a plane is fitted in


def with_normals(depth: DepthMap) -> DepthMap:
    """The depth map with normals (H, W, 3) f4 in the camera frame that face the camera; NaN where no plane fits.

    On a plane inverse depth is an affine function of the pixel: 1/z = a u + b v + c, and the normal is along
    (a fx, b fy, a cx + b cy + c). The least squares fit in a window is a few box filters, holes left out.
    """
    found = 1 / depth.depth_m[np.isfinite(depth.depth_m)]
    middle = float(np.median(found.astype(float))) if len(found) else 1.0
    normal = np.empty((*depth.depth_m.shape, 3), np.float32)
    for rows in row_strips(depth.depth_m.shape):
        normal[rows] = _normals(depth, rows, middle)
    return replace(depth, normal=normal)


def _normals(depth: DepthMap, rows: slice, middle: float) -> np.ndarray:
    """Normals of some rows, by inverse depths in units of ``middle``."""
    top = max(0, rows.start - _RADIUS_PX)
    depth_m, inner = depth.depth_m[top : rows.stop + _RADIUS_PX], slice(rows.start - top, rows.stop - top)
    known = np.isfinite(depth_m)
    inverse = np.where(known, 1 / np.where(known, depth_m, 1), 0).astype(np.float64)
    plane = _planes(known.astype(np.float64), inverse / middle).rows(inner)
    u, v = np.arange(depth_m.shape[1]) + 0.5, (np.arange(rows.start, rows.stop) + 0.5)[:, None]
    K = depth.K
    # The window's plane is w = a (u' - u) + b (v' - v) + c about its centre (u, v).
    x, y = (u - K[0, 2]) / K[0, 0], (v - K[1, 2]) / K[1, 1]
    n_x, n_y = plane.a * K[0, 0], plane.b * K[1, 1]
    normal = np.stack([n_x, n_y, plane.c - n_x * x - n_y * y], axis=-1)
    normal = -normal / np.maximum(np.linalg.norm(normal, axis=-1, keepdims=True), 1e-12)
    return np.where((plane.good & known[inner])[..., None], normal, np.nan)


@dataclass(frozen=True)
class _Planes:
    """Coefficients (H, W) of w = a du + b dv + c in the window about each pixel, and where the fit is good."""

    a: np.ndarray
    b: np.ndarray
    c: np.ndarray
    good: np.ndarray  # bool

    def rows(self, rows: slice) -> "_Planes":
        """Of some rows."""
        return _Planes(**{name: values[rows] for name, values in self.__dict__.items()})


def _planes(known: np.ndarray, w: np.ndarray) -> _Planes:
    """The planes that fit the known pixels best."""
    k0 = np.ones(2 * _RADIUS_PX + 1)
    k1 = np.arange(-_RADIUS_PX, _RADIUS_PX + 1, dtype=float)
    k2 = k1**2

    def moment(values: np.ndarray, kx: np.ndarray, ky: np.ndarray) -> np.ndarray:
        return cv2.sepFilter2D(values, cv2.CV_64F, kx, ky, borderType=cv2.BORDER_CONSTANT)

    wm = w * known
    n, su, sv = moment(known, k0, k0), moment(known, k1, k0), moment(known, k0, k1)
    suu, svv, suv = moment(known, k2, k0), moment(known, k0, k2), moment(known, k1, k1)
    sw, swu, swv = moment(wm, k0, k0), moment(wm, k1, k0), moment(wm, k0, k1)
    sww = moment(wm * w, k0, k0)
    count = np.maximum(n, 1)
    mu, mv, mw = su / count, sv / count, sw / count
    cuu, cvv, cuv = suu / count - mu**2, svv / count - mv**2, suv / count - mu * mv
    cwu, cwv = swu / count - mw * mu, swv / count - mw * mv
    det = cuu * cvv - cuv**2
    safe = np.where(det > 1e-3, det, 1)
    a, b = (cwu * cvv - cwv * cuv) / safe, (cwv * cuu - cwu * cuv) / safe
    c = mw - a * mu - b * mv
    residual = np.maximum(sww / count - mw**2 - a * cwu - b * cwv, 0)
    good = (n >= 12) & (det > 1e-3) & (residual <= (0.02 * mw) ** 2)  # more is an edge
    return _Planes(a=a, b=b, c=c, good=good)
