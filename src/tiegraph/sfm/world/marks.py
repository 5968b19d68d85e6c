"""Marked points in the model: the intersections of their rays, their accuracy, and residuals in the images and the
world."""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from typing import Any

import numpy as np
import pycolmap
import scipy
from scipy.special import chdtrc, comb

from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import LEAST_PLACES, Similarity, umeyama
from tiegraph.scene.colmapmodel import matrix
from tiegraph.scene.control import Control, Marks
from tiegraph.scene.evidence import CHANCE, LIMIT, fits_better
from tiegraph.scene.rig import AS_IS, Copy, file_camera, on_plane, prepared_pixel, within
from tiegraph.scene.scene import Scene
from tiegraph.sfm.tuning.world import MarkTuning

_SMALLEST, _STEP = 0.1, 0.01  # sizes of image copies that are tried: smallest, and step
_UNSURE = (
    "all marks are in the upper left quarter of their images, and the rays of these parallel views do not show "
    "whether the marks were made in images of half the size: check this, because heights depend on it"
)
_CE90, _LE90 = 2.146, 1.645  # 90 % of a two-dimensional and of a one-dimensional normal error, in sigmas


@dataclass(frozen=True)
class Target:
    """A marked point in a model: its place (3,), formal covariance (3, 3), model units; rows of its marks; residuals
    (M, 2) pixels, model minus mark; why it cannot be used, "" if it can; ``blunder``: it contradicts the others;
    ``chance``: upper bound of the probability that as many randomly placed marks would intersect as well."""

    place: np.ndarray
    covariance: np.ndarray
    marks: np.ndarray
    residual_px: np.ndarray
    why_not: str = ""
    blunder: bool = False
    chance: float = 1.0


def by_chance(found: Sequence[Target]) -> float:
    """The probability that randomly placed marks would fit as well as those of these points (Fisher's method); 0 if
    the points are too few to place a model."""
    told = [t.chance for t in found if len(t.marks) > 1]
    enough = len(told) >= LEAST_PLACES
    return float(chdtrc(2 * len(told), -2 * np.log(np.maximum(told, 1e-300)).sum())) if enough else 0.0


def targets(model: pycolmap.Reconstruction, scene: Scene, marks: Marks, count: int, tuning: MarkTuning) -> list[Target]:
    """The ``count`` points of some marks in the model, in their order.

    A mark farther than 20 px from where the others put the point is left out if two or more remain. The point is left
    out too if more than a third of its marks are, and the rest may intersect by chance.
    """
    seen = _rays(_views(model, scene, marks), marks, range(count), tuning)
    return [_target(rays, rows, tuning) for rays, rows in seen]


def _views(model: pycolmap.Reconstruction, scene: Scene, marks: Marks) -> dict[int, tuple[np.ndarray, Any]]:
    """Poses (4, 4) and cameras of the images with marks that are in the model, by scene index."""
    images = {k: model.find_image_with_name(scene.names[k]) for k in np.unique(marks.image).tolist()}
    return {k: (matrix(i.cam_from_world()), i.camera) for k, i in images.items() if i is not None and i.has_pose}


def _rays(
    views: Mapping[int, tuple[np.ndarray, Any]], marks: Marks, points: Sequence[int], tuning: MarkTuning
) -> Iterator[tuple[list[_Ray], np.ndarray]]:
    """For one point after another, the rays of its marks in images with poses, and the rows of these marks."""
    sigma = np.hypot(marks.sigma_px, tuning.pose_sigma_px)
    sigma = np.where(np.isfinite(sigma), sigma, tuning.mark_sigma_px)
    for point in points:
        rows = np.array([r for r in np.flatnonzero(marks.point == point) if marks.image[r] in views], int)
        yield [_Ray(*views[marks.image[r]], xy=marks.xy_px[r], sigma_px=float(sigma[r])) for r in rows], rows


def copy_of(model: pycolmap.Reconstruction, scene: Scene, marks: Marks, tuning: MarkTuning) -> tuple[Copy, str]:
    """The copy of the images in which a file's marks were made, with a note if that is not the survey's images.

    The rays decide: another copy is used if they intersect in it better than chance allows (``fits_better``) compared
    with all dissimilar copies. Errors are measured in pixels of the copy, because in a flight with parallel views
    rays meet at any size, only closer in larger copies.
    """
    if marks.file_px is None or marks.orientation is None:
        return AS_IS, ""
    own = marks.where(np.flatnonzero(np.isfinite(marks.file_px).all(axis=1)))
    outside = len(own) - len(as_copy(own, scene, AS_IS, tuning))
    said = (
        f"{outside} marks are outside their images and are left out: in no reduced or turned copy of the images do "
        "their rays meet"
    )
    often = np.argsort(-np.bincount(own.point), kind="stable")[:20]  # number of points with most marks that are used
    own, views = own.where(np.isin(own.point, often)), _views(model, scene, own)
    well_px = LIMIT * tuning.mark_sigma_px  # marks with smaller errors were made in these images
    if _miss_px(views, scene, own, AS_IS, tuning) <= well_px:
        unsure = _miss_px(views, scene, own, Copy(0.5), tuning) <= well_px
        return AS_IS, _UNSURE if unsure else said if outside else ""
    cameras = [c for k in np.unique(own.image) if (c := file_camera(scene.sensor_of(int(k)))) is not None]
    side = min((max(c.width, c.height) for c in cameras), default=1)
    most = 2 * float(np.nanmax(marks.file_px)) / side if outside else 1.0  # marks reach the middle of their images
    sizes = np.exp(np.arange(np.log(_SMALLEST), np.log(most) + _STEP / 2, _STEP))
    turned = (False, True) if np.any(own.orientation != 1) else (False,)
    tried = [AS_IS, *(c for t in turned for s in sizes if not (c := Copy(float(s), t)).like(AS_IS))]
    miss_px = np.array([_miss_px(views, scene, own, copy, tuning) for copy in tried])
    best = tried[int(np.argmin(miss_px))]
    others = miss_px[[not c.like(best) for c in tried]]
    free = min(2 * len(own) - 3 * len(np.unique(own.point)) - 1, tuning.free_for_copy)
    if best == AS_IS or not fits_better(others.min(), miss_px.min(), free):
        return AS_IS, said if outside else ""
    near = [replace(best, size=float(best.size * f)) for f in np.linspace(1 - _STEP, 1 + _STEP, 41)]
    fine_px = [_miss_px(views, scene, own, copy, tuning) for copy in near]
    found = near[int(np.argmin(fine_px))]
    return found, (
        f"the marks were made in images {found}: scaled to these, their mean error is {min(fine_px):.1f} px instead "
        f"of {miss_px[0]:.1f} px (errors above {tuning.max_mark_px:g} px count as that)"
    )


def _miss_px(
    views: Mapping[int, tuple[np.ndarray, Any]], scene: Scene, marks: Marks, copy: Copy, tuning: MarkTuning
) -> float:
    """Mean distance of marks in a copy from the intersections of their points' rays, ``max_mark_px`` at most."""
    inside = as_copy(marks, scene, copy, tuning)
    off, points = [np.full(len(marks) - len(inside), tuning.max_mark_px)], np.unique(marks.point).tolist()
    for seen, _ in _rays(views, inside, points, tuning):
        if len(seen) > 1:
            residual = np.linalg.norm(_off_sigmas(seen, _nearest(seen)).reshape(-1, 2), axis=1)
            off.append(np.minimum(copy.size * residual * [s.sigma_px for s in seen], tuning.max_mark_px))
    return float(np.mean(np.concatenate(off))) if len(off) > LEAST_PLACES else tuning.max_mark_px


def as_copy(marks: Marks, scene: Scene, copy: Copy, tuning: MarkTuning) -> Marks:
    """The marks of a file interpreted in a copy of the images, with the marks found there; without marks outside the
    images."""
    if marks.file_px is None or marks.orientation is None:
        return marks
    xy, sigma = marks.xy_px.copy(), marks.sigma_px.copy()
    for k in np.flatnonzero(np.isfinite(marks.file_px).all(axis=1)):
        sensor, (x, y) = scene.sensor_of(int(marks.image[k])), marks.file_px[k].tolist()
        xy[k] = prepared_pixel(copy.pixel((x, y), sensor, int(marks.orientation[k])), sensor)
        if copy.size < 1:
            sigma[k] = tuning.mark_sigma_px / copy.size
    inside = np.array([within(p, scene.sensor_of(int(k)).camera) for p, k in zip(xy, marks.image)], bool)
    return replace(marks, xy_px=xy, sigma_px=sigma).where(inside)


@dataclass(frozen=True)
class _Ray:
    """One mark: cam_from_world (4, 4) and camera of its image (COLMAP's), pixel (2,), sigma."""

    pose: np.ndarray
    camera: Any
    xy: np.ndarray
    sigma_px: float


def without_blunders(found: list[Target], control: Control, tuning: MarkTuning) -> list[Target]:
    """The points, with blunders marked: at least five control points are needed, of which the others must agree.

    One after the other, as long as leaving a point out makes the rest agree three times as well; at most a third.
    """
    out = list(found)
    use = [k for k, t in enumerate(out) if not t.why_not and not control.check[k]]
    for _ in range(len(use) // tuning.refused_of):
        factor, _ = _agreement(out, control, use)
        if len(use) < tuning.min_to_refuse or factor <= LIMIT:
            break
        parts = [[k for k in use if k != out_of] for out_of in use]
        factors = [_agreement(out, control, p)[0] for p in parts]
        best = int(np.argmin(factors))
        if factors[best] > factor / LIMIT:
            break
        bad, use = use[best], parts[best]
        _, fit = _agreement(out, control, use)
        off = np.linalg.norm(fit(np.array([out[k].place for k in (bad, *use)])) - control.world_m[[bad, *use]], axis=1)
        within = float(np.sqrt(np.mean(off[1:] ** 2)))
        text = f"survey and model differ by {off[0]:.2f} m there, while {len(use)} others agree within {within:.2f} m"
        out[bad] = replace(out[bad], why_not=text, blunder=True)
    return out


def _agreement(found: list[Target], control: Control, use: list[int]) -> tuple[float, Similarity]:
    """RMS difference between points and survey after a similarity, in sigmas, and the similarity."""
    place = np.array([found[k].place for k in use])
    fit = umeyama(place, control.world_m[use])
    spread = np.array([np.trace(found[k].covariance) / 3 for k in use]) * fit.scale**2
    squares = (fit(place) - control.world_m[use]) ** 2 / (control.sigma_m[use] ** 2 + spread[:, None])
    return float(np.sqrt(squares.sum() / max(3 * len(use) - 7, 1))), fit


def _target(seen: list[_Ray], rows: np.ndarray, tuning: MarkTuning, of: int = 0) -> Target:
    """The point of some marks, left over of ``of`` marks (0: they are all)."""
    of = of or len(rows)
    nowhere = Target(
        np.full(3, np.nan), np.full((3, 3), np.nan), marks=rows, residual_px=np.full((len(rows), 2), np.nan)
    )
    if len(rows) < 2:
        return replace(nowhere, why_not=f"it has {len(rows)} marks in registered images; 2 are needed")
    solution: Any = scipy.optimize.least_squares(
        lambda x: _off_sigmas(seen, x),
        _nearest(seen),
        loss="soft_l1",
        f_scale=LIMIT,
        x_scale="jac",
    )
    residual = solution.fun.reshape(-1, 2) * np.array([[s.sigma_px] for s in seen])
    off = np.linalg.norm(residual, axis=1)
    worst = int(np.argmax(off))
    if len(rows) > 2 and off[worst] > tuning.max_mark_px:
        return _target(seen[:worst] + seen[worst + 1 :], np.delete(rows, worst), tuning, of)
    place, chance = solution.x, _chance(seen, float(off[worst]), of)
    found = replace(nowhere, place=place, residual_px=residual, chance=chance)
    rays = np.array([place - transforms.centre(s.pose) for s in seen])
    rays /= np.linalg.norm(rays, axis=1, keepdims=True)
    angle = float(np.degrees(np.arccos(np.clip((rays @ rays.T).min(), -1, 1))))
    if angle < tuning.min_angle_deg:
        return replace(found, why_not=f"its rays meet at an angle of only {angle:.1f} deg")
    if np.median(off) > tuning.max_mark_px:
        return replace(found, why_not=f"its rays miss each other by {np.median(off):.0f} px")
    wrong = of - len(rows)
    if wrong * tuning.refused_of > of and chance > CHANCE:
        text = (
            f"{wrong} of its {of} marks contradict the others, whose rays may meet by chance (probability {chance:.2g})"
        )
        return replace(found, why_not=text)
    return replace(found, covariance=np.linalg.pinv(solution.jac.T @ solution.jac))


def _chance(seen: list[_Ray], off_px: float, of: int) -> float:
    """Upper bound of the probability that as many of ``of`` randomly placed marks lie within ``off_px`` of one point
    in space: each mark beyond the first three coordinates within a band of twice that width."""
    side = min(min(s.camera.width, s.camera.height) for s in seen)
    return min(1.0, float(comb(of, len(seen))) * (4 * off_px / side) ** (2 * len(seen) - 3))


def _nearest(rays: list[_Ray]) -> np.ndarray:
    """The point (3,) nearest to rays."""
    normal, right = np.zeros((3, 3)), np.zeros(3)
    for one in rays:
        ray = np.append(on_plane(one.camera, one.xy[None])[0], 1.0) @ one.pose[:3, :3]
        across = np.eye(3) - np.outer(ray, ray) / (ray @ ray)
        normal += across
        right += across @ transforms.centre(one.pose)
    return np.linalg.pinv(normal) @ right


def _off_sigmas(rays: list[_Ray], x: np.ndarray) -> np.ndarray:
    """(2 M,) projections of a point (3,) minus its marks, in sigmas of these."""
    parts = []
    for one in rays:
        there = one.pose[:3, :3] @ x + one.pose[:3, 3]
        found = one.camera.img_from_cam(there) if there[2] > 0 else None
        off = np.full(2, 1e4) if found is None else np.nan_to_num(np.ravel(found) - one.xy, nan=1e4)
        parts.append(off / one.sigma_px)
    return np.concatenate(parts)


def point_table(
    control: Control, found: list[Target], off_m: np.ndarray, images: tuple[str, ...]
) -> tuple[list[dict], dict]:
    """Per point dE, dN, dU (model minus survey, metres) and pixels; RMSE, CE90 and LE90 of control and check points.

    ``off_m`` (P, 3), NaN = not in the model. CE90 and LE90 assume a normal error of this RMSE (2.146, 1.645 times);
    the number of points is given beside them. Points that are not used are in the rows only.
    """
    rows = []
    refused = np.array([bool(t.why_not) for t in found], bool)
    for k, name in enumerate(control.names):
        target = found[k]
        px = np.linalg.norm(target.residual_px, axis=1)
        row: dict[str, Any] = {"name": name, "role": "check" if control.check[k] else "gcp", "marks": len(target.marks)}
        row["off_m"] = [round(float(v), 4) for v in off_m[k]] if np.isfinite(off_m[k]).all() else None
        row["rms_px"] = round(float(np.sqrt(np.mean(px**2))), 3) if len(px) and np.isfinite(px).all() else None
        row["worst_image"] = images[int(control.marks.image[target.marks[int(np.argmax(px))]])] if len(px) else None
        row["why_not"], row["blunder"] = target.why_not, target.blunder
        rows.append(row)
    sums = {}
    for role, mask in (("gcp", ~control.check), ("check", control.check)):
        known = off_m[mask & ~refused & np.isfinite(off_m).all(axis=1)]
        if len(known):
            east, north, up = rmse = np.sqrt(np.mean(known**2, axis=0))
            flat = np.hypot(east, north)
            values = {
                "points": len(known), "rmse_east_m": east, "rmse_north_m": north, "rmse_up_m": up, "rmse_plan_m": flat,
                "rmse_m": np.linalg.norm(rmse), "ce90_m": _CE90 * flat / np.sqrt(2), "le90_m": _LE90 * up,
            }  # fmt: skip
            sums[role] = {n: round(float(v), 4) for n, v in values.items()}
    return rows, sums
