"""The stage candidates: from images and preview matches to candidate pairs, with the order and the rig checked."""

from __future__ import annotations

from dataclasses import dataclass

from tiegraph.errors import choose
from tiegraph.network.offsets.curves import OffsetCurve
from tiegraph.network.offsets.surface import OffsetSurface
from tiegraph.network.order import shown_order
from tiegraph.network.passes import MatchCache, find_passes
from tiegraph.network.rig.check import check_rigs
from tiegraph.network.settings import CandidatesSettings
from tiegraph.network.sources import SOURCES, Context, Descriptors, Proposal, automatic
from tiegraph.network.tuning import Tuning
from tiegraph.scene.matches import PreviewMatches
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.scene import Scene


@dataclass(frozen=True)
class Candidates:
    """Candidate pairs by previews and priors, the scene with its rig and order checked, and what people should know."""

    pairs: Pairs
    scene: Scene
    notes: tuple[str, ...]
    ties: PreviewMatches  # of everything that was previewed
    curves: tuple[OffsetCurve, ...]
    surfaces: tuple[OffsetSurface, ...]

    def pictures(self) -> list[tuple[str, bytes]]:
        """(name, PNG) of the offset curves and surfaces, where offsets were looked for."""
        from tiegraph.network import plots as draw  # loads matplotlib

        out = []
        if self.surfaces:
            out.append(("surfaces", draw.surfaces_png(self.surfaces)))
        if self.curves:
            out.append(("offsets", draw.curves_png(self.curves)))
        return out


def find_candidates(
    scene: Scene,
    cache: MatchCache,
    settings: CandidatesSettings,
    tuning: Tuning,
    descriptors: Descriptors | None = None,
) -> Candidates:
    """Candidate pairs of a scene from the sources of the settings.

    ``cache`` matches previews, each pair once; ``descriptors`` gives those of all previews, for retrieval. Raises
    SettingsError for an unknown source, InputError for a bad pair list.
    """
    scene, order_notes = shown_order(scene, cache, settings, tuning)
    scene, rig_notes = _checked(scene, cache, settings, tuning)
    found = _propose(
        Context(
            scene=scene,
            passes=find_passes(scene),
            cache=cache,
            settings=settings,
            tuning=tuning,
            descriptors=descriptors,
        )
    )
    if found.apart and scene.prior == "trajectory" and not scene.started:
        scene = scene.with_(prior="odometry")
    return Candidates(
        pairs=found.pairs,
        scene=scene,
        notes=(*order_notes, *rig_notes, *found.notes),
        ties=cache.matches(),
        curves=found.curves,
        surfaces=found.surfaces,
    )


def _checked(
    scene: Scene, cache: MatchCache, settings: CandidatesSettings, tuning: Tuning
) -> tuple[Scene, tuple[str, ...]]:
    """The rig check, where any source looks at the images at all."""
    if not {"auto", "offsets", "poses"} & set(settings.sources) and not settings.sequence_cameras:
        return scene, ()
    return check_rigs(scene, find_passes(scene), cache, settings, tuning)


def _propose(context: Context) -> Proposal:
    """The merged proposals of all sources that the settings name."""
    table = {"auto": automatic, **SOURCES}
    merged = Proposal(Pairs.empty())
    for name in dict.fromkeys(context.settings.sources):
        found = choose("pair source", name, table)(context)  # type: ignore[operator]
        merged = merged | found
    return merged
