"""The stage network: the final candidate pairs, with sections of the survey, pictures, and the accuracy of their
bases in the coarse model.

The normal case of stereo (Kraus, Photogrammetry): from n matches, each with a sigma of one pixel, the place of one
image across the base is known relative to the other to distance / (focal length * sqrt(n)). It compares pairs; it
does not hold for a whole network, whose images tie in many ways.
"""

from dataclasses import dataclass

import numpy as np
from scipy.sparse import csr_array

from tiegraph.geometry import transforms
from tiegraph.geometry.transforms import rms_length, umeyama
from tiegraph.network.axes import allowed_within
from tiegraph.network.passes import Pass, find_passes
from tiegraph.network.sections import SectionResult, UpLight, find_sections, join_places, split, whole_survey
from tiegraph.network.settings import CandidatesSettings, NetworkSettings
from tiegraph.network.tuning import Tuning
from tiegraph.scene.graph import component_notes
from tiegraph.scene.pairs import REASONS, Pairs, PreviewMatches, Visibility
from tiegraph.scene.scene import Scene, of_frames

_PAIRS_AT_ONCE = 20_000  # pairs whose points are looked up at once: bounds the memory


@dataclass(frozen=True)
class Network:
    """Candidate pairs, the scene with its sections, and notes."""

    pairs: Pairs
    scene: Scene
    cut: SectionResult
    notes: tuple[str, ...]

    def plots(self, cam_from_world: np.ndarray | None) -> list[tuple[str, bytes]]:
        """(name, PNG) of the map and the sections. ``cam_from_world`` (N, 4, 4): poses of the coarse model, where no
        prior says where the frames are; NaN = none."""
        from tiegraph.network import plots as draw  # loads matplotlib

        positions, unit = positions_of(self.scene, cam_from_world)
        out = [("map", draw.map_png(self.pairs, positions, self.scene, unit=unit))]
        if self.cut.cues:
            out.append(("sections", draw.sections_png(self.scene, self.cut.sections, self.cut.cues)))
        return out


def join_network(
    pairs: Pairs,
    scene: Scene,
    ties: PreviewMatches,
    light: UpLight,
    settings: tuple[CandidatesSettings, NetworkSettings],
    tuning: Tuning,
) -> Network:
    """The network of the pairs from candidates and the coarse model: pairs that the axes of the cameras exclude are
    listed, previewed pairs have their counts, and the survey is cut into sections by the ``light`` of up cameras."""
    asked, own = settings
    notes: list[str] = []
    if asked.uses_axes():
        pairs, notes = _with_axes(pairs, scene, find_passes(scene), asked)
    pairs = pairs.with_(score=np.where(np.isnan(pairs.score), ties.known(pairs.i, pairs.j), pairs.score))
    cut = find_sections(scene, find_passes(scene), light, tuning.sections)
    cut = whole_survey(scene, cut.cues) if own.sections == "off" else join_places(cut, scene, pairs, tuning.sections)
    scene = scene.with_(section=cut.of_frame)
    if own.sections == "meguro2025" and len(cut.sections) > 1:
        pairs = split(pairs, scene)
    total = len(scene) * (len(scene) - 1) / 2
    notes += [*cut.notes, *component_notes(pairs, scene)]
    notes.append(f"{len(ties)} previews were matched, {100 * len(ties) / max(total, 1):.1f} % of all pairs of images")
    return Network(pairs=pairs, scene=scene, cut=cut, notes=tuple(notes))


def positions_of(scene: Scene, cam_from_world: np.ndarray | None) -> tuple[np.ndarray | None, str]:
    """(F, 3) positions of the frames and their unit: the priors (in m, or units of a start model) if most frames have
    one, else those of a model (N, 4, 4) in its own units; None = unknown."""
    prior = scene.world_from_rig[:, :3, 3]
    told = np.isfinite(prior).all(axis=1)
    if told.mean() >= 0.5 or cam_from_world is None:
        return prior if told.any() else None, "m" if scene.metric_positions() else "units"
    return of_frames(transforms.centre(cam_from_world), scene), "units"


def _with_axes(
    pairs: Pairs, scene: Scene, passes: tuple[Pass, ...], settings: CandidatesSettings
) -> tuple[Pairs, list[str]]:
    """The pairs with those of one pass that the axes exclude, except pairs that share surface in the model."""
    count = 0
    excluded = [np.triu(~allowed_within(p.rig, settings.axes_deg), 1) for p in passes]
    for p, cameras in zip(passes, excluded):
        there = np.sum(p.images >= 0, axis=1)
        count += int(there @ cameras @ there)
    if not count:
        return pairs, []
    said = f"axes more than {settings.axes_deg:.0f} deg apart: {count} pairs of images of one pass are not matched"
    if len(scene) > 1000:  # images, beyond which pairs excluded by the axes are counted and not listed
        return pairs, [f"{said} (not listed one by one)"]
    ends = [np.zeros((2, 0), int)]
    for p, cameras in zip(passes, excluded):
        for c, d in np.argwhere(cameras):
            left, right = np.repeat(p.images[c], len(p)), np.tile(p.images[d], len(p))
            ends.append(np.stack([left, right])[:, (left >= 0) & (right >= 0)])
    i, j = np.concatenate(ends, axis=1)
    apart = Pairs.make(i, j, "offsets", dropped=np.full(len(i), REASONS.index("axes")))
    found = int(apart.isin(pairs.kept()).sum())
    if found:
        said += f", except for {found} whose rays to the shared surface meet at a smaller angle in the coarse model"
    return pairs | apart, [said]


def with_bases(pairs: Pairs, scene: Scene, visibility: Visibility) -> Pairs:
    """The pairs with ``h_over_b`` where both images see points of the model, ``baseline_m`` and ``sigma_m`` (for
    matches with a sigma of one pixel, as many as ``score``) where measured positions give the model's scale too.

    A base known from poses in metres stays.
    """
    base = np.linalg.norm(visibility.centre[pairs.i] - visibility.centre[pairs.j], axis=1)
    distance = _distances(pairs, visibility)
    metres = metres_per_unit(scene.measured(), visibility.centre)
    focal_px = scene.focal_px
    with np.errstate(divide="ignore", invalid="ignore"):
        ratio = distance / base
        sigma = metres * distance / (0.5 * (focal_px[pairs.i] + focal_px[pairs.j]) * np.sqrt(pairs.score))
    known = np.isfinite(pairs.baseline_m) & scene.metric_positions()
    return pairs.with_(
        baseline_m=np.where(known, pairs.baseline_m, metres * base),
        h_over_b=np.where(np.isfinite(ratio), ratio, np.nan),
        sigma_m=np.where(np.isfinite(sigma), sigma, np.nan),
    )


def metres_per_unit(scene: Scene, centre: np.ndarray) -> float:
    """Size of the model's unit from the frames' prior positions and its image centres (N, 3); NaN where fewer than
    three frames have both, or their spread is no larger than the sigma of the positions."""
    where = of_frames(centre, scene)
    prior = scene.world_from_rig[:, :3, 3]
    both = np.isfinite(where).all(axis=1) & np.isfinite(prior).all(axis=1)
    if both.sum() < 3:
        return float("nan")
    sigma = np.nan_to_num(scene.position_sigma_m[both])  # a trajectory has none
    spread = np.sqrt(np.sum(np.var(prior[both], axis=0)))
    if spread <= rms_length(sigma):
        return float("nan")
    return umeyama(where[both], prior[both]).scale


def _distances(pairs: Pairs, visibility: Visibility) -> np.ndarray:
    """(P,) mean distance of the points that both images see, from both; NaN = none."""
    images = len(visibility.start) - 1
    image = np.repeat(np.arange(images), np.diff(visibility.start))
    away = np.linalg.norm(visibility.xyz[visibility.point] - visibility.centre[image], axis=1)
    shape = (images, len(visibility.xyz))
    far = csr_array((away, visibility.point, visibility.start), shape=shape)
    seen = csr_array((np.ones(len(image)), visibility.point, visibility.start), shape=shape)
    out = np.full(len(pairs), np.nan)
    for first in range(0, len(pairs), _PAIRS_AT_ONCE):
        rows = slice(first, first + _PAIRS_AT_ONCE)
        i, j = pairs.i[rows], pairs.j[rows]
        count = seen[i].multiply(seen[j]).sum(axis=1)
        total = far[i].multiply(seen[j]).sum(axis=1) + far[j].multiply(seen[i]).sum(axis=1)
        out[rows] = np.where(count > 0, 0.5 * total / np.maximum(count, 1), np.nan)
    return out
