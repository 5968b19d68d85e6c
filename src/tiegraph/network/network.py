"""The network stage: from images and preview matches to candidate pairs, sections and a checked rig."""

from __future__ import annotations

import logging
from dataclasses import dataclass, field, replace

import numpy as np

from tiegraph.errors import choose
from tiegraph.geometry import transforms
from tiegraph.network.model.survey import by_model
from tiegraph.network.model.surveymodel import Maker, SurveyModel
from tiegraph.network.offsets.curves import OffsetCurve, contained
from tiegraph.network.offsets.surface import OffsetSurface
from tiegraph.network.order import shown_order
from tiegraph.network.passes import MatchFunction, PreviewBook, find_passes
from tiegraph.network.rig.check import check_rigs
from tiegraph.network.sections.light import Cue, UpLight
from tiegraph.network.sections.sections import Section, SectionResult, find_sections, join_places, section_links, split
from tiegraph.network.settings import NetworkSettings
from tiegraph.network.sources import (
    SOURCES,
    Context,
    Descriptors,
    Proposal,
    automatic,
    axes_count,
    axes_pairs,
)
from tiegraph.network.tuning import SectionsTuning, Tuning
from tiegraph.scene.figures import plain_text
from tiegraph.scene.graph import component_notes
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.scene import Scene
from tiegraph.scene.ties import Ties

log = logging.getLogger(__name__)


@dataclass(frozen=True)
class Network:
    """Candidate pairs, the scene with sections and checked rig, offset curves, and what people should know."""

    pairs: Pairs
    scene: Scene
    curves: tuple[OffsetCurve, ...]
    sections: tuple[Section, ...]
    notes: tuple[str, ...]
    brightness: np.ndarray  # (F,) of the up camera, NaN = none
    threshold: float  # grey value between bridge and open sky, NaN = one section
    ties: Ties  # of everything that was previewed
    model: SurveyModel | None = None  # the preview model
    cues: tuple[Cue, ...] = ()  # of the sections
    surfaces: tuple[OffsetSurface, ...] = ()
    tables: dict[str, dict] = field(default_factory=dict)
    trusted: np.ndarray = field(default_factory=lambda: np.zeros(0, bool))  # (N,) images where the model is believed

    @plain_text()
    def pictures(self) -> list[tuple[str, bytes]]:
        """(name, PNG) of the correspondence matrix, the offset curves and the section brightness."""
        from tiegraph.network import pictures as draw  # loads matplotlib

        out = [("matrix", draw.matrix_png(self.pairs, self.scene))]
        out.append(("map", draw.map_png(self.pairs, self.positions(), self.scene, unit=self.unit())))
        if self.surfaces:
            out.append(("surfaces", draw.surfaces_png(self.surfaces)))
        if self.curves:
            out.append(("offsets", draw.curves_png(self)))
        if self.cues:
            out.append(("sections", draw.sections_png(self)))
        out.append(("funnel", draw.funnel_png(self.pairs, len(self.scene))))
        return out

    def positions(self) -> np.ndarray | None:
        """(F, 3) of the frames: from the prior where most have one, else from the preview model; None = nowhere."""
        prior = self.scene.world_from_rig[:, :3, 3]
        if np.isfinite(prior).all(axis=1).mean() >= 0.5 or self.model is None:
            return prior if np.isfinite(prior).all(axis=1).any() else None
        centre = transforms.centre(self.model.cam_from_world)
        out = np.full((self.scene.frames, 3), np.nan)
        for k in np.flatnonzero(np.isfinite(centre).all(axis=1))[::-1]:
            out[self.scene.frame[k]] = centre[k]
        return out

    def unit(self) -> str:
        """Unit of the positions: metres of the prior, or the model's own."""
        prior = self.scene.world_from_rig[:, :3, 3]
        return "m" if np.isfinite(prior).all(axis=1).mean() >= 0.5 or self.model is None else "units"


def estimate_network(
    scene: Scene,
    light: UpLight | np.ndarray,
    match: MatchFunction,
    settings: NetworkSettings,
    tuning: Tuning,
    make: Maker | None = None,
    descriptors: Descriptors | None = None,
) -> Network:
    """Candidate pairs of a scene from the sources of the settings.

    ``light``: what up cameras show, or the mean grey (N,) of each image alone; ``match`` takes image pairs (P, 2) i4
    and returns P preview matches (``inliers``, ``rotation``, ``shift``, ``matches``); ``make`` makes small
    models of ties; ``descriptors`` gives those of all previews, for retrieval. Raises SettingsError for an unknown
    source, InputError for a bad pair list.
    """
    book = PreviewBook(match, len(scene))
    scene, order_notes = shown_order(scene, book, settings, tuning)
    scene, rig_notes = _checked(scene, book, settings, tuning)
    passes = find_passes(scene)
    proposal = _propose(Context(scene, passes, book, settings, tuning, descriptors))
    pairs = proposal.pairs
    notes = [*order_notes, *rig_notes, *proposal.notes]
    model, trusted = None, np.zeros(len(scene), bool)
    if settings.model and make is not None and _uses_axes(settings) and len(scene) > tuning.sources.few_photos:
        result = by_model(pairs, scene, book, settings, tuning.model, make)
        pairs, scene, model, trusted = result.pairs, result.scene, result.model, result.trusted
        notes += list(result.notes)
    if settings.offsets and _uses_axes(settings):
        pairs, text = _with_axes(pairs, scene, passes, settings, tuning.sources.axes_listed)
        notes += text
    pairs = pairs.with_(score=np.where(np.isnan(pairs.score), book.known(pairs.i, pairs.j), pairs.score))
    cut = _sections(scene, light, pairs, settings, tuning.sections)
    scene = scene.with_(section=cut.of_frame)
    if settings.sections in ("split", "meguro2025") and len(cut.sections) > 1:
        pairs = split(pairs, scene)
    total = len(scene) * (len(scene) - 1) / 2
    notes += [*cut.notes, *component_notes(pairs, scene)]
    notes.append(f"{len(book)} previews were matched, {100 * len(book) / max(total, 1):.1f} % of all pairs of images")
    links, said = section_links(pairs, scene, cut.sections, tuning.sections)
    return Network(
        pairs,
        scene,
        proposal.curves,
        cut.sections,
        (*notes, *said),
        cut.brightness,
        cut.threshold,
        book.ties(),
        model,
        cut.cues,
        proposal.surfaces,
        {"section links": links} if links["rows"] else {},
        trusted,
    )


def _uses_axes(settings: NetworkSettings) -> bool:
    return bool({"auto", "offsets"} & set(settings.sources))


def _checked(
    scene: Scene, book: PreviewBook, settings: NetworkSettings, tuning: Tuning
) -> tuple[Scene, tuple[str, ...]]:
    """The rig check, where any source looks at the images at all."""
    if not {"auto", "offsets", "poses"} & set(settings.sources) and not settings.sequence_cameras:
        return scene, ()
    return check_rigs(scene, find_passes(scene), book, settings, tuning)


def _propose(context: Context) -> Proposal:
    """The merged proposals of all sources that the settings name."""
    table = {"auto": automatic, **SOURCES}
    merged = Proposal(Pairs.empty())
    for name in dict.fromkeys(context.settings.sources):
        found = choose("pair source", name, table)(context)  # type: ignore[operator]
        merged = merged | found
    return merged


def _with_axes(
    pairs: Pairs, scene: Scene, passes: tuple, settings: NetworkSettings, listed: int
) -> tuple[Pairs, list[str]]:
    """The pairs of one pass that the axes rule out added, but for those the model has found to share surface.

    ``listed``: images, beyond which they are only counted.
    """
    count = axes_count(passes, settings)
    if not count:
        return pairs, []
    said = f"axes more than {settings.axes_deg:.0f} deg apart: {count} pairs of images of one pass are not tried"
    if len(scene) > listed:
        return pairs, [f"{said} (not listed one by one)"]
    apart = axes_pairs(passes, settings)
    found = int(contained(apart, pairs.kept()).sum())
    more = f", but for {found} whose shared surface is seen at less by the preview model" if found else ""
    return pairs | apart, [said + more]


def _sections(
    scene: Scene, light: UpLight | np.ndarray, pairs: Pairs, settings: NetworkSettings, tuning: SectionsTuning
) -> SectionResult:
    passes = find_passes(scene)
    found = find_sections(scene, passes, light, tuning)
    if settings.sections == "off":
        whole = Section("whole survey", "open", tuple(range(scene.frames)))
        return replace(found, sections=(whole,), of_frame=np.zeros(scene.frames, int), threshold=float("nan"), notes=())
    return join_places(found, scene, pairs, tuning)
