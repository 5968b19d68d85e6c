"""Points, lines and polygons of GIS: GeoJSON features, the layers of a GeoPackage, which GDAL (pyogrio) writes from
them, their styles, and lines and polygons from files."""

import io
import json
from collections.abc import Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import numpy as np

from tiegraph.errors import InputError, optional
from tiegraph.scene.cells import number

Layer = list[dict[str, Any]]
_WRITTEN = "1970-01-01T00:00:00.000Z"  # the date in a GeoPackage: the same data, the same bytes


def feature(kind: str, coordinates: np.ndarray, said: dict[str, Any]) -> dict[str, Any]:
    """A GeoJSON feature of a kind (Point, LineString, Polygon) with its coordinates (..., 2 or 3) and properties."""
    shape = {"type": kind, "coordinates": coordinates.tolist()}
    return {"type": "Feature", "geometry": shape, "properties": said}


def collection(features: Layer) -> str:
    """The text of a GeoJSON file."""
    return json.dumps({"type": "FeatureCollection", "features": features}, allow_nan=False)


def gdal(what: str, instead: str) -> Any:
    """pyogrio's functions. Raises EngineMissing, which says that ``what`` needs them and what to do ``instead``."""
    pyogrio = optional("pyogrio", "gis", what, instead=instead and f"; {instead}")
    pyogrio.set_gdal_config_options({"OGR_CURRENT_DATE": _WRITTEN})
    return pyogrio.raw


def write_layer(raw: Any, path: Path, name: str, features: Layer, crs: str) -> None:
    """Add a layer of features in a CRS to a GeoPackage, which is made if it is not there; ``raw``: of ``gdal``."""
    meta, _, shapes, columns = raw.read(collection(features).encode())
    kind = {"layer": name, "geometry_type": meta["geometry_type"], "crs": crs}
    raw.write(path, shapes, columns, meta["fields"], driver="GPKG", append=path.exists(), **kind)


@dataclass(frozen=True)
class Shapes:
    """Lines or outer rings of polygons of a file, (N, 2) east and north each (degrees: longitude and latitude), or
    (N, 3) with heights, and the CRS that it names, if any."""

    parts: list[np.ndarray]
    crs: str | None


_WANTED = {"line": ("LineString", "MultiLineString"), "polygon": ("Polygon", "MultiPolygon")}


def read_shapes(path: Path, kind: str, axes: int = 2) -> Shapes:
    """The lines or polygons (``kind``: line, polygon) of a file: GeoJSON, a CSV of east and north, and what else GDAL
    reads. ``axes``: 3 keeps the heights of GeoJSON and of GDAL's files. Raises InputError for a file that has none or
    cannot be read, EngineMissing where it needs pyogrio."""
    if not path.is_file():
        raise InputError(f"{path} is no file")
    ending = path.suffix.lower()
    try:
        if ending in (".csv", ".txt"):
            parts, crs = [_table(path)], None
        elif ending in (".geojson", ".json"):
            data = json.loads(path.read_text(encoding="utf-8"))
            named = (data.get("crs") or {}).get("properties", {})  # in older GeoJSON; by RFC 7946 it is WGS84
            parts, crs = _parts(data, kind, axes), str(named.get("name", "OGC:CRS84"))
        else:
            parts, crs = _by_gdal(path, kind, axes)
    except (OSError, ValueError, LookupError, TypeError, AttributeError, RuntimeError) as error:
        raise InputError(f"{path} cannot be read as a {kind}: {error}") from error
    least = 2 if kind == "line" else 3
    if not parts or any(len(p) < least or not np.isfinite(p).all() for p in parts):
        raise InputError(f"{path} has no {kind} of {least} vertices or more")
    return Shapes(parts, crs)


def _table(path: Path) -> np.ndarray:
    rows = [line.replace(";", ",").split(",") for line in path.read_text(encoding="utf-8").splitlines()]
    first = 0 if np.isfinite(number(rows[0][0])) else 1  # a row of names
    return _open(np.array([[float(v) for v in row[:2]] for row in rows[first:] if "".join(row).strip()]))


def _open(vertices: np.ndarray) -> np.ndarray:
    """Without repeated vertices, and without the repeated first one at the end of a ring of three."""
    kept = vertices[np.r_[True, np.any(np.diff(vertices, axis=0) != 0, axis=1)]]
    return kept[:-1] if len(kept) > 3 and (kept[0] == kept[-1]).all() else kept


def _parts(data: dict[str, Any], kind: str, axes: int) -> list[np.ndarray]:
    features = data["features"] if data.get("type") == "FeatureCollection" else [data]
    out = []
    for shape in (f.get("geometry", f) for f in features):
        if shape is None:
            continue
        if kind == "polygon" and shape["type"] == "LineString" and shape["coordinates"][0] == shape["coordinates"][-1]:
            shape = {"type": "Polygon", "coordinates": [shape["coordinates"]]}  # as CAD has it
        if shape["type"] not in _WANTED[kind]:
            continue
        each = shape["coordinates"] if shape["type"].startswith("Multi") else [shape["coordinates"]]
        if kind == "polygon":
            if any(len(rings) > 1 for rings in each):
                raise InputError("a polygon with a hole is not accepted: cut it in two")
            each = [rings[0] for rings in each]
        found = [np.array([c[:axes] for c in part], float).reshape(-1, axes) for part in each]
        out += found if kind == "line" else [_open(p) for p in found]
    return out


def _by_gdal(path: Path, kind: str, axes: int) -> tuple[list[np.ndarray], str | None]:
    raw = gdal(str(path), "or save it as GeoJSON, or as a CSV of east and north")
    meta, _, shapes, _ = raw.read(path, layer=0, columns=[])
    text = io.BytesIO()
    given = meta["crs"] or "EPSG:4326"  # any, without which pyogrio warns; coordinates stay unchanged
    raw.write(text, shapes, [], [], driver="GeoJSON", geometry_type=meta["geometry_type"], crs=given)
    return _parts(json.loads(text.getvalue()), kind, axes), meta["crs"]


_PAGE = """<!DOCTYPE qgis PUBLIC 'http://mrcc.com/qgis.dtd' 'SYSTEM'>
<qgis version="3.22.0" styleCategories="Symbology">
 <renderer-v2 type="singleSymbol" symbollevels="0" enableorderby="0" forceraster="0">
  <symbols>
   <symbol type="{kind}" name="0" alpha="{alpha}" clip_to_extent="1" force_rhr="0">
    <layer class="{drawn}" enabled="1" pass="0" locked="0">
     <Option type="Map">
{options}
     </Option>
     <data_defined_properties>
      <Option type="Map">
       <Option type="QString" name="name" value=""/>
       {properties}
       <Option type="QString" name="type" value="collection"/>
      </Option>
     </data_defined_properties>
    </layer>
   </symbol>
  </symbols>
 </renderer-v2>
</qgis>
"""
_BY_EXPRESSION = 3  # QgsProperty: an expression


def style(drawn: str, alpha: float, options: dict[str, str], by: tuple[str, str] | None = None) -> str:
    """A style of one symbol; ``by``: the property that an expression over the fields sets."""
    lines = "\n".join(f'      <Option type="QString" name="{k}" value="{v}"/>' for k, v in options.items())
    properties = '<Option name="properties"/>'
    if by is not None:
        inner = '<Option type="bool" name="active" value="true"/>'
        inner += f'<Option type="QString" name="expression" value="{by[1]}"/>'
        inner += f'<Option type="int" name="type" value="{_BY_EXPRESSION}"/>'
        properties = f'<Option type="Map" name="properties"><Option type="Map" name="{by[0]}">{inner}</Option></Option>'
    kind = drawn.removeprefix("Simple").lower()
    return _PAGE.format(kind=kind, alpha=alpha, drawn=drawn, options=lines, properties=properties)


def write_styles(raw: Any, path: Path, styles: Mapping[str, str]) -> None:
    """Add the styles of layers, by the names of these, to a GeoPackage that has them; ``raw``: of ``vectors.gdal``."""
    columns = ("f_table_catalog", "f_table_schema", "f_table_name", "f_geometry_column", "styleName", "styleQML",
               "styleSLD", "useAsDefault", "description", "owner")  # fmt: skip
    rows = [("", "", name, "geom", name, text, "", True, "tiegraph", "") for name, text in styles.items()]
    values = [np.array(column, bool if column[0] is True else object) for column in zip(*rows)]
    how = {"layer": "layer_styles", "geometry_type": None, "crs": None}
    raw.write(path, None, values, [*columns], driver="GPKG", append=True, **how)
