"""The network stage: from images and preview matches to candidate pairs, sections and a checked rig."""

from __future__ import annotations

import logging
from dataclasses import dataclass, replace

import numpy as np

from tiegraph.errors import choose
from tiegraph.network import pictures as draw
from tiegraph.network.design import component_notes
from tiegraph.network.model import ModelFunction, SurveyModel, by_model
from tiegraph.network.offsets import OffsetCurve
from tiegraph.network.passes import MatchFunction, PreviewBook, find_passes
from tiegraph.network.rigcheck import check_rigs
from tiegraph.network.sections import Section, SectionResult, find_sections, join_places, split
from tiegraph.network.settings import NetworkSettings
from tiegraph.network.sources import SOURCES, Context, Proposal, automatic, axes_pairs, axes_rows
from tiegraph.scene.pairs import Pairs
from tiegraph.scene.scene import Scene
from tiegraph.scene.ties import Ties

AXES_ROWS_LIMIT = 1000  # images: beyond, pairs that the axes rule out are counted and not listed

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

    def pictures(self) -> list[tuple[str, bytes]]:
        """(name, PNG) of the correspondence matrix, the offset curves and the section brightness."""
        out = [("matrix", draw.matrix_png(self.pairs, self.scene))]
        if self.curves:
            out.append(("offsets", draw.curves_png(self)))
        if np.isfinite(self.brightness).any():
            out.append(("sections", draw.sections_png(self)))
        return out


def estimate_network(
    scene: Scene,
    brightness: np.ndarray,
    match: MatchFunction,
    settings: NetworkSettings,
    make_model: ModelFunction | None = None,
) -> Network:
    """Candidate pairs of a scene from the sources of the settings.

    ``brightness`` (N,) mean grey of each image; ``match`` takes image pairs (P, 2) i4 and returns P preview matches
    (``inliers``, ``rotation``, ``shift``, ``matches``); ``make_model`` makes a small model of ties. Raises
    SettingsError for an unknown source, InputError for a bad pair list.
    """
    book = PreviewBook(match, len(scene))
    scene, rig_notes = _checked(scene, book, settings)
    passes = find_passes(scene)
    proposal = _propose(Context(scene, passes, book, settings))
    pairs = proposal.pairs
    notes = [*rig_notes, *proposal.notes]
    model = None
    if settings.model and make_model is not None and _uses_axes(settings):
        result = by_model(pairs, scene, book, settings, make_model)
        pairs, scene, model = result.pairs, result.scene, result.model
        notes += result.notes
    if settings.offsets and _uses_axes(settings):
        pairs, said = _with_axes(pairs, scene, passes, settings)
        notes += said
    pairs = pairs.with_(score=np.where(np.isnan(pairs.score), book.known(pairs.i, pairs.j), pairs.score))
    cut = _sections(scene, brightness, pairs, settings)
    scene = scene.with_(section=cut.of_frame)
    if settings.sections == "split" and len(cut.sections) > 1:
        pairs = split(pairs, scene)
    total = len(scene) * (len(scene) - 1) / 2
    notes += [*cut.notes, *component_notes(pairs, scene)]
    notes.append(f"{len(book)} previews were matched, {100 * len(book) / max(total, 1):.1f} % of all pairs of images")
    return Network(
        pairs, scene, proposal.curves, cut.sections, tuple(notes), cut.brightness, cut.threshold, book.ties(), model
    )


def _uses_axes(settings: NetworkSettings) -> bool:
    return bool({"auto", "offsets"} & set(settings.sources))


def _checked(scene: Scene, book: PreviewBook, settings: NetworkSettings) -> tuple[Scene, tuple[str, ...]]:
    """The rig check, where any source looks at the images at all."""
    if not {"auto", "offsets", "poses"} & set(settings.sources) and not settings.sequence_cameras:
        return scene, ()
    return check_rigs(scene, find_passes(scene), book, settings)


def _propose(context: Context) -> Proposal:
    """The merged proposals of all sources that the settings name."""
    table = {"auto": automatic, **SOURCES}
    merged = Proposal(Pairs.empty())
    for name in dict.fromkeys(context.settings.sources):
        found = choose("pair source", name, table)(context)  # type: ignore[operator]
        merged = Proposal(merged.pairs | found.pairs, merged.notes + found.notes, merged.curves + found.curves)
    return merged


def _with_axes(pairs: Pairs, scene: Scene, passes: tuple, settings: NetworkSettings) -> tuple[Pairs, list[str]]:
    count = len(axes_rows(passes, settings)[0])
    if not count:
        return pairs, []
    said = f"axes more than {settings.axes_deg:.0f} deg apart: {count} pairs of images of one pass were never tried"
    if len(scene) > AXES_ROWS_LIMIT:
        return pairs, [f"{said} (not listed one by one)"]
    return pairs | axes_pairs(passes, settings), [said]


def _sections(scene: Scene, brightness: np.ndarray, pairs: Pairs, settings: NetworkSettings) -> SectionResult:
    passes = find_passes(scene)
    found = find_sections(scene, passes, brightness)
    if settings.sections == "off":
        whole = Section("whole survey", "open", tuple(range(scene.frames)))
        return replace(found, sections=(whole,), of_frame=np.zeros(scene.frames, int), threshold=float("nan"), notes=())
    return join_places(found, scene, pairs)
