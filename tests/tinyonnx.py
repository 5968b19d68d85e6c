"""Small ONNX files without the package onnx: protocol buffers, written field by field."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from typing import Any

import numpy as np

_KINDS = {"f4": 1, "i8": 7}  # TensorProto.DataType


def field(number: int, value: bytes | str | int | float) -> bytes:
    """One field of a protocol buffer."""

    def varint(n: int) -> bytes:
        out = bytearray()
        while n > 127:
            out.append(n & 127 | 128)
            n >>= 7
        return bytes([*out, n])

    if isinstance(value, float):
        return varint(number << 3 | 5) + np.float32(value).tobytes()
    if isinstance(value, int):
        return varint(number << 3) + varint(value % 2**64)
    data = value.encode() if isinstance(value, str) else value
    return varint(number << 3 | 2) + varint(len(data)) + data


def node(kind: str, inputs: str, outputs: str, **attributes: int | Sequence[int]) -> bytes:
    """A node; names are divided by spaces."""
    out = b"".join(field(1, n) for n in inputs.split()) + b"".join(field(2, n) for n in outputs.split())
    for name, value in attributes.items():
        many = not isinstance(value, int)
        values = b"".join(field(8, v) for v in value) if many else field(3, value)
        out += field(5, field(1, name) + values + field(20, 7 if many else 2))
    return field(1, out + field(4, kind))


def model(
    nodes: Sequence[bytes],
    inputs: Mapping[str, tuple[str, Sequence[Any]]],
    outputs: Mapping[str, tuple[str, Sequence[Any]]],
    constants: Mapping[str, np.ndarray] | None = None,
) -> bytes:
    """An ONNX file. Inputs and outputs: name -> (f4 or i8, sizes, a name where they vary)."""

    def value(name: str, kind: str, sizes: Sequence[Any]) -> bytes:
        dims = b"".join(field(1, field(1 if isinstance(n, int) else 2, n)) for n in sizes)
        return field(1, name) + field(2, field(1, field(1, _KINDS[kind]) + field(2, dims)))

    def tensor(name: str, array: np.ndarray) -> bytes:
        sizes = b"".join(field(1, int(n)) for n in array.shape)
        return sizes + field(2, _KINDS[array.dtype.str[1:]]) + field(8, name) + field(9, array.tobytes())

    graph = b"".join(nodes) + field(2, "tiny")
    graph += b"".join(field(5, tensor(n, a)) for n, a in (constants or {}).items())
    graph += b"".join(field(11, value(n, *v)) for n, v in inputs.items())
    graph += b"".join(field(12, value(n, *v)) for n, v in outputs.items())
    return field(1, 8) + field(7, graph) + field(8, field(1, "") + field(2, 17))


def corners(seed: int = 0) -> bytes:
    """A network with the inputs and outputs of COLMAP's files for ALIKED: it finds the local maxima of 9 x 9 pixels
    that are brighter than ``min_score``, and describes each by 128 sums of the 11 x 11 pixels around it."""
    rng = np.random.default_rng(seed)
    kernels = rng.normal(size=(128, 1, 11, 11)).astype(np.float32)
    kernels -= kernels.mean(axis=(2, 3), keepdims=True)
    whole = {n: np.array(v, np.int64) for n, v in {
        "from2": [2], "to4": [4], "columns": [1], "flip": [1, 0], "all": [-1], "first": [0]}.items()}  # fmt: skip
    constants = {"kernels": kernels, "half": np.array(2, np.float32), "one": np.array(1, np.float32), **whole}
    nodes = [
        node("ReduceMean", "image", "grey", axes=[1]),
        node("MaxPool", "grey", "highest", kernel_shape=[9, 9], pads=[4, 4, 4, 4]),
        node("Equal", "grey highest", "peak"),
        node("Greater", "grey min_score", "bright"),
        node("And", "peak bright", "both"),
        node("NonZero", "both", "where"),
        node("Transpose", "where", "at", perm=[1, 0]),
        node("GatherND", "grey at", "values"),
        node("Size", "values", "found"),
        node("Min", "found max_keypoints", "fewer"),
        node("Reshape", "fewer all", "count"),
        node("TopK", "values count", "best order"),
        node("Gather", "at order", "rows"),
        node("Slice", "rows from2 to4 columns", "yx"),
        node("Gather", "yx flip", "xy", axis=1),
        node("Cast", "xy", "place", to=1),
        node("Shape", "image", "shape"),
        node("Slice", "shape from2 to4", "sizes"),
        node("Gather", "sizes flip", "wh"),
        node("Cast", "wh", "side", to=1),
        node("Sub", "side one", "last"),
        node("Mul", "place half", "twice"),
        node("Div", "twice last", "share"),
        node("Sub", "share one", "normal"),
        node("Unsqueeze", "normal first", "keypoints"),
        node("Conv", "grey kernels", "maps", pads=[5, 5, 5, 5]),
        node("Transpose", "maps", "last_maps", perm=[0, 2, 3, 1]),
        node("Slice", "rows first columns columns", "batch"),
        node("Concat", "batch yx", "places", axis=1),
        node("GatherND", "last_maps places", "sums"),
        node("LpNormalization", "sums", "unit", axis=1, p=2),
        node("Unsqueeze", "unit first", "descriptors"),
        node("Unsqueeze", "best first", "scores"),
    ]
    return model(
        nodes,
        {"image": ("f4", (1, 3, "h", "w")), "max_keypoints": ("i8", ()), "min_score": ("f4", ())},
        {"keypoints": ("f4", (1, "k", 2)), "descriptors": ("f4", (1, "k", 128)), "scores": ("f4", (1, "k"))},
        constants,
    )
