"""A textured mesh as GLB (glTF 2.0), OBJ with MTL, and PLY with colours at the vertices.

In all of them coordinates are those of the world, for viewers work in single precision; what leads back to the CRS is
said beside them. glTF has y up: its node turns the vertices, which are stored as everywhere else.
"""

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from tiegraph.mesh.surface import Mesh
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
