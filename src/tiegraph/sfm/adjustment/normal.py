"""The reduced normal equations of the cameras (points eliminated): sparse, with a free gauge, solved for chosen
functions.

A function of the unknowns (a position, a rotation, a point) is a row of numbers. The S-transformation over all
positions (Baarda 1973) makes it independent of the gauge: its value after the best similarity to the truth. For such
rows any solution of the singular system will do, so the factorisation takes the simplest one: three frames hold the
gauge. Frames that share points are near the diagonal, so the factor of a long pass grows linearly with its length.
"""

import numpy as np
from scipy import sparse
from scipy.sparse.linalg import splu

from tiegraph.geometry.transforms import rms_length, skew
from tiegraph.sfm.adjustment.jacobians import Layout

_RIDGE = 1e-9  # of the stiffness: a frame that no point holds gets a huge sigma instead of a singular matrix
_KNOWN = 1e-8  # of the stiffness: a scale held by more is known (a rig of fixed size), by less it is rounding
_AT_ONCE = 300  # right sides solved together: memory
_ROWS = 90_000  # unknowns of points whose dense products are held at once: memory


def point_inverse(jp: sparse.csr_matrix) -> np.ndarray:
    """(P, 3, 3) pseudo-inverse of each point's own normal matrix; each observation involves one point."""
    blocks = (jp.T @ jp).tobsr(blocksize=(3, 3))
    dense = np.zeros((jp.shape[1] // 3, 3, 3))
    dense[blocks.indices] = blocks.data
    return np.asarray(np.linalg.pinv(dense, hermitian=True))


def by_blocks(blocks: np.ndarray) -> sparse.bsr_matrix:
    """(3P, 3P) block-diagonal matrix of these blocks (P, 3, 3)."""
    index, size = np.arange(len(blocks) + 1), 3 * len(blocks)
    return sparse.bsr_matrix((blocks, index[:-1], index), shape=(size, size))


def at_their_minimum(
    points: sparse.csr_matrix, root: np.ndarray, weighted: np.ndarray, inverse: sparse.spmatrix
) -> np.ndarray:
    """(2O,) weighted residuals after each point was moved to its own minimum. (2O, 3P): columns of the points; (2O,)
    roots of the weights of the curvature; ``inverse`` (3P, 3P) of the points' own weighted normal matrices.

    An adjustment may stop while a point that few rays determine can still slide along them. Its residuals then depend
    on its own place and would be attributed to the cameras (a rendered boat: sigmas 19 times too large).
    """
    jp = (sparse.diags(root) @ points).tocsr()
    step = inverse @ (points.T @ weighted)
    return np.asarray(weighted - root * (jp @ step))


def reduced(
    jc: sparse.csr_matrix, crossed: sparse.csr_matrix, inverse: sparse.bsr_matrix, own: int
) -> sparse.csr_matrix:
    """Reduced camera system (C, C): Jc'Jc - Jc'Jp (Jp'Jp)^-1 Jp'Jc, from ``jc`` (2O, C), Jp'Jc (3P, C) and
    (Jp'Jp)^-1.

    The first ``own`` unknowns are those of frames, each involved in few points. The following ones, of lenses and
    mountings, are involved in most points: their products are computed dense, otherwise they take ten times as long
    as all others.
    """
    frames, shared = crossed[:, :own].tocsr(), crossed[:, own:].tocsr()
    blocks = frames.tobsr(blocksize=(3, 6))
    between = (blocks.T @ (inverse @ blocks)).tocsr()
    beside, among = np.zeros((own, shared.shape[1])), np.zeros((shared.shape[1], shared.shape[1]))
    for k in range(0, shared.shape[0], _ROWS):
        rows = slice(k, k + _ROWS)
        dense = shared[rows].toarray()
        # The part of these rows, whole blocks, of a matrix of ``by_blocks``
        taken = by_blocks(inverse.data[rows.start // 3 : rows.stop // 3]) @ dense
        beside += frames[rows].T @ taken
        among += dense.T @ taken
    eliminated = sparse.bmat([[between, sparse.csr_matrix(beside)], [beside.T, among]])
    return (jc.T @ jc - eliminated).tocsr()


class Normal:
    """A factorised normal matrix (C, C) and the motions of the whole model that it leaves undetermined.

    ``scale_known``: whether it determines the length of the whole (as a rig of fixed size does).
    """

    def __init__(self, matrix: sparse.spmatrix, layout: Layout) -> None:
        """``matrix``: sums of squared pixels by the unknowns of ``layout``. Raises ValueError if it is not finite."""
        if not np.isfinite(matrix.tocsr().data).all():
            raise ValueError("the normal equations are not finite")
        self._motions, self._extent = gauge(layout), extent(layout)
        own = np.arange(6 * len(layout.centres)).reshape(-1, 6)[:, :3].ravel()
        positions = self._motions[own]
        self._back = np.zeros_like(self._motions)  # (C, 7) rows that read the motions from the positions
        self._back[own] = positions @ np.linalg.pinv(positions.T @ positions)
        diagonal = matrix.diagonal()
        self._stiff = np.sqrt(np.maximum(diagonal, diagonal.max() * 1e-18))
        unit = sparse.diags(1 / self._stiff)
        scaled = (unit @ matrix @ unit).tocsc()  # unit diagonal: numbers of like size whatever the unit
        moved = np.linalg.qr(self._motions * self._stiff[:, None])[0]  # the scale is the last, orthogonal to the others
        self.scale_known = bool(moved[:, 6] @ (scaled @ moved[:, 6]) > _KNOWN)
        held = _anchors(layout, diagonal)
        basis = np.linalg.qr(moved[held, : 6 if self.scale_known else 7])[0]
        hold = sparse.csc_matrix((basis.ravel(), (np.repeat(held, basis.shape[1]), np.tile(
            np.arange(basis.shape[1]), len(held)))), shape=(layout.size, basis.shape[1]))  # fmt: skip
        whole = (scaled + hold @ hold.T + _RIDGE * sparse.identity(layout.size)).tocsc()
        self._factor = splu(
            whole, permc_spec="MMD_AT_PLUS_A", diag_pivot_thresh=0.0, options={"SymmetricMode": True}
        )  # positive definite: no pivoting

    def asked(self, functions: np.ndarray | sparse.spmatrix) -> np.ndarray:
        """(C, K) functions of the unknowns after the effect of a similarity of the whole was removed."""
        dense = np.asarray(functions, float) if isinstance(functions, np.ndarray) else functions.toarray()
        return np.asarray(dense - self._back @ (self._motions.T @ dense))

    def scale(self) -> np.ndarray:
        """(C, 1) function that gives the relative change of all lengths from the positions."""
        return np.asarray(self._back[:, 6:] / self._extent)

    def solve(self, sides: np.ndarray) -> np.ndarray:
        """(C, K) solutions for right-hand sides that are functions from ``asked``, or gradients."""
        out = np.empty(sides.shape)
        for k in range(0, sides.shape[1], _AT_ONCE):
            part = self._factor.solve(np.ascontiguousarray(sides[:, k : k + _AT_ONCE] / self._stiff[:, None]))
            out[:, k : k + _AT_ONCE] = part / self._stiff[:, None]
        return out


def gauge(layout: Layout) -> np.ndarray:
    """(C, 7) motions of the whole: shift, rotation, scale about the middle; rotation and scale times the size of the
    whole."""
    frames = len(layout.centres)
    local = layout.centres - layout.centres.mean(axis=0)
    size = extent(layout)
    at = np.arange(6 * frames).reshape(frames, 6)
    out = np.zeros((layout.size, 7))
    out[at[:, :3].ravel()] = np.concatenate(
        [np.tile(np.eye(3), (frames, 1)), -skew(local / size).reshape(-1, 3), (local / size).reshape(-1, 1)], axis=1
    )
    out[at[:, 3:].ravel(), 3:6] = np.tile(np.eye(3), (frames, 1)) / size
    for sensor, column in layout.sensor.items():
        out[column : column + 3, 6] = layout.sensor_centre[sensor] / size
    return out


def extent(layout: Layout) -> float:
    """Root mean square distance of the frames from their middle, model units."""
    return max(rms_length(layout.centres - layout.centres.mean(axis=0)), 1e-12)


def _anchors(layout: Layout, diagonal: np.ndarray) -> np.ndarray:
    """(18,) unknowns of three well-determined frames that are far from each other."""
    stiff = diagonal[: 6 * len(layout.centres)].reshape(-1, 6).min(axis=1)
    good = np.flatnonzero(stiff >= 0.1 * np.median(stiff))
    centres = layout.centres[good]
    chosen = [int(np.argmax(np.linalg.norm(centres - centres.mean(axis=0), axis=1)))]
    while len(chosen) < 3:
        away = np.min([np.linalg.norm(centres - centres[c], axis=1) for c in chosen], axis=0)
        chosen.append(int(np.argmax(away)))
    return (6 * good[chosen][:, None] + np.arange(6)).ravel()
