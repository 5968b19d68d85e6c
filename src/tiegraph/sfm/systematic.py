"""Correlated errors of many observations: lens errors beyond the camera model, and cameras that are not rigid in
their rig.

Both are random effects (variance components by maximum likelihood; Patterson and Thompson 1971). The residuals show
the part of an effect that the unknowns of the adjustment cannot absorb; from it follows the size of the effect, and
so the part that the unknowns absorbed and no residual shows. The noise of these residuals is that of whole points (as
in ``covariance``).
"""

from __future__ import annotations

import copy
from collections.abc import Collection, Mapping
from dataclasses import dataclass

import numpy as np
import pycolmap
from scipy import sparse
from scipy.linalg import block_diag

from tiegraph.scene.sorting import evenly
from tiegraph.sfm.adjustment.jacobians import Layout, System, by_shift, of_images, of_mounting, of_time
from tiegraph.sfm.adjustment.normal import Normal, at_their_minimum, by_blocks, point_inverse, reduced
from tiegraph.sfm.motion import Motion

_RIDGE = 1e-6  # of the information: directions that the unknowns absorb completely
_BINS = (12, 8)  # of an image, along its longer side and the other
_REACHES = (0.1, 0.2, 0.4, 0.8)  # of the image's diagonal: correlation lengths of a lens error
_TOLD_SIGMAS = 4.0  # bins that are off by more are listed
_MOST_SHOTS = 40  # whose image shifts are used, evenly over the pass
_LEAST_OBSERVATIONS = 10  # of an image whose shift is used
_SOME = 1000  # observations for the pixels that a movement causes


@dataclass(frozen=True)
class Effect:
    """A shared error: the effect of its coefficients on the gradient (C, K), and their second moment (K, K)."""

    gradient: np.ndarray
    moment: np.ndarray

    def covariance(self, solved: np.ndarray) -> np.ndarray:
        """(F, F) covariance of functions of the unknowns, from their solutions (C, F)."""
        moved = solved.T @ self.gradient
        return np.asarray(moved @ self.moment @ moved.T)


@dataclass(frozen=True)
class Score:
    """Score of K additional unknowns at zero (``EffectWeights.score``)."""

    gradient: np.ndarray  # (C, K) effect on the gradient of all points
    score: np.ndarray  # (K,)
    noise: np.ndarray  # (K, K) its covariance
    information: np.ndarray  # (K, K) on them, with the other unknowns eliminated

    def ridged(self) -> np.ndarray:
        """(K, K) invertible covariance of the score."""
        return self.noise + _RIDGE * np.diag(np.maximum(np.diag(self.information), 1e-12))

    def posterior(self, field: np.ndarray) -> tuple[np.ndarray, Effect]:
        """Posterior mean (K,) of coefficients with prior covariance ``field``, and their effect. The mean stays in its
        moment because the model is not corrected for it."""
        across = field @ self.information
        kept = np.linalg.solve(self.ridged() + self.information @ across, across.T).T
        mean = kept @ self.score
        return mean, Effect(self.gradient, np.asarray(field - kept @ across.T + np.outer(mean, mean)))


class EffectWeights:
    """The observations with their robust weights, and the factor of their normal equations."""

    def __init__(
        self, seen: System, weights: tuple[np.ndarray, np.ndarray], share: float, prior: sparse.spmatrix, layout: Layout
    ) -> None:
        """``weights`` (2O,) of the gradient and of the curvature; ``share``: share of the points that is in ``seen``;
        ``prior`` (C, C): prior information times the variance of a pixel."""
        self.seen, self.share, self.first = seen, share, weights[0]
        self._known = np.zeros(len(seen.residual))
        self._root = sparse.diags(np.sqrt(weights[1]))
        self._jc, self.jp = (self._root @ seen.cameras).tocsr(), (self._root @ seen.points).tocsr()
        self._inverse = by_blocks(point_inverse(self.jp))
        self.cross = (self._jc.T @ self.jp).tocsr()
        self._crossed = self.cross.T.tocsr()  # (3P, C)
        own = reduced(self._jc, self._crossed, self._inverse, 6 * len(layout.frame_ids))
        self.normal = Normal(own / share + prior, layout)
        self._pull = at_their_minimum(seen.points, np.sqrt(weights[1]), self.first * seen.residual, self._inverse)
        self._of_point = _gradients(seen.cameras, seen.points, self._pull)
        self._whole = np.asarray(self._of_point.sum(axis=0)).ravel()
        self.scatter = (self._of_point.T @ self._of_point).tocsr()  # (C, C)

    def without(self, known: np.ndarray) -> EffectWeights:
        """The same with the residuals reduced by this known part (2O,) of the errors of the observations."""
        own = self._root @ known
        by_point = self._inverse @ (self.jp.T @ own)
        moved = self.normal.solve((self._jc.T @ own - self.cross @ by_point)[:, None])[:, 0] / self.share
        points = by_point - self._inverse @ (self.cross.T @ moved)
        out = copy.copy(self)
        out._known = self._known + own - self._jc @ moved - self.jp @ points
        return out

    def score(self, columns: sparse.csr_matrix) -> Score:
        """Score of additional unknowns with these columns (2O, K), of the sampled points but for the gradient."""
        rows = np.flatnonzero(np.diff(columns.indptr))  # one camera or frame in a large model: a small part of all
        columns, jc, jp = columns[rows], self._jc[rows], self.jp[rows]
        own = (sparse.diags(self._root.diagonal()[rows]) @ columns).tocsr()
        by_point = (jp.T @ own).tocsr()
        taken = (self._inverse @ by_point).tocsr()
        gradient = (jc.T @ own).toarray() - _transposed_product(self._crossed, taken)
        solved = self.normal.solve(gradient)
        information = (own.T @ own - by_point.T @ taken).toarray() - gradient.T @ solved / self.share
        each = _gradients(columns, self.seen.points[rows], self._pull[rows])
        solved /= self.share
        mixed = _transposed_product(self._of_point, each).T @ solved
        noise = (each.T @ each).toarray() - mixed - mixed.T + solved.T @ (self.scatter @ solved)
        score = np.asarray(each.sum(axis=0)).ravel() - self._whole @ solved
        score -= own.T @ self._known[rows]
        return Score(gradient=gradient / self.share, score=score, noise=noise, information=information)


def _transposed_product(a: sparse.csr_matrix, b: sparse.csr_matrix) -> np.ndarray:
    """(C, K) product a'b of (R, C) and (R, K) where few rows of ``b`` are non-zero."""
    rows = np.flatnonzero(np.diff(b.indptr))
    return np.asarray((a[rows].T @ b[rows]).toarray())


def _gradients(jc: sparse.csr_matrix, jp: sparse.csr_matrix, weighted: np.ndarray) -> sparse.csr_matrix:
    """(P, C) gradient of each point's share of the cost from its weighted residuals (2O,), with its own three
    unknowns at their minimum."""
    number, count = jp.indices[jp.indptr[:-1]] // 3, len(weighted)  # each observation involves one point
    return (sparse.csr_matrix((weighted, (number, np.arange(count))), shape=(jp.shape[1] // 3, count)) @ jc).tocsr()


def _likeliest(score: np.ndarray, noise: np.ndarray, effect: np.ndarray) -> tuple[float, float]:
    """Gain in log likelihood over no effect, and size of the effect (K, K), for a score (K,) with this noise (K, K)."""
    root = np.linalg.cholesky(noise)
    half = np.linalg.solve(root, np.linalg.solve(root, effect).T)
    values, vectors = np.linalg.eigh((half + half.T) / 2)
    values, seen = np.maximum(values, 0), (vectors.T @ np.linalg.solve(root, score)) ** 2
    if values.max(initial=0.0) <= 0:
        return 0.0, 0.0
    tried = np.geomspace(1e-8, 1e4, 121) / values.max()  # times the size at which the effect equals the noise
    wider = 1 + tried[:, None] * values
    gain = 0.5 * np.sum(seen * (1 - 1 / wider) - np.log(wider), axis=1)
    most = int(np.argmax(gain))
    return (float(gain[most]), float(tried[most])) if gain[most] > 0 else (0.0, 0.0)


@dataclass(frozen=True)
class LensError:
    """The error of a lens beyond its model: its RMS ``rms_px``, correlation length, worst bins, and effect."""

    camera: int
    rms_px: float
    reach_px: float
    worst: tuple[tuple[float, ...], ...]  # rows x, y of the bin's middle, mean dx, dy of the residuals, sigmas


def lens_errors(
    model: pycolmap.Reconstruction, weighed: EffectWeights
) -> tuple[list[tuple[LensError, Effect]], np.ndarray]:
    """The shared error of each camera whose residuals show one over the image, and (2O,) the part of the residuals
    that it explains."""
    out, explained = [], np.zeros(2 * len(weighed.seen.image))
    for key in np.unique(weighed.seen.camera).tolist():
        found = _lens_error(model.camera(key), weighed)
        if found is not None:
            out.append(found[:2])
            explained += found[2]
    return out, explained


def _lens_error(camera: pycolmap.Camera, weighed: EffectWeights) -> tuple[LensError, Effect, np.ndarray] | None:
    number, middle, columns = _bins(camera, weighed.seen)
    told = weighed.score(columns)
    best: tuple[float, float, float] = (0.0, 0.0, 0.0)
    for reach in _REACHES:
        effect = told.information @ _field(camera, middle, reach) @ told.information
        best = max(best, (*_likeliest(told.score, told.ridged(), effect), reach))
    _, variance, reach = best
    if variance <= 0:
        return None
    rows = np.flatnonzero(weighed.seen.camera == camera.camera_id)
    weights = np.bincount(number, weighed.first[2 * rows], len(middle))
    sums, sigma = (v.reshape(-1, 2) for v in (told.score, np.sqrt(np.diag(told.ridged()))))
    times = np.linalg.norm(sums / sigma, axis=1)
    order = [k for k in np.argsort(-times) if times[k] > _TOLD_SIGMAS][:3]
    worst = tuple((*middle[k].tolist(), *(-sums[k] / weights[k]).tolist(), float(times[k])) for k in order)
    mean, effect = told.posterior(variance * _field(camera, middle, reach))
    reach *= float(np.hypot(camera.width, camera.height))
    found = LensError(camera=camera.camera_id, rms_px=float(np.sqrt(2 * variance)), reach_px=reach, worst=worst)
    return found, effect, columns @ mean


def _bins(camera: pycolmap.Camera, seen: System) -> tuple[np.ndarray, np.ndarray, sparse.csr_matrix]:
    """A grid over the images of a camera: the bin of each of its observations (N,), the centres (B, 2) of the bins, px,
    and the derivatives (2O, 2B) by a shift of each bin."""
    across, down = _BINS if camera.width >= camera.height else _BINS[::-1]
    size = np.array([camera.width / across, camera.height / down])
    rows = np.flatnonzero(seen.camera == camera.camera_id)
    cell = np.clip((seen.xy[rows] / size).astype(int), 0, [across - 1, down - 1])
    used, number = np.unique(cell[:, 1] * across + cell[:, 0], return_inverse=True)
    both = 2 * rows[:, None] + np.arange(2)
    columns = sparse.csr_matrix(
        (np.ones(both.size), (both.ravel(), (2 * number[:, None] + np.arange(2)).ravel())),
        shape=(2 * len(seen.xy), 2 * len(used)),
    )
    return number, (np.stack([used % across, used // across], axis=1) + 0.5) * size, columns


def _field(camera: pycolmap.Camera, middle: np.ndarray, reach: float) -> np.ndarray:
    """(2B, 2B) correlations of the shifts of bins; ``reach``: correlation length as a share of the image's diagonal."""
    apart = np.linalg.norm(middle[:, None] - middle[None], axis=2) / np.hypot(camera.width, camera.height)
    return np.kron(np.exp(-0.5 * (apart / reach) ** 2), np.eye(2))


@dataclass(frozen=True)
class AssumedErrors:
    """Shared errors assumed in planning: lens errors, px, as in ``LensError``, by camera id, and their correlation
    length as a share of the image's diagonal; and the ratio of sigmas with correlated errors within a point to those
    with independent errors."""

    lens_px: Mapping[int, float]
    reach: float
    tracks: float = 1.0

    def effects(self, model: pycolmap.Reconstruction, weighed: EffectWeights) -> list[Effect]:
        """The effects of the lens errors."""
        out = []
        for key in np.unique(weighed.seen.camera).tolist():
            _, middle, columns = _bins(model.camera(key), weighed.seen)
            field = self.lens_px[key] ** 2 / 2 * _field(model.camera(key), middle, self.reach)
            out.append(Effect(weighed.score(columns).gradient, field))
        return out


def misplaced(
    model: pycolmap.Reconstruction,
    weighed: EffectWeights,
    held: Collection[int],
    off: Mapping[int, np.ndarray],
) -> tuple[list[Effect], np.ndarray]:
    """The deviations of the cameras of rigs (ids) held in the adjustment, as far as the images show them; (2O,) the
    part of the residuals that they explain.

    ``off``: rig id -> (6S, 6S) mean products of place (model units) and rotation of its S cameras beside the
    reference, where they are known from elsewhere."""
    out, explained = [], np.zeros(2 * len(weighed.seen.image))
    for rig_id in sorted(set(held) & set(model.rigs)):
        every = sorted(s.id for s, pose in model.rig(rig_id).non_ref_sensors.items() if pose is not None)
        cameras = [c for c in every if (weighed.seen.camera == c).any()]
        if not cameras:
            continue
        columns = sparse.hstack([of_mounting(model, weighed.seen, c) for c in cameras]).tocsr()
        told = weighed.score(columns)
        if rig_id in off:
            at = (6 * np.searchsorted(every, cameras)[:, None] + np.arange(6)).ravel()
            out.append(Effect(told.gradient, off[rig_id][np.ix_(at, at)]))
        else:
            place, turn, _ = two_sizes(told.score[None], told.ridged()[None], told.information[None])
            if place + turn > 0:
                mean, effect = told.posterior(np.diag(np.tile(np.repeat([place, turn], 3), len(cameras))))
                out.append(effect)
                explained += columns @ mean
    return out, explained


def unrest(model: pycolmap.Reconstruction, weighed: EffectWeights) -> list[Effect]:
    """Movement of cameras in the rig from shot to shot, where the observations show any.

    All cameras are treated alike, including the reference; the part that the pose of a frame absorbs is accounted
    for.
    """
    return _shaken(weighed, [own for own in _by_frame(model, weighed.seen) if len(own) > 1])


def passing(model: pycolmap.Reconstruction, weighed: EffectWeights) -> list[Effect]:
    """Movements of the scene from shot to shot that only the shorter tracks follow, which have half of the
    observations, where there are any.

    What passes a camera, such as cars while it stands, fits a movement of the camera, and no residual shows it. But few
    images see it, and many what stands.
    """
    number = weighed.seen.points.indices[weighed.seen.points.indptr[:-1:2]] // 3
    length = np.bincount(number)[number]
    parts = [length <= most for most in np.unique(length)[:-1].tolist()]
    short = min(parts, key=lambda own: abs(own.mean() - 0.5), default=np.zeros(len(length), bool))
    return _shaken(weighed, _by_frame(model, weighed.seen, short))


def _shaken(weighed: EffectWeights, groups: list[list[np.ndarray]]) -> list[Effect]:
    """The effect of the movements that the observations of images show, in groups that are judged together."""
    if not groups:
        return []
    (place, turn, gain), told = _straying(weighed, groups)
    if gain <= 0:
        return []
    found = [one.posterior(np.diag(np.tile(np.repeat([place, turn], 3), len(one.score) // 6))) for one in told]
    mean = np.concatenate([mean for mean, _ in found])
    alone = block_diag(*(effect.moment - np.outer(mean, mean) for mean, effect in found))
    moment = (alone + np.outer(mean, mean)) * len(groups) / len(told)
    return [Effect(np.hstack([one.gradient for one in told]), moment)]


@dataclass(frozen=True)
class Stray:
    """Movement of a camera in the rig from shot to shot, sigmas of a coordinate: model units, rad, and pixels in its
    images; ``gain`` in log likelihood over no movement."""

    place: float
    turn: float
    px: float
    gain: float


def strays_of(model: pycolmap.Reconstruction, weighed: EffectWeights, cameras: Collection[int]) -> dict[int, Stray]:
    """The movement of some cameras (ids), each as if the others were rigid."""
    frames, out = _by_frame(model, weighed.seen), {}
    for camera in cameras:
        own = [[rows] for shot in frames for rows in shot if weighed.seen.camera[rows[0]] == camera]
        if own:
            (place, turn, gain), _ = _straying(weighed, own)
            rows = np.flatnonzero(weighed.seen.camera == camera)
            moved = by_shift(weighed.seen, rows[:: max(1, len(rows) // _SOME)]) ** 2 @ np.repeat([place, turn], 3)
            out[camera] = Stray(
                place=float(place**0.5), turn=float(turn**0.5), px=float(np.sqrt(np.median(moved))), gain=float(gain)
            )
    return out


def _by_frame(model: pycolmap.Reconstruction, seen: System, some: np.ndarray | None = None) -> list[list[np.ndarray]]:
    """The observations (R,) of each image that has enough of them, grouped by frame; of ``some`` (O,) bool only."""
    rows = np.arange(len(seen.image)) if some is None else np.flatnonzero(some)
    rows = rows[np.argsort(seen.image[rows], kind="stable")]
    of_frame: dict[int, list[np.ndarray]] = {}
    for own in np.split(rows, np.flatnonzero(np.diff(seen.image[rows])) + 1):
        if len(own) >= _LEAST_OBSERVATIONS:
            of_frame.setdefault(model.image(int(seen.image[own[0]])).frame_id, []).append(own)
    return [own for _, own in sorted(of_frame.items())]


def _straying(weighed: EffectWeights, groups: list[list[np.ndarray]]) -> tuple[tuple[float, float, float], list[Score]]:
    """For the observations of images, in groups that are judged together: variances of a coordinate of place and
    rotation, and the gain in log likelihood over none; the scores of the groups, or of some of them."""
    told = [weighed.score(of_images(weighed.seen, groups[k])) for k in evenly(len(groups), _MOST_SHOTS)]
    size = max(len(one.score) for one in told)
    score, noise = np.zeros((len(told), size)), np.tile(np.eye(size), (len(told), 1, 1))
    information = np.zeros(noise.shape)
    for k, one in enumerate(told):
        part = slice(0, len(one.score))
        score[k, part], noise[k, part, part], information[k, part, part] = one.score, one.ridged(), one.information
    return two_sizes(score, noise, information), told


def untimed(weighed: EffectWeights, motion: Motion, late_s: Mapping[int, float]) -> list[Effect]:
    """The effect of the unknown firing times of cameras (ids), with prior sigmas ``late_s``, s."""
    if not late_s:
        return []
    columns = [of_time(weighed.seen, motion, np.flatnonzero(weighed.seen.camera == k)) for k in sorted(late_s)]
    told = weighed.score(sparse.hstack(columns).tocsr())
    return [told.posterior(np.diag([late_s[k] ** 2 for k in sorted(late_s)]))[1]]


def two_sizes(score: np.ndarray, noise: np.ndarray, information: np.ndarray) -> tuple[float, float, float]:
    """Maximum likelihood variances of place and rotation, three numbers each in turn, for scores (G, K) with this
    noise and information (G, K, K): the best of a coarse grid, then of a finer one around it; and the gain in log
    likelihood."""
    is_place = np.arange(score.shape[1]) % 6 < 3
    parts = [information[:, :, own] @ information[:, own] for own in (is_place, ~is_place)]
    own, *each = (np.trace(v, axis1=1, axis2=2) for v in (noise, *parts))
    sizes = [float(np.median(own / np.maximum(part, 1e-300))) for part in each]

    def best(places: np.ndarray, turns: np.ndarray) -> tuple[float, float, float]:
        pairs = [(p, t) for p in places.tolist() for t in turns.tolist()]
        tried = ((p, t, _log_likelihood(score, noise + p * parts[0] + t * parts[1])) for p, t in pairs)
        return max(tried, key=lambda one: one[2])

    coarse, finer = np.append(0.0, np.geomspace(1e-3, 1e4, 15)), np.geomspace(0.4, 2.5, 5)  # times its noise
    place, turn, _ = best(*(size * coarse for size in sizes))
    place, turn, likely = best(place * finer, turn * finer)
    return place, turn, likely - _log_likelihood(score, noise)


def _log_likelihood(score: np.ndarray, covariance: np.ndarray) -> float:
    solved = np.linalg.solve(covariance, score[:, :, None])[:, :, 0]
    return float(-0.5 * np.sum(score * solved) - 0.5 * np.sum(np.linalg.slogdet(covariance)[1]))
