"""What a choice of pairs is worth, from one run in which all candidates were matched: its tracks, sigma and model."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
from scipy.sparse import coo_array, csc_matrix, csr_matrix, vstack
from scipy.sparse.csgraph import connected_components

from tiegraph.features.settings import PreviewSettings
from tiegraph.features.tuning import PreviewTuning
from tiegraph.pipeline.design import with_accuracy
from tiegraph.pipeline.files import trusted_poses
from tiegraph.pipeline.preview import with_previews
from tiegraph.scene.colmapdatabase import pair_ids, reading
from tiegraph.scene.matches import PreviewMatches, Visibility
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.scene import Scene
from tiegraph.scene.tuning import Tuning as SceneTuning
from tiegraph.sfm.adjustment.jacobians import Layout, of_image
from tiegraph.sfm.adjustment.normal import Normal, reduced
from tiegraph.sfm.mapper import Source, reconstruct
from tiegraph.sfm.mapping import believed_cameras
from tiegraph.sfm.rig.rig import rig_modes
from tiegraph.sfm.settings import SparseSettings
from tiegraph.sfm.tuning import Tuning


@dataclass(frozen=True)
class Run:
    """A run folder in which every candidate was matched: the scene the mapper sees, ``pairs`` before the design,
    ``verified`` (all of them, the refused ones dropped), previews."""

    folder: Path
    scene: Scene
    pairs: Pairs
    verified: Pairs
    ties: PreviewMatches
    visibility: Visibility | None

    @staticmethod
    def read(folder: Path) -> Run:
        """A run with ``--design.method all`` up to the stage ``filter``."""
        visibility = folder / "coarse" / "visibility.npz"
        pairs, ties = (
            Pairs.from_npz(_npz(folder / "network.npz")),
            PreviewMatches.from_npz(_npz(folder / "network" / "matches.npz")),
        )
        pairs, ties, _ = with_previews(pairs, ties, folder, PreviewSettings(), PreviewTuning(), _in_turn)
        return Run(
            folder,
            Scene.from_json((folder / "network" / "scene.json").read_text()).measured(),
            pairs,
            Pairs.from_npz(_npz(folder / "filter.npz")),
            ties,
            Visibility.from_npz(_npz(visibility)) if visibility.exists() else None,
        )

    def with_accuracy(self) -> Pairs:
        """The pairs with the accuracy that paper 002 gives them."""
        return with_accuracy(self.pairs, self.scene, self.ties, self.folder, _in_turn, Tuning().two_view)

    def settings(self) -> SparseSettings:
        """Those of the mapping: the defaults, no GNSS, so that only the pairs count."""
        return SparseSettings(covariance_frames=0, use_positions=False)

    def used(self, rows: np.ndarray) -> Pairs:
        """The verified and not refused pairs among the rows (K,) of the pair table."""
        chosen = np.zeros(len(self.pairs), bool)
        chosen[rows] = True
        if not np.array_equal(self.pairs.i, self.verified.i) or not np.array_equal(self.pairs.j, self.verified.j):
            raise ValueError(f"{self.folder}: filter.npz and network.npz are of different runs")
        return self.verified.where(chosen & (self.verified.dropped == 0) & (self.verified.inliers > 0))

    def map(self, rows: np.ndarray, out: Path, log: Path) -> list[Path]:
        """Models of the chosen pairs alone as stage ``sparse`` makes them, from the coarse model if there is one."""
        used = self.used(rows)
        kept = set(zip(used.i.tolist(), used.j.tolist()))
        away = tuple(p for p in zip(self.pairs.i.tolist(), self.pairs.j.tolist()) if p not in kept)
        coarse = trusted_poses(self.folder)
        preview = None if coarse is None else coarse[0]
        source = Source(self.folder / "database.db", self.folder / "images", away, preview=preview)
        return [
            m.folder for m in reconstruct(source, out, self.scene, self.settings(), Tuning(), SceneTuning(), log).models
        ]


def positions_free_gauge(normal: csc_matrix, layout: Layout) -> np.ndarray:
    """Covariance (3F, 3F) of the positions by the normal matrix (C, C), with similarities of the whole taken out."""
    factor = Normal(normal, layout)
    at = np.arange(6 * len(layout.centres)).reshape(-1, 6)[:, :3].ravel()
    columns = csc_matrix((np.ones(len(at)), (at, np.arange(len(at)))), shape=(layout.size, len(at)))
    sides = factor.asked(columns)
    return np.asarray(sides.T @ factor.solve(sides))


def _in_turn(function: Callable[..., Any], items: Sequence[Any], *args: Any) -> list[Any]:
    return [function(item, *args) for item in items]


def _npz(path: Path) -> dict[str, np.ndarray]:
    with np.load(path) as data:
        return dict(data)


@dataclass(frozen=True)
class _System:
    """Linearised observations of a model: Jacobians to cameras (2O, C) and points (2O, 3), variance of a coordinate."""

    layout: Layout
    by_camera: csr_matrix
    by_point: np.ndarray
    variance: float


class Tracks:
    """The observations of a model of all pairs, and the links between them that each pair's matches make."""

    def __init__(self, run: Run, model: pycolmap.Reconstruction) -> None:
        """``links`` (M, 2): observations of one point that a pair matched, ``pair`` (M,): row of ``run.verified``."""
        self.run, self.model = run, model
        images = {image.name: image for image in model.images.values() if image.has_pose}
        self.point: dict[int, np.ndarray] = {}
        self.first: dict[int, int] = {}
        self.image_id: dict[int, int] = {}
        self._made: _System | None = None
        observations = []
        for k, name in enumerate(run.scene.names):
            if name in images:
                image = images[name]
                ids = np.array([p.point3D_id if p.has_point3D() else 0 for p in image.points2D], np.int64)
                self.point[k] = np.where([p.has_point3D() for p in image.points2D], ids, -1)
                self.image_id[k] = image.image_id
                self.first[k] = sum(len(o) for o in observations)
                observations.append(np.stack([np.full(len(ids), image.image_id), np.arange(len(ids))], axis=1))
        self.observations = np.concatenate(observations)
        self.of_point = np.concatenate([self.point[k] for k in self.point])
        self.links, self.pair = self._links()

    def _links(self) -> tuple[np.ndarray, np.ndarray]:
        pairs = self.run.verified
        rows = np.flatnonzero((pairs.dropped == 0) & (pairs.inliers > 0))
        ids = pair_ids(pairs)
        links, label = [np.zeros((0, 2), int)], [np.zeros(0, int)]
        with reading(self.run.folder / "database.db") as cursor:
            for row in rows.tolist():
                i, j = int(pairs.i[row]), int(pairs.j[row])
                if i not in self.point or j not in self.point:
                    continue
                query = "SELECT data FROM two_view_geometries WHERE pair_id = ?"
                match = np.frombuffer(cursor.execute(query, (int(ids[row]),)).fetchone()[0], np.uint32).reshape(-1, 2)
                same = self.point[i][match[:, 0]]
                match = match[(same >= 0) & (same == self.point[j][match[:, 1]])].astype(np.int64)
                links.append(match + [self.first[i], self.first[j]])
                label.append(np.full(len(match), row))
        return np.concatenate(links), np.concatenate(label)

    def chosen(self, rows: np.ndarray) -> tuple[np.ndarray, np.ndarray]:
        """Observations (K,) and the track (K,) of each, of the tracks that the pairs of rows make by themselves."""
        picked = self.links[np.isin(self.pair, rows)]
        used, place = np.unique(picked, return_inverse=True)
        place = place.reshape(-1, 2)
        graph = coo_array((np.ones(len(place)), (place[:, 0], place[:, 1])), shape=(len(used), len(used)))
        return used, connected_components(graph.tocsr(), directed=False)[1]

    def sigma(self, rows: np.ndarray) -> dict[str, float]:
        """Position sigma of the frames, model units, of the bundle adjustment over the tracks of the pairs of rows.

        Exact covariance at the poses and points of the full model, free gauge, an observation as good as there:

        ``rms`` and ``median`` over the frames (infinite where frames fall apart), observations, tracks, components of
        frames.
        """
        used, track = self.chosen(rows)
        parts, count = self._components(used, track), int(track.max(initial=-1)) + 1
        out = {"observations": float(len(used)), "tracks": float(count), "components": float(parts)}
        if parts != 1:
            return {**out, "rms": float("inf"), "median": float("inf")}
        system = self._system()
        row = np.stack([2 * used, 2 * used + 1], axis=1).ravel()
        index = np.repeat(np.arange(len(row)), 3)
        column = np.repeat(3 * track[:, None] + np.arange(3), 2, axis=0).ravel()
        by_point = csr_matrix((system.by_point[row].ravel(), (index, column)), shape=(len(row), 3 * count))
        prior = system.layout.prior(self.model, Tuning().adjust, {})
        normal = reduced(system.by_camera[row], by_point) / system.variance + prior
        variance = np.diag(positions_free_gauge(normal, system.layout)).reshape(-1, 3).sum(axis=1)
        return {**out, "rms": float(np.sqrt(variance.mean())), "median": float(np.sqrt(np.median(variance)))}

    def _system(self) -> _System:
        """Jacobians of all observations of the full model, in their order; worked out once."""
        if self._made is not None:
            return self._made
        scene, settings, model = self.run.scene, self.run.settings(), self.model
        believed = len(believed_cameras(scene, settings)) == len(scene.all_sensors)
        layout = Layout(model, not believed, "fixed" not in rig_modes(scene, settings.rig).values())
        cameras, points, residuals = [], [], []
        xyz = {p: point.xyz for p, point in model.points3D.items()}
        for k in self.point:
            image = model.images[self.image_id[k]]
            seen = np.flatnonzero(self.point[k] >= 0)
            world = [xyz[int(self.point[k][n])] for n in seen]
            measured = [image.point2D(int(n)).xy for n in seen]
            by_camera = np.zeros((0, 2, 0))
            columns = np.zeros(0, int)
            by_point, residual = np.zeros((0, 2, 3)), np.zeros((0, 2))
            if len(seen):
                by_camera, columns, by_point, residual = of_image(layout, image, np.stack(world), np.stack(measured))
            where = (2 * seen[:, None] + np.arange(2)).ravel()
            total = 2 * len(self.point[k])
            index = np.repeat(where, len(columns))
            cameras.append(
                csr_matrix((by_camera.ravel(), (index, np.tile(columns, len(where)))), shape=(total, layout.size))
            )
            full = np.zeros((total, 3))
            full[where] = by_point.reshape(-1, 3)
            points.append(full)
            residuals.append(residual.ravel())
        spread = 1.4826 * float(np.median(np.abs(np.concatenate(residuals))))
        self._made = _System(layout, vstack(cameras).tocsr(), np.concatenate(points), max(spread**2, 1e-12))
        return self._made

    def _components(self, used: np.ndarray, track: np.ndarray) -> int:
        """Parts into which the tracks leave the frames of the full model."""
        frames = sorted(self.model.reg_frame_ids())
        number = {f: k for k, f in enumerate(frames)}
        of_image = {i: number[self.model.images[i].frame_id] for i in self.model.reg_image_ids()}
        frame = np.array([of_image[i] for i in self.observations[used, 0].tolist()], int)
        nodes = len(frames) + int(track.max(initial=-1)) + 1
        graph = coo_array((np.ones(len(used)), (frame, len(frames) + track)), shape=(nodes, nodes))
        return len(np.unique(connected_components(graph.tocsr(), directed=False)[1][: len(frames)]))
