"""The stages candidates, coarse and network one after another on data, as their glue does it."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass
from functools import partial

import numpy as np

from tiegraph.geometry import transforms
from tiegraph.network.candidates import Candidates, find_candidates
from tiegraph.network.coarse.assembled import Assembled, assembled, is_whole
from tiegraph.network.coarse.model import CoarseModel
from tiegraph.network.coarse.search import Coarse, Search, worth_a_model
from tiegraph.network.network import Network, join_network
from tiegraph.network.passes import Context, MatchCache, find_passes
from tiegraph.network.sections import UpLight
from tiegraph.network.settings import CandidatesSettings, CoarseSettings, NetworkSettings
from tiegraph.network.tuning import Tuning
from tiegraph.scene.blocks import Block, blocks_of
from tiegraph.scene.pairs import Pairs, PreviewMatches
from tiegraph.scene.scene import Scene
from tiegraph.scene.tuning import Tuning as SceneTuning

SETTINGS, TUNING = CandidatesSettings(), Tuning()
Make = Callable[[Scene, PreviewMatches], CoarseModel | None]  # of the scene of a block and its ties


def without_features(scene: Scene) -> Callable[[], list[np.ndarray]]:
    """Descriptors of previews without any: no image looks like another."""
    return lambda: [np.zeros((0, 128), np.uint8)] * len(scene)


def context_of(
    scene: Scene, match: Callable | MatchCache, settings: CandidatesSettings = SETTINGS, tuning: Tuning = TUNING
) -> Context:
    """What a source of pairs is given: the previews of a scene by a function, or those that a cache has."""
    cache = match if isinstance(match, MatchCache) else MatchCache(match, len(scene))
    return Context(scene, find_passes(scene), cache, settings, tuning, without_features(scene))


@dataclass(frozen=True)
class Steps:
    """What the three stages made."""

    candidates: Candidates
    coarse: Coarse
    network: Network
    ties: PreviewMatches

    @property
    def pairs(self) -> Pairs:
        """The pairs that go on."""
        return self.network.pairs

    @property
    def scene(self) -> Scene:
        """The scene that goes on."""
        return self.network.scene

    @property
    def trusted(self) -> np.ndarray:
        """(N,) bool: images where the coarse model is believed."""
        return self.coarse.trusted

    @property
    def notes(self) -> tuple[str, ...]:
        """Of all three."""
        return (*self.candidates.notes, *self.coarse.notes, *self.network.notes)

    def pictures(self) -> list[tuple[str, bytes]]:
        """Of the last."""
        model = self.coarse.model
        return self.network.plots(None if model is None else model.cam_from_world)


def estimate_network(
    scene: Scene,
    light: np.ndarray,
    match: Callable,
    settings: CandidatesSettings,
    tuning: Tuning,
    make: Make | None = None,
    sections: str = "link",
) -> Steps:
    """The three stages; ``make`` makes the coarse models, without it there is none. The world whose previews ``match``
    matches may have their descriptors."""
    book = MatchCache(match, len(scene))
    descriptors = getattr(getattr(match, "__self__", None), "descriptors", without_features(scene))
    found = find_candidates(scene, book, settings, tuning, descriptors)
    coarse = Coarse(found.pairs, found.scene, None, np.zeros(len(scene), bool))
    both = settings, CoarseSettings()
    if make is not None and worth_a_model(*both):
        explains = partial(agrees, match.__self__)  # type: ignore[attr-defined]
        search = Search((found.pairs, found.scene), book, both, tuning, explains)
        mapper = Mapper(found.scene, tuning, make)
        while (wanted := search.wanted()) is not None:
            search.take(wanted, mapper(wanted))
        coarse = search.result()
    own = NetworkSettings(sections=sections)
    network = join_network(coarse.pairs, coarse.scene, book.matches(), UpLight(light), (settings, own), tuning)
    return Steps(found, coarse, network, book.matches())


def network_of(scene: Scene, match: Callable, settings: CandidatesSettings | None = None, **more: object) -> Steps:
    """The stages with everything else as it is by default, and even light."""
    light = more.pop("light", np.full(len(scene), 120.0))
    return estimate_network(scene, light, match, settings or CandidatesSettings(), Tuning(), **more)


def agrees(world: object, model: CoarseModel, i: np.ndarray, j: np.ndarray) -> np.ndarray:
    """(K,) bool: pairs that share surface in the world and are in the model as they are there, to a metre and a
    degree; of the others, which tie similar walls, those that share surface in the model."""
    true = transforms.invert(world.world_from_sensor)  # type: ignore[attr-defined]
    off = [p[j] @ transforms.invert(p[i]) for p in (model.cam_from_world, true)]
    near = np.linalg.norm(off[0][:, :3, 3] - off[1][:, :3, 3], axis=1) < 1
    near &= transforms.angle_deg(off[0][:, :3, :3], off[1][:, :3, :3]) < 1
    shares = np.maximum(world.overlap(i, j), world.overlap(j, i)) > 0.05  # type: ignore[attr-defined]
    return np.where(shares, near, model.overlap(180.0, TUNING.coarse).between(i, j) >= SETTINGS.min_overlap)


class Mapper:
    """Maps ties of a scene in blocks, which stay as they were cut the first time."""

    def __init__(self, scene: Scene, tuning: Tuning, make: Make, scenes: SceneTuning = SceneTuning()) -> None:  # noqa: B008
        self._scene, self._make, self._tuning, self._scenes = scene, make, tuning, scenes
        self.blocks: tuple[Block, ...] = ()

    def __call__(self, ties: PreviewMatches) -> Assembled:
        """The models, joined."""
        if not len(ties):
            return Assembled(())
        self.blocks = self.blocks or blocks_of(self._scene, ties.i, ties.j, ties.counts(), self._scenes.blocks)
        whole = is_whole(self.blocks, self._scene)
        parts = [(self._scene, ties)] if whole else [block.part_of(self._scene, ties) for block in self.blocks]
        models = [self._make(part, inside) if len(inside) else None for part, inside in parts]
        return assembled(self._scene, self.blocks, models, self._tuning.coarse, self._scenes.joining)
