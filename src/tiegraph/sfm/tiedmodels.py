"""Models joined one after another by the matches between their images, the best tied first."""

from __future__ import annotations

from collections.abc import Mapping, Sequence

import numpy as np
import pycolmap

from tiegraph.geometry.align import Similarity
from tiegraph.scene.scene import Scene
from tiegraph.sfm.model import sim3d
from tiegraph.sfm.ties import TieFit, Ties, TieTest, find_ties, fit_ties, tested
from tiegraph.sfm.tuning import PlacementTuning
from tiegraph.sfm.verified import ImageObservations, VerifiedMatches, image_observations


class Joining:
    """The models that stand in one frame so far (``world``, by number), and what ties the others to them.

    ``scene``: that they are of; ``tests``: what the matches of each model said, also where they did not hold.
    """

    def __init__(
        self,
        scene: Scene,
        verified: VerifiedMatches,
        tuning: PlacementTuning,
        models: Sequence[pycolmap.Reconstruction],
        world: Mapping[int, pycolmap.Reconstruction],
    ) -> None:
        self.world, self.scene, self._verified, self._tuning = dict(world), scene, verified, tuning
        self._other = {k: self._seen(m) for k, m in enumerate(models) if k not in world}
        self._ties: dict[int, list[Ties]] = {k: [] for k in self._other}
        self.tests: dict[int, TieTest] = {}
        for model in world.values():
            self._tie(model)

    def add(self, number: int, model: pycolmap.Reconstruction) -> None:
        """One more stands there."""
        self.world[number] = model
        del self._other[number], self._ties[number]
        self._tie(model)

    def strongest(self, numbers: Sequence[int]) -> tuple[int, TieFit, TieTest] | None:
        """The model most matches join to the world, of those whose matches hold."""
        found: tuple[int, TieFit, TieTest] | None = None
        for number in numbers:
            ties = _together(self._ties.get(number, []))
            fit = fit_ties(ties, self._tuning) if ties is not None else None
            if ties is None or fit is None:
                continue
            self.tests[number] = test = tested(ties, fit, self._tuning)
            if test.holds(self._tuning) and (found is None or test.ties > found[2].ties):
                found = number, fit, test
        return found

    def _seen(self, model: pycolmap.Reconstruction) -> ImageObservations:
        return image_observations(model, self.scene, self._tuning.agreement)

    def _tie(self, model: pycolmap.Reconstruction) -> None:
        here = self._seen(model)
        for number, seen in self._other.items():
            ties = find_ties(here, seen, self._verified, self._tuning)
            self._ties[number] += [ties] if len(ties) else []


def moved(model: pycolmap.Reconstruction, world_from_model: Similarity) -> pycolmap.Reconstruction:
    """A copy of a model in another frame; the lengths of its rigs are scaled too."""
    out = pycolmap.Reconstruction(model)
    out.transform(sim3d(world_from_model))
    return out


def _together(ties: Sequence[Ties]) -> Ties | None:
    if not ties:
        return None
    return Ties(
        np.concatenate([t.images for t in ties]),
        np.concatenate([t.xyz for t in ties], axis=1),
        np.concatenate([t.centre for t in ties], axis=1),
    )
