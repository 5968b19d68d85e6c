"""A textured mesh as GLB (glTF 2.0), OBJ with MTL, and PLY with colours at the vertices.

In all of them coordinates are those of the world, for viewers work in single precision; what leads back to the CRS is
said beside them. glTF has y up: its node turns the vertices, which are stored as everywhere else.

It is also cut into levels of detail: its faces are quartered until few are left together. Those have the textures, cut
out of the whole ones; what stands for four quarters is simplified from all their faces, which keeps its borders, and
has the colours of its vertices.
"""

from collections.abc import Callable, Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

import cv2
import numpy as np
from scipy.spatial import cKDTree

from tiegraph.mesh.surface import Call, Mesh, pieces, read_ply, simplified
from tiegraph.mesh.texture import JPEG, PAD, pack
from tiegraph.scene import gltf

_AT_ONCE = 200_000  # lines of text made together


@dataclass(frozen=True, eq=False)
class Textured:
    """A mesh with textures: place (F, 3, 2) of the corners of faces on their texture, in pixels from its upper left
    corner; texture (F,) of each face; pages (T, 2) width and height of the textures."""

    mesh: Mesh
    place: np.ndarray
    texture: np.ndarray
    pages: np.ndarray

    def shares(self) -> np.ndarray:
        """(F, 3, 2) places as shares of their texture's width and height, 0 = the left and the upper edge."""
        return np.asarray(self.place / self.pages[self.texture][:, None])


def glb(textured: Textured, pictures: Sequence[bytes], said: dict, middle: Sequence[float] = (0, 0, 0)) -> bytes:
    """A GLB file with its textures (JPEG), which counts from a ``middle`` (3,); what is ``said`` stands in its
    ``extras``."""
    arrays, shares, primitives = gltf.Arrays(), textured.shares(), []
    for k in range(len(textured.pages)):
        xyz, uv, corners = _single(textured.mesh, shares, textured.texture == k)
        if len(corners):
            attributes = {"POSITION": arrays.places(xyz), "TEXCOORD_0": arrays.add(uv)}
            indices = arrays.add(corners.ravel(), gltf.ELEMENTS)
            primitives.append({"attributes": attributes, "indices": indices, "material": k})
    images = [{"bufferView": arrays.view(p), "mimeType": "image/jpeg"} for p in pictures]
    looks = {
        "materials": [gltf.unlit(baseColorTexture={"index": k}) for k in range(len(images))],
        "textures": [{"source": k, "sampler": 0} for k in range(len(images))],
        "images": images,
        "samplers": [{"wrapS": 33071, "wrapT": 33071}],
    }
    return gltf.glb({**gltf.document(primitives, middle, extras=said), **looks}, arrays)


def _single(mesh: Mesh, shares: np.ndarray, own: np.ndarray) -> tuple[np.ndarray, np.ndarray, np.ndarray]:
    """xyz (N, 3) f4, places (N, 2) f4 and corners (F, 3) u4 of some faces, whose vertices have one place each."""
    vertex, place = mesh.corners[own].ravel(), shares[own].reshape(-1, 2).astype(np.float32)
    key = np.zeros(len(vertex), [("vertex", "<i8"), ("place", "<f4", 2)])
    key["vertex"], key["place"] = vertex, place
    whole = np.ascontiguousarray(key).view(f"V{key.dtype.itemsize}")
    _, first, back = np.unique(whole, return_index=True, return_inverse=True)
    corners = back.reshape(-1, 3).astype("<u4")
    return mesh.xyz[vertex[first]].astype("<f4"), place[first].astype("<f4"), corners


def obj(textured: Textured, materials: str, decimals: int, said: Sequence[str]) -> Iterator[bytes]:
    """The text of an OBJ file in parts; ``materials``: the name of its MTL file; ``decimals`` of its coordinates."""
    yield "".join(f"# {line}\n" for line in said).encode() + f"mtllib {materials}\n".encode()
    mesh, shares = textured.mesh, textured.shares()
    yield from _lines(f"v %.{decimals}f %.{decimals}f %.{decimals}f\n", mesh.xyz)
    flat = shares.reshape(-1, 2)
    place, number = np.unique(flat, axis=0, return_inverse=True)
    yield from _lines("vt %.7f %.7f\n", np.stack([place[:, 0], 1 - place[:, 1]], axis=1))  # v counts from below
    number = number.reshape(-1, 3) + 1
    for k in range(len(textured.pages)):
        own = textured.texture == k
        yield f"usemtl texture{k}\n".encode()
        pairs = np.stack([mesh.corners[own] + 1, number[own]], axis=2).reshape(-1, 6)
        yield from _lines("f %d/%d %d/%d %d/%d\n", pairs)


def _lines(form: str, rows: np.ndarray) -> Iterator[bytes]:
    for k in range(0, len(rows), _AT_ONCE):
        some = rows[k : k + _AT_ONCE]
        yield ((form * len(some)) % tuple(some.ravel().tolist())).encode()


def mtl(textures: Sequence[str]) -> str:
    """The text of an MTL file of materials ``texture0``, ... with the names of their pictures."""
    lines = [
        f"newmtl texture{k}\nKa 1 1 1\nKd 1 1 1\nKs 0 0 0\nillum 0\nmap_Kd {name}\n" for k, name in enumerate(textures)
    ]
    return "\n".join(lines)


MOST = 50_000
"""Faces of a piece: a megabyte or two without its texture."""


@dataclass(frozen=True, eq=False)
class Finished:
    """A textured mesh, the ``island`` (F,) of each face, which is connected on the textures too, and these (BGR u1)."""

    textured: Textured
    island: np.ndarray
    pictures: list[np.ndarray]

    @property
    def mesh(self) -> Mesh:
        """The mesh, with the colours of its vertices."""
        return self.textured.mesh

    @staticmethod
    def read(data: bytes, coloured: Path) -> "Finished":
        """From what ``glb`` wrote, and the same mesh as PLY. Raises ValueError if it is another one."""
        said, body = gltf.read_glb(data)
        whole, xyz, uv, corners, texture = read_ply(coloured), [], [], [], []
        for one in said["meshes"][0]["primitives"]:
            corners.append(gltf.values_of(said, body, one["indices"]).reshape(-1, 3).astype(int) + sum(map(len, xyz)))
            xyz.append(gltf.values_of(said, body, one["attributes"]["POSITION"]))
            uv.append(gltf.values_of(said, body, one["attributes"]["TEXCOORD_0"]))
            texture.append(np.full(len(corners[-1]), one["material"]))
        corner, own = np.concatenate(corners), np.concatenate(xyz)
        _, first, back = np.unique(np.concatenate([whole.xyz.astype("<f4"), own]), axis=0, return_index=True,
                                   return_inverse=True)  # fmt: skip
        vertex = first[back.ravel()[len(whole.xyz) :]]
        if (vertex >= len(whole.xyz)).any():
            raise ValueError(f"{coloured.name} is not of the same mesh")
        views = [said["bufferViews"][image["bufferView"]] for image in said["images"]]
        blobs = [np.frombuffer(body, np.uint8, v["byteLength"], v["byteOffset"]) for v in views]
        pictures = [np.asarray(cv2.imdecode(blob, cv2.IMREAD_COLOR)) for blob in blobs]
        pages, page = np.array([p.shape[1::-1] for p in pictures]), np.concatenate(texture)
        place = np.concatenate(uv)[corner].astype(float) * pages[page][:, None]
        island = pieces(len(own), corner[:, [0, 1, 1, 2]].reshape(-1, 2))[corner[:, 0]]
        mesh = Mesh(whole.xyz, vertex[corner], whole.rgb)
        return Finished(Textured(mesh, place=place, texture=page, pages=pages), island, pictures)

    def moved(self, function: Callable[[np.ndarray], np.ndarray]) -> "Finished":
        """With its vertices (N, 3) elsewhere."""
        there = Mesh(function(self.mesh.xyz), self.mesh.corners, self.mesh.rgb)
        return replace(self, textured=replace(self.textured, mesh=there))


@dataclass(frozen=True, eq=False)
class Piece:
    """Some faces as GLB, the corners (3,) of the box around them, and the length that their colours resolve."""

    glb: bytes
    low: np.ndarray
    high: np.ndarray
    error: float


def branches(whole: Finished, faces: np.ndarray) -> list[np.ndarray]:
    """The quarters of some faces (N,), each together in space; none if they are few enough."""
    if len(faces) <= MOST:
        return []
    return [quarter for half in _halves(whole.mesh, faces) for quarter in _halves(whole.mesh, half)]


def _halves(mesh: Mesh, faces: np.ndarray) -> list[np.ndarray]:
    middle = mesh.xyz[mesh.corners[faces]].mean(axis=1)
    order = np.argsort(middle[:, np.ptp(middle, axis=0).argmax()], kind="stable")
    return [np.sort(faces[part]) for part in np.array_split(order, 2)]


def coarse(whole: Finished, faces: np.ndarray, scratch: Path, call: Call) -> Piece:
    """What stands for some faces (N,). ``scratch``: an empty folder; ``call(function, *args)`` calls COLMAP."""
    own, middle = _about_middle(whole.mesh, faces)
    simple = call(simplified, own, MOST, scratch)
    rgb = own.rgb[cKDTree(own.xyz).query(simple.xyz)[1]]
    arrays, xyz = gltf.Arrays(), simple.xyz.astype("<f4")
    attributes = {"POSITION": arrays.places(xyz), "COLOR_0": arrays.add(gltf.linear(rgb), normalized=True)}
    indices = arrays.add(simple.corners.astype("<u4").ravel(), gltf.ELEMENTS)
    said = gltf.document([{"attributes": attributes, "indices": indices, "material": 0}], middle.tolist())
    error = float(np.sqrt(np.linalg.norm(own.across, axis=1).sum() / MOST))  # an edge, were they all equal
    return _piece(gltf.glb({**said, "materials": [gltf.unlit()]}, arrays), xyz, middle, error)


def fine(whole: Finished, faces: np.ndarray) -> Piece:
    """Some faces (N,), with their parts of the textures."""
    own, middle = _about_middle(whole.mesh, faces)
    place, pictures = whole.textured.place[faces], whole.pictures
    kept, number = np.unique(whole.island[faces], return_inverse=True)
    low, high = np.full((len(kept), 2), np.inf), np.full((len(kept), 2), -np.inf)
    np.minimum.at(low, number, place.min(axis=1))
    np.maximum.at(high, number, place.max(axis=1))
    source = np.zeros(len(kept), int)
    source[number] = whole.textured.texture[faces]
    low = np.maximum(np.floor(low).astype(int) - PAD, 0)
    high = np.minimum(np.ceil(high).astype(int) + PAD, whole.textured.pages[source])
    page, at, pages = pack(high - low, 8192)  # pixels of a texture's edge at most, which graphics cards take
    drawn = [np.full((size[1], size[0], 3), 128, np.uint8) for size in pages]
    for k, (a, b) in enumerate(zip(low, high)):
        x, y = at[k]
        drawn[page[k]][y : y + b[1] - a[1], x : x + b[0] - a[0]] = pictures[source[k]][a[1] : b[1], a[0] : b[0]]
    textured = Textured(own, place=place + (at - low)[number][:, None], texture=page[number], pages=pages)
    jpeg = [cv2.imencode(".jpg", d, JPEG)[1].tobytes() for d in drawn]
    return _piece(glb(textured, jpeg, {}, middle=middle.tolist()), own.xyz.astype("<f4"), middle, 0.0)


def _about_middle(mesh: Mesh, faces: np.ndarray) -> tuple[Mesh, np.ndarray]:
    """Some faces, in their order, about the middle (3,) of their box."""
    there = np.zeros(len(mesh.corners), bool)
    there[faces] = True
    own = mesh.of_faces(there)
    middle = (own.xyz.min(axis=0) + own.xyz.max(axis=0)) / 2
    return Mesh(own.xyz - middle, own.corners, own.rgb), middle


def _piece(data: bytes, xyz: np.ndarray, middle: np.ndarray, error: float) -> Piece:
    return Piece(glb=data, low=xyz.min(axis=0) + middle, high=xyz.max(axis=0) + middle, error=error)
