"""From points with normals to a surface of triangles: Poisson's, cut to where there are points, and simplified.

Poisson's surface (Kazhdan and Hoppe 2013) is kept as far as points reach, and a little farther where they are sparse or
uncertain.
"""

from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Any

import numpy as np
import pycolmap
from scipy.spatial import cKDTree

from tiegraph.errors import ReconstructionError
from tiegraph.mesh.settings import MeshSettings
from tiegraph.mesh.tuning import SurfaceTuning
from tiegraph.scene.graph import parts
from tiegraph.scene.results import APART_SIGMAS, Cloud
from tiegraph.scene.sorting import order_of, row_numbers, run_starts

MOST_POINTS = 4_000_000
"""Points that the surface is made of at most, which bounds the memory."""
_DEPTHS = (5, 13)  # levels of the octree: 13 are what COLMAP takes at most
_POINT = np.dtype([(name, "<f4") for name in ("x", "y", "z", "nx", "ny", "nz")])
_CORNER = np.dtype([("count", "u1"), ("corners", "<i4", 3)])
_KINDS = {"float": "<f4", "double": "<f8", "uchar": "u1", "int": "<i4"}

Call = Callable[..., Any]
"""A function and its arguments, called where COLMAP may abort: in a child process."""


@dataclass(frozen=True, eq=False)
class Mesh:
    """Triangles: xyz (V, 3) f8 in the world, corners (F, 3) i8 counted counter-clockwise as seen from outside, rgb
    (V, 3) u1."""

    xyz: np.ndarray
    corners: np.ndarray
    rgb: np.ndarray

    @property
    def normals(self) -> np.ndarray:
        """(F, 3) outward, of length one; 0 of a face without an area."""
        across = self.across
        length = np.linalg.norm(across, axis=1, keepdims=True)
        return across / np.where(length > 0, length, 1.0)

    @property
    def across(self) -> np.ndarray:
        """(F, 3) outward normals, as long as twice the area of their face."""
        a, b, c = (self.xyz[self.corners[:, k]] for k in range(3))
        return np.cross(b - a, c - a)

    def of_faces(self, kept: np.ndarray) -> "Mesh":
        """Only the faces that are ``kept`` (F,) bool, and their vertices."""
        corners = self.corners[kept]
        used = np.zeros(len(self.xyz), bool)
        used[corners] = True
        new = np.cumsum(used) - 1
        return Mesh(self.xyz[used], new[corners], self.rgb[used])

    def neighbours(self) -> np.ndarray:
        """(E, 2) pairs of faces that share an edge, each once, sorted."""
        edges = np.sort(self.corners[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2), axis=1)
        order = np.lexsort(edges.T[::-1])
        same = (edges[order][1:] == edges[order][:-1]).all(axis=1)
        face = order // 3
        pairs = np.sort(np.stack([face[:-1][same], face[1:][same]], axis=1), axis=1)
        return np.unique(pairs[pairs[:, 0] != pairs[:, 1]], axis=0)


def trimmed_border(mesh: Mesh, rounds: int) -> tuple[Mesh, np.ndarray]:
    """A mesh without teeth along its border, and which faces (F,) bool it has: faces with two free edges go, so many
    times, then the border's vertices move towards their neighbours along it, as often."""
    kept = np.arange(len(mesh.corners))
    for _ in range(rounds):
        some = mesh.of_faces(np.isin(np.arange(len(mesh.corners)), kept))
        kept = kept[np.bincount(some.neighbours().ravel(), minlength=len(kept)) > 1]
    there = np.isin(np.arange(len(mesh.corners)), kept)
    cut = mesh.of_faces(there)
    edges, count = np.unique(np.sort(cut.corners[:, [0, 1, 1, 2, 2, 0]].reshape(-1, 2)), axis=0, return_counts=True)
    ends = np.concatenate([edges[count == 1], edges[count == 1][:, ::-1]])
    beside = np.bincount(ends[:, 0], minlength=len(cut.xyz))[:, None]
    xyz = cut.xyz
    for _ in range(rounds):
        total = np.zeros_like(xyz)
        np.add.at(total, ends[:, 0], xyz[ends[:, 1]])
        xyz = np.where(beside == 2, 0.5 * xyz + 0.5 * total / np.maximum(beside, 1), xyz)
    return Mesh(xyz, cut.corners, cut.rgb), there


def hanging(mesh: Mesh, doubtful: np.ndarray) -> np.ndarray:
    """(F,) bool, which of the ``doubtful`` faces (F,) bool reach the border of the mesh, each with the doubtful ones
    around it; those in the midst of others do not."""
    pairs = mesh.neighbours()
    piece = pieces(len(doubtful), pairs[doubtful[pairs].all(axis=1)])
    at_border = np.zeros(piece.max(initial=-1) + 1, bool)
    at_border[piece[np.bincount(pairs.ravel(), minlength=len(doubtful)) < 3]] = True
    return np.asarray(doubtful & at_border[piece])


def pieces(count: int, pairs: np.ndarray) -> np.ndarray:
    """(count,) number of the connected piece that each item is of, by pairs (E, 2) of connected ones."""
    return parts(pairs[:, 0], pairs[:, 1], count)


def mesh_of(
    cloud: Cloud, spacing: float, settings: MeshSettings, tuning: SurfaceTuning, scratch: Path, call: Call
) -> Mesh:
    """The surface of a cloud whose points are ``spacing`` apart. ``scratch``: an empty folder; ``call(function,
    *args)`` calls COLMAP. Raises ReconstructionError where no surface comes of the points."""
    there = np.asarray(np.isfinite(cloud.normal).all(axis=1))
    if settings.max_sigma_m is not None:
        there &= ~(cloud.sigma_m > settings.max_sigma_m)
    detail = settings.detail_m or 2 * spacing
    points = thinned(cloud.where(there), detail / 2)
    if len(points) < 10:
        few = "" if settings.max_sigma_m is None else f", or raise --mesh.max-sigma-m ({settings.max_sigma_m:g})"
        raise ReconstructionError(
            f"{len(points)} points of {len(cloud)} have a normal and are sure enough for a surface: look at the cloud "
            f"in the report{few}"
        )
    middle = np.round(points.xyz_m.mean(axis=0))
    whole = call(poisson, replace(points, xyz_m=points.xyz_m - middle), detail, scratch)
    cut = _near(whole, points.xyz_m - middle, points.sigma_m, detail, tuning)
    if not len(cut.corners):
        raise ReconstructionError("no part of the surface lies near the points: look at the normals of the cloud")
    simple = call(simplified, cut, settings.faces, scratch) if len(cut.corners) > settings.faces else cut
    kept = simple.of_faces(without_strays(simple, tuning))
    nearest = cKDTree(points.xyz_m - middle).query(kept.xyz)[1]
    return Mesh(kept.xyz + middle, kept.corners, points.rgb[nearest])


def without_strays(mesh: Mesh, tuning: SurfaceTuning) -> np.ndarray:
    """(F,) bool, False for the faces of small pieces."""
    piece = pieces(len(mesh.corners), mesh.neighbours())
    count = np.bincount(piece)
    return np.asarray(count[piece] >= min(count.max(initial=0), tuning.least_share * len(piece)))


def thinned(cloud: Cloud, spacing: float) -> Cloud:
    """One point in each cell of an edge of ``spacing``, or larger if there are too many: the mean of those in it by
    their sigmas, with the sigma of the best."""
    cell = spacing
    while True:
        number = row_numbers(np.floor(cloud.xyz_m.T / cell).astype(np.int64)) if len(cloud) else np.zeros(0, int)
        order = order_of(number)
        start = run_starts(number[order])
        if len(start) <= MOST_POINTS:
            break
        cell *= 1.2
    if not len(start):
        return cloud
    sigma = np.where(np.isfinite(cloud.sigma_m), np.maximum(cloud.sigma_m, 1e-12), 1.0)[order].astype(float)
    weight = 1 / sigma**2
    total = np.add.reduceat(weight, start)[:, None]

    def mean(values: np.ndarray) -> np.ndarray:
        return np.asarray(np.add.reduceat(weight[:, None] * values[order], start) / total)

    normal = mean(cloud.normal)
    length = np.linalg.norm(normal, axis=1, keepdims=True)
    found = replace(
        cloud.where(order[start]),
        xyz_m=mean(cloud.xyz_m),
        normal=(normal / np.where(length > 0, length, 1.0)).astype(np.float32),
        rgb=np.rint(mean(cloud.rgb)).astype(np.uint8),
        sigma_m=np.minimum.reduceat(cloud.sigma_m[order], start),
    )
    return found.where(length[:, 0] > 0)


def poisson(points: Cloud, detail: float, scratch: Path, send: Any = None) -> Mesh:
    """Poisson's closed surface of points with normals, whose smallest cells have an edge of ``detail`` or less; without
    colours. On one thread, for the result depends on their number."""
    rows = np.zeros(len(points), _POINT)
    for k, name in enumerate("xyz"):
        rows[name], rows[f"n{name}"] = points.xyz_m[:, k], points.normal[:, k]
    head = [f"element vertex {len(rows)}", *(f"property float {name}" for name in _POINT.names or ())]
    source, target = scratch / "points.ply", scratch / "poisson.ply"
    source.write_bytes(_header(head) + rows.tobytes())
    extent = 1.1 * float(np.ptp(points.xyz_m, axis=0).max())  # edge of the octree's cube, of the points'
    options = pycolmap.PoissonMeshingOptions()
    options.depth = int(np.clip(np.ceil(np.log2(max(extent / detail, 1.0))), *_DEPTHS))
    options.trim, options.color, options.num_threads = 0.0, False, 1
    pycolmap.poisson_meshing(source, target, options)
    return read_ply(target)


def simplified(mesh: Mesh, faces: int, scratch: Path, send: Any = None) -> Mesh:
    """A mesh of so many faces at most, by quadric errors (Garland and Heckbert 1997), which keeps its borders."""
    source, target = scratch / "cut.ply", scratch / "simple.ply"
    source.write_bytes(ply_of(mesh, "<f4"))
    options = pycolmap.MeshSimplificationOptions()
    options.target_face_ratio, options.num_threads = faces / len(mesh.corners), 1
    pycolmap.simplify_mesh(source, target, options)
    return read_ply(target)


def _near(mesh: Mesh, xyz: np.ndarray, sigma: np.ndarray, detail: float, tuning: SurfaceTuning) -> Mesh:
    """The faces whose corners all lie near a point, nearer at the border than in gaps."""
    tree = cKDTree(xyz)
    # The sixth neighbour in a square grid lies 1.4 spacings away; what is sparser than eight details is a few strays
    local = np.clip(tree.query(xyz, min(7, len(xyz)))[0][:, -1] / 1.4, detail, 8.0 * detail)
    distance, nearest = tree.query(mesh.xyz)
    reach = np.maximum(tuning.reach * local, APART_SIGMAS * np.nan_to_num(sigma))[nearest]
    there = (distance <= reach)[mesh.corners].all(axis=1)
    far = (distance > tuning.rim * local[nearest])[mesh.corners].any(axis=1)[there]
    cut = mesh.of_faces(there)
    return cut.of_faces(~hanging(cut, far))


def _header(lines: list[str]) -> bytes:
    return "\n".join(["ply", "format binary_little_endian 1.0", *lines, "end_header", ""]).encode("ascii")


def ply_of(mesh: Mesh, kind: str = "<f8", said: tuple[str, ...] = ()) -> bytes:
    """A mesh as a binary PLY file with coordinates of a kind of number and the colours of its vertices; what is
    ``said`` (ASCII) stands in its comments."""
    name = next(n for n, k in _KINDS.items() if k == kind)
    colours = ("red", "green", "blue")
    rows = np.zeros(len(mesh.xyz), [*((c, kind) for c in "xyz"), *((c, "u1") for c in colours)])
    for k in range(3):
        rows["xyz"[k]], rows[colours[k]] = mesh.xyz[:, k], mesh.rgb[:, k]
    faces = np.zeros(len(mesh.corners), _CORNER)
    faces["count"], faces["corners"] = 3, mesh.corners
    lines = [*(f"comment {text}" for text in said), f"element vertex {len(rows)}"]
    lines += [*(f"property {name} {c}" for c in "xyz"), *(f"property uchar {c}" for c in colours)]
    lines += [f"element face {len(faces)}", "property list uchar int vertex_indices"]
    return _header(lines) + rows.tobytes() + faces.tobytes()


def read_ply(path: Path) -> Mesh:
    """The mesh in a binary PLY file of triangles as COLMAP writes it; colours that it lacks are grey."""
    data = path.read_bytes()
    end = data.index(b"end_header\n") + len(b"end_header\n")
    counts: dict[str, int] = {}
    kinds: list[tuple[str, str]] = []
    long = "u1"
    for words in (line.split() for line in data[:end].decode("ascii").splitlines()):
        if words[0] == "element":
            counts[words[1]] = int(words[2])
        elif words[:2] == ["property", "list"]:
            long = _KINDS[words[2]]
        elif words[0] == "property":
            kinds.append((words[2], _KINDS[words[1]]))
    vertex = np.frombuffer(data, np.dtype(kinds), counts["vertex"], end)
    of_face = np.dtype([("count", long), ("corners", "<i4", 3)])
    face = np.frombuffer(data, of_face, counts["face"], end + vertex.nbytes)
    if not (face["count"] == 3).all():
        raise ReconstructionError(f"{path} has faces that are no triangles")
    names = [name for name, _ in kinds]
    rgb = np.full((len(vertex), 3), 128, np.uint8)
    if "red" in names:
        rgb = np.stack([vertex[c] for c in ("red", "green", "blue")], axis=1)
    xyz = np.stack([vertex[c] for c in "xyz"], axis=1).astype(float)
    return Mesh(xyz, face["corners"].astype(np.int64), rgb)
