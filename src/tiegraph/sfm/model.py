"""The scene's frames in a model: poses, held-out positions, tables, remarks. Arrays of a model are in
``scene.colmapmodel``."""

from collections.abc import Sequence
from dataclasses import dataclass, field
from itertools import permutations

import numpy as np

from tiegraph.geometry import transforms
from tiegraph.scene.scene import Scene
from tiegraph.sfm.tuning.placement import ScaleTuning
from tiegraph.sfm.tuning.world import FixTuning

ROUNDS = 10  # most rounds of an iteration that ends when nothing changes: bounds the time


@dataclass
class Findings:
    """Remarks on models, contradictions between given values and the images, tables, counts, and (image name, reason)
    of images that are left out."""

    notes: list[str] = field(default_factory=list)
    contradictions: list[str] = field(default_factory=list)
    tables: dict[str, dict] = field(default_factory=dict)
    counts: dict[str, float] = field(default_factory=dict)
    dropped: list[tuple[str, str]] = field(default_factory=list)

    def add(self, other: "Findings") -> None:
        """Add the findings of a further step."""
        self.notes += other.notes
        self.contradictions += other.contradictions
        self.tables |= other.tables
        self.counts |= other.counts
        self.dropped += other.dropped


def rig_from_sensor(scene: Scene, scale: float = 1.0) -> np.ndarray:
    """(N, 4, 4) of each image by the scene's extrinsics, lengths times ``scale``; NaN = unknown."""
    out = np.full((len(scene), 4, 4), np.nan)
    for k in range(len(scene)):
        extrinsics = scene.sensor_of(k).sensor_from_rig
        if extrinsics is None and scene.sensor[k] == 0:
            extrinsics = np.eye(4)
        if extrinsics is not None:
            out[k] = transforms.invert(extrinsics)
    out[:, :3, 3] *= scale
    return out


def frame_poses(cam_from_world: np.ndarray, scene: Scene, metres_per_unit: float = 1.0) -> np.ndarray:
    """world_from_rig (F, 4, 4) of the scene's frames, model units; NaN = not registered.

    The pose is that of the reference sensor's image; if that is not registered, it follows from the first registered
    image with known extrinsics (``metres_per_unit`` of the model converts the rig's lengths to model units).
    """
    rig_from_cam = rig_from_sensor(scene, 1.0 / metres_per_unit)
    usable = np.isfinite(cam_from_world).all(axis=(1, 2)) & np.isfinite(rig_from_cam).all(axis=(1, 2))
    poses = np.full((scene.frames, 4, 4), np.nan)
    order = np.flatnonzero(usable)
    order = order[np.argsort(-scene.sensor[order].astype(int), kind="stable")]  # the reference is last and decides
    for k in order:
        poses[scene.frame[k]] = transforms.invert(rig_from_cam[k] @ cam_from_world[k])
    return poses


def relative_poses(scene: Scene, index: int, poses: Sequence[np.ndarray]) -> dict[tuple[int, int], np.ndarray]:
    """b_from_a (K, 4, 4) of every two sensors a, b of a rig over all frames and models with ``poses`` (N, 4, 4) of the
    images, baselines scaled to the first model's."""
    of, out, unit = np.flatnonzero(scene.rig[scene.frame] == index), {}, np.nan
    at = np.full((scene.frames, len(scene.rigs[index].sensors)), -1)
    at[scene.frame[of], scene.sensor[of]] = of
    for model in poses:
        shown = (at >= 0) & np.isfinite(model[at]).all(axis=(2, 3))
        each = {(a, b): at[shown[:, a] & shown[:, b]][:, [a, b]].T for a, b in permutations(range(at.shape[1]), 2)}
        steps = {pair: model[b] @ transforms.invert(model[a]) for pair, (a, b) in each.items() if len(a)}
        if steps:
            length = float(np.median(np.linalg.norm(np.concatenate([*steps.values()])[:, :3, 3], axis=1)))
            unit = length if np.isnan(unit) else unit
        for pair, step in steps.items():
            step[:, :3, 3] *= unit / length if length > 0 else 1.0
            out[pair] = np.concatenate([out.get(pair, step[:0]), step])
    return out


def distances(scene: Scene, centre: np.ndarray, tuning: ScaleTuning) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """Distances of random frames by their prior positions, metres, in a model, where ``centre`` (F, 3) are their
    places (NaN = none), and the noise of the first: all (K,), empty with too few positions or a model of one place."""
    position = scene.world_from_rig[:, :3, 3]
    known = np.flatnonzero(np.isfinite(centre).all(axis=1) & np.isfinite(position).all(axis=1))
    if len(known) < transforms.LEAST_PLACES:
        return np.zeros(0), np.zeros(0), np.zeros(0)
    sigma = np.nan_to_num(np.nanmax(scene.position_sigma_m[known], axis=1, initial=0.0))
    a, b = np.random.default_rng(0).choice(len(known), (2, 4000))  # distances: bounds the time
    apart, own = (np.linalg.norm(p[known[a]] - p[known[b]], axis=1) for p in (position, centre))
    some = own > 0
    return apart[some], own[some], np.maximum(sigma[a] + sigma[b], tuning.least_noise_m)[some]


def held_out_frames(scene: Scene, tuning: FixTuning) -> np.ndarray:
    """(F,) bool: every fifth frame with a prior position, in the order of the passes; none when there are few.

    These positions are used in the final alignment only, neither in the mapping nor in the fit that is checked with
    them.
    """
    out = np.zeros(scene.frames, bool)
    has = np.flatnonzero(np.isfinite(scene.world_from_rig[:, :3, 3]).all(axis=1))
    if len(has) < 2 * tuning.held_out_every:  # too few would remain for the fit
        return out
    order = has[np.lexsort((scene.sequence_index[has], scene.sequence[has]))]
    out[order[tuning.held_out_every // 2 :: tuning.held_out_every]] = True
    return out
