"""glTF 2.0 and its binary form, GLB: arrays in one buffer, written and read.

glTF has y up. What is written keeps z up, and its node turns it (``turned``).
"""

import json
import struct
from collections.abc import Sequence

import numpy as np

ARRAY, ELEMENTS = 34962, 34963  # what a view is for: attributes of vertices, their order
_NUMBERS = {"f4": 5126, "u4": 5125, "u2": 5123, "u1": 5121}
_KINDS = {1: "SCALAR", 2: "VEC2", 3: "VEC3", 4: "VEC4"}
_SHADES = np.arange(256) / 255
_LINEAR = np.where(_SHADES <= 0.04045, _SHADES / 12.92, ((_SHADES + 0.055) / 1.055) ** 2.4)  # sRGB (IEC 61966-2-1)


class Arrays:
    """The one buffer of a glTF file, and what lies in it."""

    def __init__(self) -> None:
        self.views: list[dict] = []
        self.accessors: list[dict] = []
        self.blobs: list[bytes] = []

    def view(self, data: bytes, **more: int) -> int:
        """Put bytes into the buffer; the number of their view."""
        offset = sum(len(b) for b in self.blobs)
        self.views.append({"buffer": 0, "byteOffset": offset, "byteLength": len(data), **more})
        self.blobs.append(data + bytes(-len(data) % 4))
        return len(self.views) - 1

    def add(self, values: np.ndarray, target: int = ARRAY, **more: object) -> int:
        """Put values (N,) or (N, 2 ... 4) of f4, u4, u2 or u1 into the buffer; the number of their accessor."""
        kind = _KINDS[1 if values.ndim == 1 else values.shape[1]]
        number = _NUMBERS[values.dtype.str[1:]]
        where = self.view(np.ascontiguousarray(values).tobytes(), target=target)
        said = {"bufferView": where, "componentType": number, "count": len(values), "type": kind, **more}
        self.accessors.append(said)
        return len(self.accessors) - 1

    def places(self, xyz: np.ndarray) -> int:
        """Put places (N, 3) f4 into the buffer with the box around them; the number of their accessor."""
        return self.add(xyz, min=xyz.min(axis=0).tolist(), max=xyz.max(axis=0).tolist())

    def described(self, uri: str = "") -> dict:
        """The parts of a glTF file that say what is where; ``uri``: of the buffer's own file."""
        size = sum(len(b) for b in self.blobs)
        buffer = {"byteLength": size, **({"uri": uri} if uri else {})}
        return {"accessors": self.accessors, "bufferViews": self.views, "buffers": [buffer]}


def document(primitives: list[dict], middle: Sequence[float], **asset: dict) -> dict:
    """What is common to all files: one mesh, stored with z up about a ``middle`` (3,), in its own light; ``asset``:
    more to be said of the file."""
    return {
        "asset": {"version": "2.0", "generator": "tiegraph", **asset},
        "extensionsUsed": ["KHR_materials_unlit"],
        "scene": 0,
        "scenes": [{"nodes": [0]}],
        "nodes": [{"mesh": 0, "matrix": turned(middle)}],
        "meshes": [{"primitives": primitives}],
    }


def unlit(**look: object) -> dict:
    """A material of that look whose colours have their light in them already."""
    rough = {**look, "metallicFactor": 0.0, "roughnessFactor": 1.0}
    return {"pbrMetallicRoughness": rough, "doubleSided": True, "extensions": {"KHR_materials_unlit": {}}}


def turned(middle: Sequence[float]) -> list[float]:
    """The matrix of a node, column by column: (x, y, z) about a ``middle`` (3,) with z up becomes (x, z, -y)."""
    x, y, z = middle
    return [1, 0, 0, 0, 0, 0, -1, 0, 0, 1, 0, 0, x, z, -y, 1]


def linear(rgb: np.ndarray) -> np.ndarray:
    """(N, 4) u2 colours of vertices as glTF has them, in proportion to light and opaque, of sRGB (N, 3) u1."""
    shades = np.rint(65535 * _LINEAR).astype(np.uint16)[rgb]
    return np.column_stack([shades, np.full(len(rgb), 65535, np.uint16)])


def glb(said: dict, arrays: Arrays) -> bytes:
    """A GLB file of a document and its arrays."""
    text = json.dumps({**said, **arrays.described()}).encode()
    text += b" " * (-len(text) % 4)
    body = b"".join(arrays.blobs)
    head = struct.pack("<4sII", b"glTF", 2, 28 + len(text) + len(body))
    return b"".join(
        [head, struct.pack("<I4s", len(text), b"JSON"), text, struct.pack("<I4s", len(body), b"BIN\0"), body]
    )


def read_glb(data: bytes) -> tuple[dict, bytes]:
    """The document of a GLB file, and its buffer."""
    long = struct.unpack_from("<I", data, 12)[0]
    return json.loads(data[20 : 20 + long]), data[28 + long :]


def values_of(said: dict, body: bytes, number: int) -> np.ndarray:
    """The values (N, K) of an accessor of a document with its buffer, as ``Arrays`` puts them there."""
    one = said["accessors"][number]
    kind = next(k for k, n in _NUMBERS.items() if n == one["componentType"])
    wide = next(k for k, n in _KINDS.items() if n == one["type"])
    start = said["bufferViews"][one["bufferView"]]["byteOffset"]
    return np.frombuffer(body, f"<{kind}", one["count"] * wide, start).reshape(-1, wide)
