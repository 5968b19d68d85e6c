"""3D Tiles 1.1 (OGC 22-025r4): a tree of GLB files that a viewer loads as far as it needs them.

Coordinates are metres east, north and up about a place, exactly, each point by itself; the matrix of the tree leads
from there to ECEF. A file counts from the middle of its points, so that single precision holds tenths of a millimetre
over kilometres; the middle is in its node. Of a world that is not on the Earth coordinates and axes stay.
"""

import json
from collections.abc import Iterable
from dataclasses import dataclass, field
from pathlib import Path

import numpy as np

from tiegraph.errors import InputError
from tiegraph.geometry.geodesy import ENU, Origin, ecef_from_enu, geodetic_from_world, world_from_geodetic
from tiegraph.scene import gltf
from tiegraph.scene.copc import Node

FILE = "tileset.json"


@dataclass(frozen=True)
class Place:
    """Where the tiles of a world are: about ``middle``, with the matrix of the tree (None = the world is not on the
    Earth)."""

    origin: Origin | None
    middle: Origin | None = None

    @staticmethod
    def about(xyz: np.ndarray, origin: Origin | None) -> "Place":
        """About a place (3,) of the world."""
        if origin is None:
            return Place(None)
        lat, lon, height = (float(v) for v in geodetic_from_world(xyz[None], origin)[0])
        return Place(origin, Origin(lat_deg=lat, lon_deg=lon, height_m=height, crs=ENU))

    def tiles_from_world(self, xyz: np.ndarray) -> np.ndarray:
        """(N, 3) east, north, up of places (N, 3) of the world."""
        if self.origin is None or self.middle is None:
            return np.asarray(xyz, float)
        return world_from_geodetic(geodetic_from_world(xyz, self.origin), self.middle)

    @property
    def matrix(self) -> dict:
        """The member of the tree's root that leads to ECEF, column by column."""
        return {} if self.middle is None else {"transform": ecef_from_enu(self.middle).T.ravel().tolist()}


@dataclass
class Tile:
    """A tile of the tree: its file, the box (3,), (3,) of all that is in it and below it, how far off (metres) the
    picture is without the tiles below, and these."""

    uri: str
    low: np.ndarray
    high: np.ndarray
    error: float
    below: "list[Tile]" = field(default_factory=list)

    def closed(self) -> dict:
        """The tile as JSON, with its box widened to those below."""
        below = [tile.closed() for tile in self.below]
        self.low = np.min([self.low, *(tile.low for tile in self.below)], axis=0)
        self.high = np.max([self.high, *(tile.high for tile in self.below)], axis=0)
        middle, half = (self.low + self.high) / 2, (self.high - self.low) / 2
        return {
            "boundingVolume": {"box": [*middle.tolist(), *np.diag(half).ravel().tolist()]},
            "geometricError": self.error if below else 0.0,
            "content": {"uri": self.uri},
            **({"children": below} if below else {}),
        }


def write_tree(root: Tile, place: Place, refine: str, folder: Path) -> None:
    """Write ``tileset.json``. ``refine``: whether tiles below ADD to a tile or REPLACE it."""
    tree = root.closed()
    whole = float(np.linalg.norm(root.high - root.low))  # without any tile
    said = {
        "asset": {"version": "1.1", "generator": "tiegraph"},
        "geometricError": max(whole, 2 * root.error),
        "root": {**place.matrix, "refine": refine, **tree},
    }
    (folder / FILE).write_text(json.dumps(said, allow_nan=False), encoding="utf-8")


def write_points(nodes: Iterable[Node], place: Place, folder: Path) -> int:
    """Write the nodes of a cloud, parents first, as tiles with their tree into a new folder; how many points they have.
    Memory is that of one node, and of the tree. Raises InputError for a cloud without a point."""
    tiles: dict[tuple[int, ...], Tile] = {}
    count = 0
    folder.mkdir()
    for node in nodes:
        level, *key = node.key
        name = "-".join(str(k) for k in node.key) + ".glb"
        xyz = place.tiles_from_world(node.cloud.xyz_m)
        data, low, high = points_glb(xyz, node.cloud.rgb)
        (folder / name).write_bytes(data)
        around = node.spacing / 2  # what a point stands for; and no box without a width
        # Four spacings are a tile's error: CesiumJS lets 16 px of it pass, as of entwine's tiles
        tile = Tile(uri=name, low=low - around, high=high + around, error=4.0 * node.spacing)
        if level:
            tiles[(level - 1, *(k // 2 for k in key))].below.append(tile)
        tiles[node.key] = tile
        count += len(xyz)
    if not tiles:
        raise InputError("the cloud has no point: look at the depth maps in the report")
    write_tree(tiles[(0, 0, 0, 0)], place, "ADD", folder)
    return count


def points_glb(xyz: np.ndarray, rgb: np.ndarray) -> tuple[bytes, np.ndarray, np.ndarray]:
    """Points (N, 3) with colours (N, 3) u1 as GLB about their middle; the corners (3,) of the box around them."""
    middle = (xyz.min(axis=0) + xyz.max(axis=0)) / 2
    arrays, local = gltf.Arrays(), (xyz - middle).astype("<f4")
    attributes = {"POSITION": arrays.places(local), "COLOR_0": arrays.add(gltf.linear(rgb), normalized=True)}
    said = gltf.document([{"attributes": attributes, "mode": 0, "material": 0}], middle.tolist())
    data = gltf.glb({**said, "materials": [gltf.unlit()]}, arrays)
    return data, local.min(axis=0) + middle, local.max(axis=0) + middle
