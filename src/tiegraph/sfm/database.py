"""The mapper's copy of the database, and the view graph that it holds."""

from collections.abc import Mapping, Sequence
from pathlib import Path

import numpy as np

from tiegraph.scene import colmaprows
from tiegraph.scene.colmapdatabase import Rows
from tiegraph.scene.graph import parts
from tiegraph.scene.rig import Rig
from tiegraph.scene.scene import Scene
from tiegraph.sfm.model import held_out_frames
from tiegraph.sfm.tuning.world import FixTuning


def write_working_copy(
    source: Path,
    target: Path,
    scene: Scene,
    with_rig: Mapping[int, Rig],
    positions: FixTuning | None,
    refused: Sequence[tuple[int, int]] = (),
    only: np.ndarray | None = None,
) -> None:
    """Write the mapper's own copy of the database (``colmaprows.write_working_copy``); the user's file stays
    untouched.

    ``positions``: write the scene's prior positions for the mapper, all but the held-out ones; None: write none.
    """
    known = None if positions is None else mapper_positions(scene, positions)
    colmaprows.write_working_copy(source, target, scene, with_rig, known, refused, only)


def mapper_positions(scene: Scene, tuning: FixTuning) -> tuple[np.ndarray, np.ndarray]:
    """Prior positions (F, 3) of the frames but the held-out ones, NaN = none, and variances (F, 3); world metres.

    COLMAP has no lever arm: its length increases the sigma instead.
    """
    positions = np.where(held_out_frames(scene, tuning)[:, None], np.nan, scene.world_from_rig[:, :3, 3])
    sigma = np.where(np.isfinite(scene.position_sigma_m), scene.position_sigma_m, tuning.unknown_sigma_m)
    antennas = [None if scene.prior == "trajectory" else r.antenna_m for r in scene.rigs]
    arm2 = np.array([0.0 if a is None else float(np.linalg.norm(a)) ** 2 for a in antennas])
    return positions, sigma**2 + arm2[scene.rig][:, None]


class ViewGraph:
    """The key points and verified pairs of each image in the database, and its connected component."""

    def __init__(
        self, database_path: Path, scene: Scene, min_matches: int, refused: Sequence[tuple[int, int]] = ()
    ) -> None:
        """Read the counts. Indices are those of the scene; ``component`` -1 = no verified pair except ``refused``
        ones."""
        with Rows(database_path) as rows:
            names, features, table = rows.image_names(), rows.feature_counts(), rows.inlier_counts()
        index = {image_id: scene.image_index.get(name, -1) for image_id, name in names.items()}
        count = len(scene)
        self.features = np.zeros(count, int)
        for image_id, number in features.items():
            if index.get(image_id, -1) >= 0:
                self.features[index[image_id]] = number
        table = table[table[:, 2] >= min_matches]
        ends = np.array([[index.get(a, -1), index.get(b, -1)] for a, b, _ in table], int).reshape(-1, 2)
        away = {(min(pair), max(pair)) for pair in refused}
        inside = (ends >= 0).all(axis=1) & np.array([(min(e), max(e)) not in away for e in ends.tolist()], bool)
        self.pairs, self.inliers = ends[inside], table[inside, 2]
        self.degree = np.bincount(self.pairs.ravel(), minlength=count)
        self.component = np.where(self.degree > 0, parts(self.pairs[:, 0], self.pairs[:, 1], count), -1)

    @property
    def components(self) -> list[int]:
        """Sizes of the components of images with verified pairs, largest first."""
        return sorted(np.bincount(self.component[self.component >= 0]).tolist(), reverse=True)
