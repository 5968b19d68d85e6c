"""Coverage: where is the network of pairs weak, and where the surface. Seconds on a field laptop (paper 003).

Pairs alone do not show where a network is weak: where hardly anything matches, many pairs are tried. So the matches of
the previews are used. Pairs that are almost sure to be verified join features to tracks, and frames that share few of
these with all the others are named; others do not count, for an essential matrix finds twenty inliers in noise.

Points of a rough model represent the surface. They are grouped in cells, cubes of a tenth of the usual distance, each
divided into the side seen from one direction and the one seen from the other: a wall's two faces are covered by
different images. The precision is that of a point that all images of the cell measure, by the geometry of their rays
alone (the inverse of the normal matrix of the intersection); its largest half axis, mostly the depth.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from typing import Any

import numpy as np
from matplotlib.figure import Figure
from scipy.spatial import cKDTree

from tiegraph.design.matchprediction import verified_chance
from tiegraph.design.tuning import SurfaceTuning, Tuning
from tiegraph.geometry import transforms
from tiegraph.geometry.gravity import levelled
from tiegraph.geometry.transforms import normal_matrices
from tiegraph.scene.graph import (
    WeaklyTied,
    component_notes,
    components,
    cuts,
    frame_links,
    groups,
    named,
    parts,
    two_links,
    weakly_tied,
)
from tiegraph.scene.pairs import Pairs, PreviewMatches, Visibility
from tiegraph.scene.results import png
from tiegraph.scene.scene import Scene
from tiegraph.scene.sorting import Columns, blocks
from tiegraph.text import some

_LISTED = 200  # weak links in the table, worst first


@dataclass(frozen=True)
class Coverage:
    """``lines`` for people, worst first; ``table`` of the weak links {"columns", "rows"}; ``counts`` by name;
    ``sound``: everything is connected and nothing depends on a single link."""

    lines: tuple[str, ...]
    table: dict[str, Any]
    counts: dict[str, int]

    @property
    def sound(self) -> bool:
        """Whether nothing is missing and nothing depends on one link."""
        weak = ("alone", "bridges", "joints", "weak_groups", "on_few_points")
        return not any(self.counts[k] for k in weak) and (self.counts["components"] <= 1)


def on_few_points(pairs: Pairs, scene: Scene, ties: PreviewMatches, tuning: Tuning) -> tuple[WeaklyTied, ...]:
    """Frames, and groups of frames, that the kept pairs tie to all others by few points, by the matches of previews.

    Nothing if no kept pair was previewed: then only the pairs can be judged.
    """
    kept = pairs.kept()
    own = ties.where(np.isin(np.arange(len(ties)), ties.find(kept.i, kept.j)))
    if not len(own):
        return ()
    sure = own.where(verified_chance(own.counts(), tuning.match_prediction) >= tuning.sure)
    track, image = sure.tracks()
    everywhere = np.ones(scene.frames, bool)
    return weakly_tied(track, scene.frame[image], everywhere, tuning.few_points, tuning.few_points_alone)


def unknown_across(pairs: Pairs, scene: Scene, ties: PreviewMatches, weak: Sequence[WeaklyTied]) -> np.ndarray:
    """(P,) bool: kept pairs without a preview that tie weakly tied frames to others: perhaps their only ties."""
    side = np.full(scene.frames, -1)
    for number, group in enumerate(weak):
        side[list(group.frames)] = number
    across = side[scene.frame[pairs.i]] != side[scene.frame[pairs.j]]
    return across & (pairs.dropped == 0) & (ties.find(pairs.i, pairs.j) < 0)


def coverage(pairs: Pairs, scene: Scene, weak: Sequence[WeaklyTied] = ()) -> Coverage:
    """Weak places of the kept pairs: images without pair, separate components, single links, joints, loose groups,
    and ``weak``, groups with few points (``on_few_points``).

    The images of a frame are one node, because the rig connects them. A single link (bridge) is a pair without which
    frames come apart; a joint (articulation point) is a frame without which they do.
    """
    kept = pairs.kept()
    links = frame_links(kept.i, kept.j, scene)
    found = cuts(links.a, links.b, scene.frames, links.several)
    bridges = np.flatnonzero(found.bridge)
    bridges = bridges[np.argsort(-found.side[bridges], kind="stable")]
    joints = np.flatnonzero(found.joint)
    joints = joints[np.argsort(-found.falls[joints], kind="stable")]
    rows: list[list[Any]] = []
    loose = _loose_groups(kept, scene)
    rows += [[kind, name, frames, count, None] for kind, name, frames, count in loose]
    rows += [["few points", named(g, scene.frame_names), len(g.frames), None, g.points] for g in weak]
    for k in bridges[:_LISTED]:
        pair = links.row[k]
        where = f"{scene.names[kept.i[pair]]} - {scene.names[kept.j[pair]]}"
        rows.append(["single link", where, int(found.side[k]), 1, None])
    for k in joints[:_LISTED]:
        rows.append(["joint", scene.frame_names[k], int(found.falls[k]), 1, None])
    lines = component_notes(pairs, scene) + _lines(rows, len(bridges), len(joints))
    size = np.bincount(components(pairs, len(scene)), minlength=1)
    counts = {
        "images": len(scene),
        "pairs": len(kept),
        "components": int(parts(links.a, links.b, scene.frames).max(initial=-1)) + 1,
        "alone": int(np.sum(size == 1)) if len(scene) > 1 else 0,
        "bridges": len(bridges),
        "joints": len(joints),
        "weak_groups": len(loose),
        "on_few_points": sum(len(group.frames) for group in weak),
    }
    fine = f"{len(kept)} pairs connect {len(scene)} images; no place depends on a single link"
    columns = ["kind", "where", "frames at stake", "independent links", "matched points"]
    return Coverage(lines or (fine,), {"columns": columns, "rows": rows}, counts)


def _loose_groups(kept: Pairs, scene: Scene) -> list[tuple[str, str, int, int]]:
    """Cameras, passes and sections tied to the rest by fewer than two pairs without a common image."""
    out = []
    for group in groups(scene):
        count = len(two_links(kept.i, kept.j, group.member, np.zeros(len(kept))))
        if count < 2:
            out.append((group.kind, group.name, len(np.unique(scene.frame[group.member])), count))
    return out


def _lines(rows: list[list[Any]], bridges: int, joints: int) -> tuple[str, ...]:
    out = []
    for kind in ("section", "pass", "camera"):
        for count, words in ((0, "no pair ties"), (1, "only one independent link ties")):
            names = [str(r[1]) for r in rows if r[0] == kind and r[3] == count]
            if names:
                out.append(f"{words} {kind} {some(names, 10)} to the others")
    few = [f"{r[1]}: {r[4]}" for r in rows if r[0] == "few points"]
    if few:
        out.append(f"hardly tied to the others, matched points that they share with them: {some(few, 5)}")
    for kind, count, words in (
        ("single link", bridges, ", frames that depend on it in brackets"),
        ("joint", joints, " (in brackets the frames lost without this frame)"),
    ):
        places = [f"{r[1]} ({_counted(r[2], 'frame')})" for r in rows if r[0] == kind]
        if count:
            out.append(f"{_counted(count, kind)}{words}: {some(places, 5, count)}")
    return tuple(out)


def _counted(count: int, word: str) -> str:
    return f"{count} {word}{'' if count == 1 else 's'}"


COLOURS = ("#4c9a6a", "#b3261e", "#d9822b", "#c4a000", "#8e5ea2")  # of VERDICTS
_INK, _DPI = "#444444", 110
_INSIDE = (1.0, 99.0)  # percentiles of the cells that the picture shows
VERDICTS = ("well covered", "one image", "few images", "narrow angle", "imprecise")
_NEAR = 1.8  # sides of a cell between neighbours: those across an edge too


@dataclass(frozen=True)
class SurfaceMap(Columns):
    """C cells of the surface, in the frame and unit of the model.

    xyz (C, 3): centre of the cell's points; images (C,): how many see it; angle_deg (C,): largest between two of their
    rays; sigma (C,): expected of a point, largest half axis, infinite for one image; verdict (C,): index of VERDICTS;
    best (C,): the image that sees it from the shortest distance; side: of a cell.
    """

    xyz: np.ndarray
    images: np.ndarray
    angle_deg: np.ndarray
    sigma: np.ndarray
    verdict: np.ndarray
    best: np.ndarray
    side: float

    def shares(self) -> dict[str, float]:
        """Share of the cells of each verdict, in percent."""
        count = np.bincount(self.verdict, minlength=len(VERDICTS))
        return {name: 100.0 * float(n) / max(len(self), 1) for name, n in zip(VERDICTS, count)}


@dataclass(frozen=True)
class WeakPlace:
    """Weakly covered cells side by side: their rows in the map, middle (3,), the most frequent verdict, and the image
    that sees most of them from near."""

    cells: np.ndarray
    xyz: np.ndarray
    verdict: int
    image: int


def surface_map(seen: Visibility, focal_px: np.ndarray, tuning: SurfaceTuning) -> SurfaceMap:
    """The cells seen by N images of known pose; ``focal_px`` (N,) of each, NaN = unknown, then it does not count."""
    distances = np.concatenate([np.zeros(0), *(sights.distance for sights in _sights(seen, focal_px, np.inf))])
    if not len(distances):
        none = np.zeros(0, int)
        return SurfaceMap(
            xyz=np.zeros((0, 3)), images=none, angle_deg=none, sigma=none, verdict=none, best=none, side=0.0
        )
    usual = float(np.median(distances))
    farthest = tuning.farthest * usual
    cell = _cells(seen, focal_px, farthest, tuning.cell * usual, tuning.least_points)
    kept = cell >= 0
    count = np.bincount(cell[kept], minlength=int(cell.max(initial=-1)) + 1)
    middle = np.column_stack([np.bincount(cell[kept], seen.xyz[kept, a]) / count for a in range(3)])
    pairs, times = [np.zeros(0, np.int64)], [np.zeros(0, np.int64)]
    for sights in _sights(seen, focal_px, farthest):  # the images of two blocks are others
        pair = cell[sights.point].astype(np.int64) * len(focal_px) + sights.image
        found = np.unique(pair[kept[sights.point]], return_counts=True)
        pairs.append(found[0])
        times.append(found[1])
    pair, often = np.concatenate(pairs), np.concatenate(times)
    order = np.argsort(pair)
    cell_of, image_of = np.divmod(pair[order], len(focal_px))
    enough = often[order] >= 0.3 * count[cell_of]
    return _judged(middle, cell_of[enough], image_of[enough], (seen.centre, focal_px), tuning, usual)


@dataclass(frozen=True)
class _Sights:
    """S rays: image (S,), point (S,), ``towards`` (S, 3) unit vectors from the point to the image, distance (S,)."""

    image: np.ndarray
    point: np.ndarray
    towards: np.ndarray
    distance: np.ndarray


def _sights(seen: Visibility, focal_px: np.ndarray, farthest: float) -> Iterator[_Sights]:
    """The rays of images of known focal length to points not too far away, in blocks of images."""
    for own in blocks(seen.start):
        image = np.repeat(np.arange(own.start, own.stop), np.diff(seen.start[own.start : own.stop + 1]))
        point = np.asarray(seen.point[seen.start[own.start] : seen.start[own.stop]])
        ray = seen.centre[image] - seen.xyz[point]
        distance = np.linalg.norm(ray, axis=1)
        good = (distance > 0) & (distance <= farthest) & np.isfinite(distance) & np.isfinite(focal_px[image])
        towards = ray[good] / distance[good, None]
        yield _Sights(image=image[good], point=point[good], towards=towards, distance=distance[good])


def _cells(seen: Visibility, focal_px: np.ndarray, farthest: float, side: float, least: int) -> np.ndarray:
    """(P,) cell of each point, numbered without gaps; -1 = seen by nobody, or one of too few."""
    xyz = seen.xyz
    towards = np.zeros((len(xyz), 3))
    for sights in _sights(seen, focal_px, farthest):
        for a in range(3):
            towards[:, a] += np.bincount(sights.point, sights.towards[:, a], len(xyz))
    length = np.linalg.norm(towards, axis=1)
    there = np.flatnonzero(length > 0)
    towards = towards[there] / length[there, None]
    box = np.unique(np.floor(xyz[there] / side).astype(np.int64), axis=0, return_inverse=True)[1].ravel()
    # The axis that the directions of a box lie along, whatever their sign, tells its two faces apart.
    spread = -normal_matrices(towards, np.ones(len(there)), box, int(box.max()) + 1)
    axis = np.linalg.eigh(spread)[1][:, :, -1]
    face = np.sum(towards * axis[box], axis=1) >= 0
    _, cell, count = np.unique(2 * box + face, return_inverse=True, return_counts=True)
    number = np.where(count >= least, np.cumsum(count >= least) - 1, -1)
    out = np.full(len(xyz), -1)
    out[there] = number[cell]
    return out


def _judged(
    middle: np.ndarray,
    cell: np.ndarray,
    image: np.ndarray,
    views: tuple[np.ndarray, np.ndarray],
    tuning: SurfaceTuning,
    usual: float,
) -> SurfaceMap:
    """The map of cells (C, 3) that images see (cell (S,) sorted, image (S,)); views: centres (N, 3) and focal lengths
    (N,) of all images."""
    centre, focal_px = views
    ray = middle[cell] - centre[image]
    distance = np.linalg.norm(ray, axis=1)
    ray /= distance[:, None]
    images = np.bincount(cell, minlength=len(middle))
    normal = normal_matrices(ray, (focal_px[image] / (tuning.image_px * distance)) ** 2, cell, len(middle))
    least = np.linalg.eigvalsh(normal)[:, 0]
    sigma = np.full(len(middle), np.inf)
    several = (images > 1) & (least > 0)
    sigma[several] = 1 / np.sqrt(least[several])
    start = np.searchsorted(cell, np.arange(len(middle) + 1))
    cosine = [float((ray[a:b] @ ray[a:b].T).min(initial=1.0)) for a, b in zip(start[:-1], start[1:])]
    angle = np.degrees(np.arccos(np.clip(cosine, -1, 1)))
    order = np.lexsort((distance, cell))
    best = np.full(len(middle), -1)
    best[cell[order][::-1]] = image[order][::-1]  # the nearest is written last
    typical = float(np.median(sigma[several])) if several.any() else np.inf
    verdict = np.select(
        [images < 2, images < tuning.least_images, angle < tuning.least_angle_deg, sigma > tuning.worse * typical],
        [1, 2, 3, 4],
        0,
    )
    seen = images > 0
    return SurfaceMap(
        xyz=middle[seen],
        images=images[seen],
        angle_deg=angle[seen],
        sigma=sigma[seen],
        verdict=verdict[seen],
        best=best[seen],
        side=tuning.cell * usual,
    )


def weak_places(surface: SurfaceMap) -> tuple[WeakPlace, ...]:
    """Places to revisit: weak cells that lie side by side, the largest places first."""
    weak = np.flatnonzero(surface.verdict > 0)
    if not len(weak):
        return ()
    near = cKDTree(surface.xyz[weak]).query_pairs(_NEAR * surface.side, output_type="ndarray")
    part = parts(near[:, 0], near[:, 1], len(weak))
    out = []
    for number in np.flatnonzero(np.bincount(part) >= 3):
        cells = weak[part == number]
        verdict = int(np.bincount(surface.verdict[cells]).argmax())
        image = int(np.bincount(surface.best[cells]).argmax())
        out.append(WeakPlace(cells=cells, xyz=surface.xyz[cells].mean(axis=0), verdict=verdict, image=image))
    return tuple(sorted(out, key=lambda p: -len(p.cells)))


@dataclass(frozen=True)
class CoveredSurface:
    """The map, its weak places, and the names of the images, in words and as a table."""

    cells: SurfaceMap
    places: tuple[WeakPlace, ...]
    names: Sequence[str]

    def lines(self) -> tuple[str, ...]:
        """Notes on the map. Lengths in the unit of the model."""
        shares = ", ".join(f"{share:.0f} % {name}" for name, share in self.cells.shares().items())
        places = f"{len(self.places)} weakly covered places" if self.places else "no place is weakly covered"
        finite = self.cells.sigma[np.isfinite(self.cells.sigma)]
        sigma = f"; sigma of a point {np.median(finite):.2g} in the median" if len(finite) else ""
        return (f"surface, {len(self.cells)} cells: {shares}; {places}{sigma}",)

    def table(self) -> dict:
        """{"columns", "rows"} of the weak places, the largest first. Lengths in the unit of the model."""
        rows = []
        for place in self.places:
            sigma = float(np.median(self.cells.sigma[place.cells]))
            rows.append([
                VERDICTS[place.verdict], self.names[place.image], len(place.cells),
                float(f"{len(place.cells) * self.cells.side**2:.3g}"), float(np.median(self.cells.images[place.cells])),
                round(float(np.median(self.cells.angle_deg[place.cells])), 1),
                float(f"{sigma:.2g}") if np.isfinite(sigma) else None,
            ])  # fmt: skip
        columns = ["why", "near image", "cells", "area", "images", "largest angle, degrees", "sigma"]
        return {"columns": columns, "rows": rows}


def surface_png(
    surface: SurfaceMap, places: Sequence[WeakPlace], cam_from_world: np.ndarray, frame: np.ndarray
) -> bytes:
    """PNG of the map; cam_from_world (N, 4, 4) of the images, NaN = no pose, and the frame (N,) of each."""
    plan = levelled(cam_from_world, frame)
    cells = transforms.apply(plan, surface.xyz)
    path = transforms.apply(plan, transforms.centre(cam_from_world))
    figure = Figure(figsize=(11.0, 6.0), dpi=_DPI, layout="constrained")
    axes = figure.add_subplot(aspect="equal")
    shares = surface.shares()
    for k in np.argsort(np.arange(len(VERDICTS)) > 0, kind="stable"):
        own = cells[surface.verdict == k]
        label = f"{VERDICTS[k]} {shares[VERDICTS[k]]:.0f} %"
        axes.scatter(own[:, 0], own[:, 1], s=9, marker="s", color=COLOURS[k], alpha=0.4 if k == 0 else 0.8, label=label)
    axes.plot(path[:, 0], path[:, 1], ".", color="#1b4f8a", markersize=4, label="images")
    for number, place in enumerate(places[:20]):
        x, y, _ = transforms.apply(plan, place.xyz[None])[0]
        box = {"boxstyle": "circle,pad=0.15", "facecolor": "white", "edgecolor": COLOURS[place.verdict]}
        axes.text(x, y, str(number + 1), ha="center", va="center", fontsize=8, bbox=box, clip_on=True)
    shown = np.concatenate([np.percentile(cells[:, :2], _INSIDE, axis=0), path[np.isfinite(path[:, 0]), :2]])
    low, high = shown.min(axis=0), shown.max(axis=0)
    edge = 0.05 * float((high - low).max())
    axes.set_xlim(low[0] - edge, high[0] + edge)
    axes.set_ylim(low[1] - edge, high[1] + edge)
    axes.set_title("The surface from above: by how many images, from which angles, how precisely", fontsize=10,
                   loc="left", color=_INK)  # fmt: skip
    axes.legend(loc="upper left", bbox_to_anchor=(1.0, 1.0), fontsize=8, frameon=False)
    return png(figure)
