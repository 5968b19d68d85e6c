"""Errors that many observations share: of a lens unlike its model, and of cameras that do not stay put in their rig.

Both are random effects (variance components by maximum likelihood; Patterson and Thompson 1971): what the unknowns of
the adjustment cannot take up of an effect shows in the residuals, tells how large it is, and by that how much of it the
unknowns have taken up, which no residual shows. The noise of what shows is that of whole points (as in ``covariance``).
"""

from __future__ import annotations

import copy
from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
import pycolmap
from scipy import sparse

from tiegraph.geometry.transforms import skew
from tiegraph.scene.sampling import evenly
from tiegraph.sfm.adjustment.jacobians import Layout, System, frame_pose
from tiegraph.sfm.adjustment.normal import Normal, at_their_minimum, by_blocks, point_inverse
from tiegraph.sfm.tuning import SharedErrorTuning

_RIDGE = 1e-6  # of the information: directions that the unknowns take up whole


@dataclass(frozen=True)
class Effect:
    """A shared error: what its coefficients do to the gradient (C, K), and their second moment (K, K)."""

    gradient: np.ndarray
    moment: np.ndarray

    def covariance(self, solved: np.ndarray) -> np.ndarray:
        """(F, F) of functions of the unknowns, by their solutions (C, F)."""
        moved = solved.T @ self.gradient
        return np.asarray(moved @ self.moment @ moved.T)


@dataclass(frozen=True)
class Score:
    """What the observations say of K more unknowns at zero (``EffectWeights.score``)."""

    gradient: np.ndarray  # (C, K) effect on the gradient of all points
    score: np.ndarray  # (K,)
    noise: np.ndarray  # (K, K) its covariance
    information: np.ndarray  # (K, K) that the other unknowns leave of them


class EffectWeights:
    """The observations with their robust weights, and the factor of their normal equations."""

    def __init__(
        self, seen: System, weights: tuple[np.ndarray, np.ndarray], share: float, prior: sparse.spmatrix, layout: Layout
    ) -> None:
        """``weights`` (2O,) of the gradient and of the curvature; ``share``: of the points that are in ``seen``;
        ``prior`` (C, C): information beside the observations, times the variance of a pixel."""
        self.seen, self.share, self._first = seen, share, weights[0]
        self._known = np.zeros(len(seen.residual))
        self._root = sparse.diags(np.sqrt(weights[1]))
        self._jc, self.jp = (self._root @ seen.cameras).tocsr(), (self._root @ seen.points).tocsr()
        self._inverse = by_blocks(point_inverse(self.jp))
        self.cross = (self._jc.T @ self.jp).tocsr()
        own = self._jc.T @ self._jc - self.cross @ self._inverse @ self.cross.T
        self.normal = Normal(own / share + prior, layout)
        self._pull = at_their_minimum(seen.points, np.sqrt(weights[1]), self._first * seen.residual, self._inverse)
        self._of_point = gradients(seen.cameras, seen.points, self._pull)
        self._whole = np.asarray(self._of_point.sum(axis=0)).ravel()
        self.scatter = (self._of_point.T @ self._of_point).tocsr()  # (C, C)

    def without(self, known: np.ndarray) -> EffectWeights:
        """The same with what this part (2O,) of the observations' errors leaves in the residuals taken away."""
        own = self._root @ known
        by_point = self._inverse @ (self.jp.T @ own)
        moved = self.normal.solve((self._jc.T @ own - self.cross @ by_point)[:, None])[:, 0] / self.share
        points = by_point - self._inverse @ (self.cross.T @ moved)
        out = copy.copy(self)
        out._known = self._known + own - self._jc @ moved - self.jp @ points
        return out

    def weight(self, observations: np.ndarray) -> np.ndarray:
        """Weights of these observations in the gradient."""
        return np.asarray(self._first[2 * observations])

    def score(self, columns: sparse.csr_matrix) -> Score:
        """Of more unknowns with these columns (2O, K), at zero: effect on the gradient (C, K) of all points; and of the
        points looked at, score (K,), its covariance (K, K), and the information (K, K) that the others leave of them.
        """
        rows = np.flatnonzero(np.diff(columns.indptr))  # one camera or frame in a large model: a small part of all
        columns, jc, jp = columns[rows], self._jc[rows], self.jp[rows]
        own = (sparse.diags(self._root.diagonal()[rows]) @ columns).tocsr()
        by_point = (jp.T @ own).tocsr()
        taken = (self._inverse @ by_point).tocsr()
        gradient = (jc.T @ own - self.cross @ taken).toarray()
        solved = self.normal.solve(gradient)
        information = (own.T @ own - by_point.T @ taken).toarray() - gradient.T @ solved / self.share
        each = gradients(columns, self.seen.points[rows], self._pull[rows])
        solved /= self.share
        mixed = np.asarray(each.T @ self._of_point @ solved)
        noise = (each.T @ each).toarray() - mixed - mixed.T + solved.T @ (self.scatter @ solved)
        score = np.asarray(each.sum(axis=0)).ravel() - self._whole @ solved
        score -= own.T @ self._known[rows]
        return Score(gradient=gradient / self.share, score=score, noise=noise, information=information)


def gradients(jc: sparse.csr_matrix, jp: sparse.csr_matrix, weighted: np.ndarray) -> sparse.csr_matrix:
    """(P, C) gradient of each point's share of the cost by its weighted residuals (2O,), its own three unknowns at
    their minimum."""
    number = jp.indices[jp.indptr[:-1]] // 3  # an observation touches one point
    rows = np.arange(len(weighted))
    gather = sparse.csr_matrix((weighted, (number, rows)), shape=(jp.shape[1] // 3, len(weighted)))
    return (gather @ jc).tocsr()


# ------------------------------------------------------------------------------------------------------------- lenses


@dataclass(frozen=True)
class LensError:
    """What a lens does unlike its model: ``rms_px`` of it, how far it reaches, its worst bins, and its effect."""

    camera: int
    rms_px: float
    reach_px: float
    worst: tuple[tuple[float, ...], ...]  # rows x, y of the bin's middle, mean dx, dy of what is left, sigmas


def lens_errors(
    model: pycolmap.Reconstruction, weighed: EffectWeights, tuning: SharedErrorTuning
) -> tuple[list[tuple[LensError, Effect]], np.ndarray]:
    """The shared error of each camera that the observations show, by its residuals over the image; (2O,) what of the
    residuals it explains."""
    out, explained = [], np.zeros(2 * len(weighed.seen.image))
    for key in np.unique(weighed.seen.camera).tolist():
        found = _lens_error(model.camera(key), weighed, tuning)
        if found is not None:
            out.append(found[:2])
            explained += found[2]
    return out, explained


def _lens_error(
    camera: pycolmap.Camera, weighed: EffectWeights, tuning: SharedErrorTuning
) -> tuple[LensError, Effect, np.ndarray] | None:
    bins = _bins(camera, weighed.seen, tuning)
    middle, told = bins.middle, weighed.score(bins.columns)
    gradient, score, noise, information = told.gradient, told.score, told.noise, told.information
    noise = noise + _RIDGE * np.diag(np.maximum(np.diag(information), 1e-12))
    best: tuple[float, float, float] = (0.0, 0.0, 0.0)
    for reach in tuning.reaches:
        field = _field(camera, middle, reach)
        gain, variance = likeliest(score, noise, information @ field @ information, tuning)
        best = max(best, (gain, variance, reach))
    _, variance, reach = best
    weights = np.bincount(bins.number, weighed.weight(bins.rows), len(middle))
    sums, sigma = (v.reshape(-1, 2) for v in (score, np.sqrt(np.diag(noise))))
    times = np.linalg.norm(sums / sigma, axis=1)
    order = [k for k in np.argsort(-times) if times[k] > tuning.told_sigmas][:3]
    worst = tuple((*middle[k].tolist(), *(-sums[k] / weights[k]).tolist(), float(times[k])) for k in order)
    if variance <= 0:
        return None
    field = variance * _field(camera, middle, reach)
    mean, moment = posterior(score, noise, information, field)
    reach *= float(np.hypot(camera.width, camera.height))
    found = LensError(camera=camera.camera_id, rms_px=float(np.sqrt(2 * variance)), reach_px=reach, worst=worst)
    return found, Effect(gradient, moment), bins.columns @ mean


@dataclass(frozen=True)
class _Bins:
    """Parts of the images of a camera: its observations (N,), the part that each is in (N,), the middles (B, 2) of the
    parts, px, and the derivatives (2O, 2B) by a shift of each."""

    rows: np.ndarray
    number: np.ndarray
    middle: np.ndarray
    columns: sparse.csr_matrix


def _bins(camera: pycolmap.Camera, seen: System, tuning: SharedErrorTuning) -> _Bins:
    across, down = tuning.bins if camera.width >= camera.height else tuning.bins[::-1]
    size = np.array([camera.width / across, camera.height / down])
    rows = np.flatnonzero(seen.camera == camera.camera_id)
    cell = np.clip((seen.xy[rows] / size).astype(int), 0, [across - 1, down - 1])
    used, number = np.unique(cell[:, 1] * across + cell[:, 0], return_inverse=True)
    both = 2 * rows[:, None] + np.arange(2)
    columns = sparse.csr_matrix(
        (np.ones(both.size), (both.ravel(), (2 * number[:, None] + np.arange(2)).ravel())),
        shape=(2 * len(seen.xy), 2 * len(used)),
    )
    middle = (np.stack([used % across, used // across], axis=1) + 0.5) * size
    return _Bins(rows=rows, number=number, middle=middle, columns=columns)


def _field(camera: pycolmap.Camera, middle: np.ndarray, reach: float) -> np.ndarray:
    """(2B, 2B) correlations of the shifts of bins; ``reach`` in parts of the image's diagonal."""
    apart = np.linalg.norm(middle[:, None] - middle[None], axis=2) / np.hypot(camera.width, camera.height)
    return np.kron(np.exp(-0.5 * (apart / reach) ** 2), np.eye(2))


@dataclass(frozen=True)
class AssumedErrors:
    """Shared errors that a network is planned with: of lenses, px, as in ``LensError``, by camera id, and how far they
    reach in parts of the image's diagonal; sigmas by the errors that the observations of a point share over those by
    independent ones."""

    lens_px: Mapping[int, float]
    reach: float
    tracks: float = 1.0

    def effects(
        self, model: pycolmap.Reconstruction, weighed: EffectWeights, tuning: SharedErrorTuning
    ) -> list[Effect]:
        """What the lenses do."""
        out = []
        for key in np.unique(weighed.seen.camera).tolist():
            bins = _bins(model.camera(key), weighed.seen, tuning)
            field = self.lens_px[key] ** 2 / 2 * _field(model.camera(key), bins.middle, self.reach)
            out.append(Effect(weighed.score(bins.columns).gradient, field))
        return out


def likeliest(
    score: np.ndarray, noise: np.ndarray, effect: np.ndarray, tuning: SharedErrorTuning
) -> tuple[float, float]:
    """Gain in log likelihood over none, and size, of the effect (K, K) in a score (K,) with this noise (K, K)."""
    root = np.linalg.cholesky(noise)
    half = np.linalg.solve(root, np.linalg.solve(root, effect).T)
    values, vectors = np.linalg.eigh((half + half.T) / 2)
    values, seen = np.maximum(values, 0), (vectors.T @ np.linalg.solve(root, score)) ** 2
    if values.max(initial=0.0) <= 0:
        return 0.0, 0.0
    tried = np.geomspace(*tuning.tried_effects) / values.max()
    wider = 1 + tried[:, None] * values
    gain = 0.5 * np.sum(seen * (1 - 1 / wider) - np.log(wider), axis=1)
    most = int(np.argmax(gain))
    return (float(gain[most]), float(tried[most])) if gain[most] > 0 else (0.0, 0.0)


def posterior(
    score: np.ndarray, noise: np.ndarray, information: np.ndarray, field: np.ndarray
) -> tuple[np.ndarray, np.ndarray]:
    """Mean (K,) and second moment (K, K) of coefficients with covariance ``field`` once their score is seen: what is
    known of them stays in the moment, for the model is not corrected for it."""
    across = field @ information
    kept = np.linalg.solve(noise + information @ across, across.T).T
    mean = kept @ score
    return mean, np.asarray(field - kept @ across.T + np.outer(mean, mean))


# ---------------------------------------------------------------------------------------------- cameras in their rig


@dataclass(frozen=True)
class Unrest:
    """How far cameras (ids) are off their places in the rig: sigma of an axis, from shot to shot, or for all shots."""

    cameras: tuple[int, ...]
    place: float  # model units
    turn: float  # rad
    always: bool = False


def misplaced(
    model: pycolmap.Reconstruction,
    weighed: EffectWeights,
    held: Collection[int],
    off: Mapping[int, np.ndarray],
    tuning: SharedErrorTuning,
) -> tuple[list[tuple[Unrest, Effect]], np.ndarray]:
    """How far the cameras of rigs (ids) that the adjustment held are off their places, as far as the images show it;
    (2O,) what of the residuals it explains.

    ``off``: rig id -> (6S, 6S) mean products of place (model units) and turn of its S cameras beside the reference,
    where that is known otherwise."""
    out, explained = [], np.zeros(2 * len(weighed.seen.image))
    for rig_id in sorted(set(held) & set(model.rigs)):
        every = sorted(s.id for s, pose in model.rig(rig_id).non_ref_sensors.items() if pose is not None)
        cameras = [c for c in every if (weighed.seen.camera == c).any()]
        if not cameras:
            continue
        columns = sparse.hstack([_of_mounting(model, weighed.seen, c) for c in cameras]).tocsr()
        told = weighed.score(columns)
        gradient, score, noise, information = told.gradient, told.score, told.noise, told.information
        if rig_id in off:
            at = (6 * np.searchsorted(every, cameras)[:, None] + np.arange(6)).ravel()
            moment = off[rig_id][np.ix_(at, at)]
            place, turn = np.diag(moment).reshape(-1, 2, 3).mean(axis=(0, 2))
            found = Unrest(cameras=tuple(cameras), place=float(np.sqrt(place)), turn=float(np.sqrt(turn)), always=True)
            out.append((found, Effect(gradient, moment)))
            continue
        noise = noise + _RIDGE * np.diag(np.maximum(np.diag(information), 1e-300))
        place, turn = two_sizes(score[None], noise[None], information[None], tuning)
        if place + turn <= 0:
            continue
        field = np.diag(np.tile(np.repeat([place, turn], 3), len(cameras)))
        mean, moment = posterior(score, noise, information, field)
        explained += columns @ mean
        found = Unrest(cameras=tuple(cameras), place=float(np.sqrt(place)), turn=float(np.sqrt(turn)), always=True)
        out.append((found, Effect(gradient, moment)))
    return out, explained


def unrest(
    model: pycolmap.Reconstruction, weighed: EffectWeights, tuning: SharedErrorTuning
) -> list[tuple[Unrest, Effect]]:
    """How far cameras stray from their places in the rig from shot to shot, where the observations show any.

    All cameras alike, the reference too; what the pose of a frame takes up of its images' shifts is counted in.
    """
    images, counts = np.unique(weighed.seen.image, return_counts=True)
    of_frame: dict[int, list[int]] = {}
    for image, count in zip(images.tolist(), counts.tolist()):
        if count >= tuning.least_observations:
            of_frame.setdefault(model.image(image).frame_id, []).append(image)
    shared = [own for _, own in sorted(of_frame.items()) if len(own) > 1]
    if not shared:
        return []
    chosen = [shared[k] for k in evenly(len(shared), tuning.most_shots)]
    size = 6 * max(len(own) for own in chosen)
    gradient, score = [], np.zeros((len(chosen), size))
    noise, information = np.tile(np.eye(size), (len(chosen), 1, 1)), np.zeros((len(chosen), size, size))
    for k, own in enumerate(chosen):
        part = slice(0, 6 * len(own))
        told = weighed.score(_of_images(weighed.seen, own))
        score[k, part], noise[k, part, part], information[k, part, part] = told.score, told.noise, told.information
        gradient.append(told.gradient)
    least = np.maximum(np.diagonal(information, axis1=1, axis2=2), 1e-300)
    place, turn = two_sizes(score, noise + _RIDGE * least[:, :, None] * np.eye(size), information, tuning)
    if place + turn <= 0:
        return []
    moved = np.hstack(gradient)
    moment = np.tile(np.repeat([place, turn], 3), moved.shape[1] // 6) * len(shared) / len(chosen)
    cameras = sorted({model.image(i).camera_id for own in shared for i in own})
    found = Unrest(tuple(cameras), float(np.sqrt(place)), float(np.sqrt(turn)))
    return [(found, Effect(moved * np.sqrt(moment), np.eye(len(moment))))]


def _of_images(seen: System, images: list[int]) -> sparse.csr_matrix:
    """(2O, 6K) derivatives by the shift of the centre and the turn of each of these images alone."""
    rows = np.flatnonzero(np.isin(seen.image, images))
    return _columns(seen, rows, _by_shift(seen, rows), 6 * np.searchsorted(images, seen.image[rows]), 6 * len(images))


def _of_mounting(model: pycolmap.Reconstruction, seen: System, camera: int) -> sparse.csr_matrix:
    """(2O, 6) derivatives by the shift and the turn, along the axes of the rig, of a camera in it."""
    rows = np.flatnonzero(seen.camera == camera)
    images, number = np.unique(seen.image[rows], return_inverse=True)
    frames = [model.frame(model.image(i).frame_id) for i in images.tolist()]
    axes = np.stack([frame_pose(f).rotation.matrix().T for f in frames])[number]
    by_shift = _by_shift(seen, rows)
    values = np.concatenate([by_shift[:, :, :3] @ axes, by_shift[:, :, 3:] @ axes], axis=2)
    return _columns(seen, rows, values, np.zeros(len(rows), int), 6)


def _by_shift(seen: System, rows: np.ndarray) -> np.ndarray:
    """(R, 2, 6) derivatives of observations by the shift of the image's centre and its turn, axes of the model."""
    by_point = seen.by_point[rows]
    return np.concatenate([-by_point, by_point @ skew(seen.lever[rows])], axis=2)


def _columns(seen: System, rows: np.ndarray, values: np.ndarray, first: np.ndarray, width: int) -> sparse.csr_matrix:
    """(2O, width) with the values (R, 2, 6) of some observations in six columns from ``first`` (R,)."""
    row = np.repeat((2 * rows[:, None] + np.arange(2)).ravel(), 6)
    column = np.repeat(first[:, None] + np.arange(6), 2, axis=0).ravel()
    return sparse.csr_matrix((values.ravel(), (row, column)), shape=(2 * len(seen.image), width))


def two_sizes(
    score: np.ndarray, noise: np.ndarray, information: np.ndarray, tuning: SharedErrorTuning
) -> tuple[float, float]:
    """Variances of place and turn, three numbers each in turn, that make scores (G, K) with this noise and information
    (G, K, K) likeliest: the best of a coarse grid, then of a finer one about it."""
    is_place = np.arange(score.shape[1]) % 6 < 3
    parts = [information[:, :, own] @ information[:, own] for own in (is_place, ~is_place)]
    sizes = [float(np.median(_trace(noise) / np.maximum(_trace(part), 1e-300))) for part in parts]

    def best(places: np.ndarray, turns: np.ndarray) -> tuple[float, float]:
        pairs = [(p, t) for p in places.tolist() for t in turns.tolist()]
        return max(pairs, key=lambda pair: _log_likelihood(score, noise + pair[0] * parts[0] + pair[1] * parts[1]))

    coarse, finer = np.append(0.0, np.geomspace(*tuning.tried_shifts)), np.geomspace(*tuning.finer_shifts)
    place, turn = best(*(size * coarse for size in sizes))
    return best(place * finer, turn * finer)


def _trace(matrices: np.ndarray) -> np.ndarray:
    return np.asarray(np.trace(matrices, axis1=1, axis2=2))


def _log_likelihood(score: np.ndarray, covariance: np.ndarray) -> float:
    solved = np.linalg.solve(covariance, score[:, :, None])[:, :, 0]
    return float(-0.5 * np.sum(score * solved) - 0.5 * np.sum(np.linalg.slogdet(covariance)[1]))
