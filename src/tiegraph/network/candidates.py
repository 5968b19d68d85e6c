"""The stage candidates: from images and preview matches to candidate pairs, with the order and the rig checked.

Is a pass a sequence? Numbers and regular times of photographs are no evidence of it; their previews are. In a
sequence neighbours have similar views: three quarters of them tie, and by clearly more matches than images half the
pass apart. The number of matches decides and not the ties alone: a few seconds down a street everything still ties
(KITTI: 37 of 40 such pairs, by a median of 22 matches where neighbours have 271). Otherwise the images are loose
photographs: all of them, or look-alikes, are compared, and no stage relies on their order. An order stated by the
user is not tested.
"""

from dataclasses import dataclass

import numpy as np

from tiegraph.network.offsets.curves import OffsetCurve
from tiegraph.network.passes import MatchCache, Pass, find_passes
from tiegraph.network.rig.check import check_rigs
from tiegraph.network.settings import CandidatesSettings
from tiegraph.network.sources import SOURCES, Context, Descriptors, Proposal, automatic
from tiegraph.network.tuning import Tuning
from tiegraph.plugins import chosen
from tiegraph.scene.pairs import Pairs, PreviewMatches
from tiegraph.scene.scene import Scene


@dataclass(frozen=True)
class Candidates:
    """Candidate pairs from previews and priors, the scene with its rig and order checked, and notes."""

    pairs: Pairs
    scene: Scene
    notes: tuple[str, ...]
    ties: PreviewMatches  # of everything that was previewed
    curves: tuple[OffsetCurve, ...]

    def pictures(self) -> list[tuple[str, bytes]]:
        """(name, PNG) of the offset curves, if offsets were computed."""
        if not self.curves:
            return []
        from tiegraph.network.plots import curves_png  # loads matplotlib

        return [("offsets", curves_png(self.curves))]


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
    )


def _checked(
    scene: Scene, cache: MatchCache, settings: CandidatesSettings, tuning: Tuning
) -> tuple[Scene, tuple[str, ...]]:
    """The rig check, if any source uses the images."""
    if not {"auto", "offsets", "poses"} & set(settings.sources) and not settings.sequence_cameras:
        return scene, ()
    return check_rigs(scene, find_passes(scene), cache, settings, tuning)


def _propose(context: Context) -> Proposal:
    """The merged proposals of all sources that the settings name."""
    table = {"auto": automatic, **SOURCES}
    merged = Proposal(Pairs.empty())
    for name in dict.fromkeys(context.settings.sources):
        found = chosen("pairs", name, table)(context)
        merged = merged | found
    return merged


def shown_order(
    scene: Scene, cache: MatchCache, settings: CandidatesSettings, tuning: Tuning
) -> tuple[Scene, tuple[str, ...]]:
    """The scene without passes whose guessed order is not confirmed, and notes.

    The source ``sequence``, if the user asks for it, states that the order is right; sources that use no previews
    test none.
    """
    if not scene.guessed or "sequence" in settings.sources:
        return scene.with_(guessed=()), ()
    looks = bool({"auto", "offsets", "poses", "retrieval"} & set(settings.sources))
    lost, notes = [], []
    for found in (p for p in find_passes(scene) if scene.sequences[p.sequence] in scene.guessed):
        shown, why = _shown(found, cache, settings, tuning) if looks else (False, "no preview was matched")
        if shown:
            notes.append(f"pass {found.name}: a sequence, {why}")
        else:
            lost.append(found.sequence)
            text = f"pass {found.name}: {len(found)} loose photographs and no sequence, although their names or times"
            notes.append(f"{text} are in order: {why}; --scan.layout sequence reads them as a sequence")
    return _without(scene, lost), tuple(notes)


def _shown(found: Pass, cache: MatchCache, settings: CandidatesSettings, tuning: Tuning) -> tuple[bool, str]:
    """Whether previews show a pass of one camera to be a sequence, and the figures."""
    order = tuning.sources
    images = found.images[0][found.images[0] >= 0]
    count = len(images)
    some = min(count - 1, order.sample)
    near = np.unique(np.linspace(0, count - 2, some).astype(int)) if count > 1 else np.zeros(0, int)
    half = count // 2
    rng = np.random.default_rng(0)
    a, b = np.triu_indices(count, k=max(half, 1))
    far = np.sort(rng.choice(len(a), min(len(a), order.sample), replace=False))
    first, second = np.r_[images[near], images[a[far]]], np.r_[images[near + 1], images[b[far]]]
    counts = cache.measure(first, second)
    close, apart = counts[: len(near)], counts[len(near) :]
    if len(close) < order.least_neighbours:
        return False, f"its {count} images are too few for a test"
    sure = tuning.counts.sure * settings.min_matches
    said = (
        f"{int(np.sum(close >= sure))} of {len(close)} previews of neighbours tie, and {int(np.sum(apart >= sure))} "
        f"of {len(apart)} previews of images half the pass apart (medians {np.median(close):.0f} and "
        f"{np.median(apart):.0f} matches)"
    )
    least, most = np.percentile(close, order.quartiles[0]), np.percentile(apart, order.quartiles[1])
    chance = settings.min_matches
    clearly = most - chance < order.most_far * (least - chance)
    return bool(least >= sure and clearly), said


def _without(scene: Scene, passes: list[int]) -> Scene:
    """The scene with the frames of some passes loose, and the other passes renumbered."""
    if not passes:
        return scene.with_(guessed=())
    kept = [k for k in range(len(scene.sequences)) if k not in passes]
    number = np.full(len(scene.sequences) + 1, -1)  # the last is that of loose frames
    number[kept] = np.arange(len(kept))
    sequence = number[scene.sequence]
    step = np.where(sequence < 0, np.cumsum(sequence < 0) - 1, scene.sequence_index)
    return scene.with_(
        sequence=sequence, sequence_index=step, sequences=tuple(scene.sequences[k] for k in kept), guessed=()
    )
