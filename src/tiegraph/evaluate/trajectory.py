"""Trajectory error: ATE after alignment, RPE over travelled distances, yaw drift, registered shares."""

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, field, replace
from typing import Any

import numpy as np
from scipy.spatial.transform import Rotation

from tiegraph.evaluate.tuning import TrajectoryTuning
from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import Similarity, rms_length, robust_umeyama, umeyama
from tiegraph.scene.colmapmodel import Registration
from tiegraph.scene.results import Metric

_NAN = float("nan")
_MIN_DRIFT_M = 5.0  # travelled: below it a drift per 100 m means nothing


@dataclass(frozen=True)
class PoseMatch:
    """K poses of a model beside the reference's, each world_from_body (K, 4, 4); group (K,) numbers the sequence a pose
    belongs to (a camera on a pass), -1 = none; order (K,) sorts within it. ``parts``: by
    what the survey is divided ("pass", "section"), and the name (K,) of the part that each pose lies in."""

    estimate: np.ndarray
    reference: np.ndarray
    group: np.ndarray
    order: np.ndarray
    parts: Mapping[str, np.ndarray] = field(default_factory=dict)

    def where(self, rows: np.ndarray) -> "PoseMatch":
        """Some of the poses."""
        parts = {kind: names[rows] for kind, names in self.parts.items()}
        columns = {c: getattr(self, c)[rows] for c in ("estimate", "reference", "group", "order")}
        return PoseMatch(**columns, parts=parts)

    def __len__(self) -> int:
        return len(self.estimate)

    def sequences(self) -> Iterator[np.ndarray]:
        """Row numbers of each sequence in order."""
        for g in np.unique(self.group[self.group >= 0]):
            rows = np.flatnonzero(self.group == g)
            yield rows[np.argsort(self.order[rows], kind="stable")]


@dataclass(frozen=True)
class PositionError:
    """Distances between positions after their ``alignment`` and the reference's, metres."""

    rmse_m: float
    median_m: float
    max_m: float
    alignment: Similarity
    errors_m: np.ndarray  # (K,)


@dataclass(frozen=True)
class RelativeError:
    """Relative pose error over one travelled distance: root mean squares over ``count`` pairs of poses."""

    distance_m: float
    translation_m: float
    rotation_deg: float
    count: int


@dataclass(frozen=True)
class TrajectoryError:
    """All of it. sim3/se3: after a least-squares alignment with and without scale; absolute: no alignment (None when
    the frames differ); within: share of matched poses nearer than within_m after a robust Sim3; parts: of each pass,
    section and camera on a pass the kind and the row of its table, after the alignment of all. ``metric``: something
    told the model's scale; if not, all but se3 is after a similarity, and neither se3 nor the scale is an error."""

    metric: bool
    sim3: PositionError
    se3: PositionError
    absolute: PositionError | None
    within: float
    within_m: float
    relative: tuple[RelativeError, ...]
    yaw_drift_deg_per_100m: float
    parts: tuple[tuple[str, dict[str, Any]], ...] = ()

    def metrics(self) -> list[Metric]:
        """The figures of merit."""
        ate, near = self.sim3, f"images_within_{self.within_m:g}m"
        rows = [(f"ate_sim3_{name}", getattr(ate, f"{name}_m"), "m") for name in ("rmse", "median", "max")]
        rows += [("ate_se3_rmse", self.se3.rmse_m, "m")] if self.metric else []
        rows += [("absolute_rmse", self.absolute.rmse_m, "m")] if self.absolute is not None else []
        rows += [("scale_error", abs(ate.alignment.scale - 1) * 100, "%")] if self.metric else []
        rows += [(near, 100 * self.within, "%")]
        drift = self.yaw_drift_deg_per_100m
        rows += [("yaw_drift", drift, "deg/100 m")] if np.isfinite(drift) else []
        for r in (r for r in self.relative if r.count):
            rows.append((f"rpe_{r.distance_m:g}m_translation", r.translation_m, "m"))
            rows.append((f"rpe_{r.distance_m:g}m_rotation", r.rotation_deg, "deg"))
        shares = {near: {"better": "high", "target": 100.0}}
        return [Metric(name, value, unit, **shares.get(name, {})) for name, value, unit in rows]

    def tables(self) -> dict[str, dict]:
        """Tables for metrics.json; what no part has, such as a distance that none spans, has no columns."""
        relative = [[r.distance_m, r.translation_m, r.rotation_deg, r.count] for r in self.relative if r.count]
        columns = ["distance m", "translation m", "rotation deg", "pose pairs"]
        out = {"relative pose error": {"columns": columns, "rows": relative}} if relative else {}
        for kind in dict.fromkeys(kind for kind, _ in self.parts):
            rows = [row for of, row in self.parts if of == kind]
            columns = [c for c in rows[0] if any(row[c] == row[c] for row in rows)]
            out[f"trajectory by {kind}"] = {"columns": columns, "rows": [[row[c] for c in columns] for row in rows]}
        return out


def evaluate_trajectory(
    match: PoseMatch,
    distances_m: tuple[float, ...],
    tuning: TrajectoryTuning,
    same_frame: bool = False,
    metric: bool = True,
) -> TrajectoryError:
    """Errors of K matched poses; with ``same_frame`` also the absolute error (both are in one world). Not ``metric``:
    nothing told the scale of the estimate, so the reference does.

    Raises ValueError below three poses. Alignment: Umeyama least squares over all positions, no outlier rejection, so
    that a wrong pose counts; RPE and yaw drift use the rotations and the scale as they are after SE3.
    """
    est, ref = match.estimate[:, :3, 3], match.reference[:, :3, 3]
    rigid = umeyama(est, ref, with_scale=False)
    se3 = position_error(est, ref, rigid)
    sim3 = position_error(est, ref, umeyama(est, ref))
    errors_m = se3.errors_m if metric else sim3.errors_m
    if not metric:
        scaled = transforms.rigid(match.estimate[:, :3, :3], sim3.alignment.scale * est)
        match, rigid = replace(match, estimate=scaled), umeyama(scaled[:, :3, 3], ref, with_scale=False)
    aligned = transforms.rigid(rigid.rotation @ match.estimate[:, :3, :3], rigid(match.estimate[:, :3, 3]))
    return TrajectoryError(
        metric=metric,
        sim3=sim3,
        se3=se3,
        absolute=position_error(est, ref, Similarity()) if same_frame else None,
        within=within(est, ref, tuning.within_m),
        within_m=tuning.within_m,
        relative=tuple(relative_error(match, d, tuning.max_stretch) for d in distances_m),
        yaw_drift_deg_per_100m=yaw_drift(match, aligned),
        parts=tuple(_by_part(match, aligned, errors_m, distances_m, tuning)),
    )


def position_error(estimate: np.ndarray, reference: np.ndarray, alignment: Similarity) -> PositionError:
    """Statistics of the distances between positions (K, 3), the estimate's brought to the reference's frame."""
    e = np.linalg.norm(alignment(estimate) - reference, axis=1)
    return PositionError(*_statistics(e), alignment=alignment, errors_m=e)


def _statistics(errors_m: np.ndarray) -> tuple[float, float, float]:
    """Root mean square, median and largest of errors (K,)."""
    return float(np.sqrt(np.mean(errors_m**2))), float(np.median(errors_m)), float(errors_m.max())


def within(estimate: np.ndarray, reference: np.ndarray, within_m: float) -> float:
    """Share of positions (K, 3) nearer than ``within_m`` to the reference after a robust similarity."""
    fit, _ = robust_umeyama(estimate, reference, within_m / 3)  # three sigmas: what is within is an inlier
    return float(np.mean(np.linalg.norm(fit(estimate) - reference, axis=1) < within_m))


def relative_error(match: PoseMatch, distance_m: float, max_stretch: float) -> RelativeError:
    """RPE over a travelled distance: E = (ref_i^-1 ref_j)^-1 (est_i^-1 est_j), j the first pose at that distance.

    Path length is the reference's. Pairs whose real distance is over ``max_stretch`` times the wanted one are left out,
    so frames far apart give no figure for a short one (count 0, NaN).
    """
    ends = [np.zeros((2, 0), int)]
    for rows in match.sequences():
        path = path_length(match.reference[rows, :3, 3])
        to = np.searchsorted(path, path + distance_m - 1e-9)
        begin = np.flatnonzero(to < len(rows))
        begin = begin[path[to[begin]] - path[begin] <= max_stretch * distance_m]
        ends.append(rows[np.stack([begin, to[begin]])])
    i, j = np.concatenate(ends, axis=1)
    if not len(i):
        return RelativeError(distance_m=distance_m, translation_m=_NAN, rotation_deg=_NAN, count=0)
    step_ref, step_est = (transforms.invert(poses[i]) @ poses[j] for poses in (match.reference, match.estimate))
    error = transforms.invert(step_ref) @ step_est
    turned = transforms.angle_deg(error[:, :3, :3], np.broadcast_to(np.eye(3), (len(i), 3, 3)))
    rotation_deg = float(np.sqrt(np.mean(turned**2)))
    return RelativeError(distance_m, rms_length(error[:, :3, 3]), rotation_deg, count=len(i))


def yaw_drift(match: PoseMatch, aligned: np.ndarray) -> float:
    """Median over the sequences of |slope| of the heading error against the travelled distance, degrees per 100 m.

    Heading error: rotation about the reference world's third axis (up) of R_est R_ref^T. NaN when no sequence of
    three poses is at least 5 m long.
    """
    slopes = []
    for rows in match.sequences():
        path = path_length(match.reference[rows, :3, 3])
        if len(rows) < 3 or path[-1] < _MIN_DRIFT_M:
            continue
        turn = aligned[rows, :3, :3] @ np.swapaxes(match.reference[rows, :3, :3], 1, 2)
        yaw = np.degrees(np.unwrap(Rotation.from_matrix(turn).as_rotvec()[:, 2]))
        slopes.append(abs(np.polyfit(path, yaw, 1)[0]) * 100)
    return float(np.median(slopes)) if slopes else _NAN


def _by_part(
    match: PoseMatch,
    aligned: np.ndarray,
    errors_m: np.ndarray,
    distances_m: tuple[float, ...],
    tuning: TrajectoryTuning,
) -> Iterator[tuple[str, dict[str, Any]]]:
    """Kind and row of each part: errors of its poses, the path that its longest sequence travelled, relative errors and
    drift between its own poses."""
    for kind, names in match.parts.items():
        for name in dict.fromkeys(names):
            rows = np.flatnonzero(names == name)
            part = match.where(rows)
            ways = [float(path_length(part.reference[k, :3, 3])[-1]) for k in part.sequences()]
            row = {kind: str(name), "matched": len(rows), "path m": max(ways, default=0.0) or _NAN}
            row |= dict(zip(("rmse m", "median m", "max m"), _statistics(errors_m[rows])))
            for distance in distances_m:
                r, there = relative_error(part, distance, tuning.max_stretch), f"RPE {distance:g} m"
                row |= {f"{there}, m": r.translation_m, f"{there}, deg": r.rotation_deg}
            yield kind, {**row, "yaw drift deg/100 m": yaw_drift(part, aligned[rows])}


def path_length(positions: np.ndarray) -> np.ndarray:
    """Travelled distance (T,) along positions (T, 3), starting at 0."""
    return np.concatenate([[0.0], np.cumsum(np.linalg.norm(np.diff(positions, axis=0), axis=1))])


def registered_metrics(images: Registration) -> list[Metric]:
    """Shares of the images that are registered and that only their rig places, percent."""
    used, placed = (100 * float(np.mean(of)) if len(of) else _NAN for of in (images.registered, images.by_rig))
    return [
        Metric("registered_images", used, "%", better="high", target=100.0),
        Metric("images_by_rig", placed, "%", target=0.0),
    ]
