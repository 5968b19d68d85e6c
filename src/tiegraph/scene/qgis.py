"""Styles of vector layers that QGIS reads from a GeoPackage automatically.

The table ``layer_styles`` is QGIS's own: a layer with a row there, marked as default, is drawn in that style when
opened.
"""

from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

import numpy as np

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
    kind = "marker" if drawn == "SimpleMarker" else "line"
    return _PAGE.format(kind=kind, alpha=alpha, drawn=drawn, options=lines, properties=properties)


def write_styles(raw: Any, path: Path, styles: Mapping[str, str]) -> None:
    """Add the styles of layers, by the names of these, to a GeoPackage that has them; ``raw``: of ``vectors.gdal``."""
    columns: dict[str, np.ndarray] = {
        "f_table_catalog": _texts("" for _ in styles),
        "f_table_schema": _texts("" for _ in styles),
        "f_table_name": _texts(styles),
        "f_geometry_column": _texts("geom" for _ in styles),
        "styleName": _texts(styles),
        "styleQML": _texts(styles.values()),
        "styleSLD": _texts("" for _ in styles),
        "useAsDefault": np.ones(len(styles), bool),
        "description": _texts("tiegraph" for _ in styles),
        "owner": _texts("" for _ in styles),
    }
    how = {"layer": "layer_styles", "geometry_type": None, "crs": None}
    raw.write(path, None, [*columns.values()], [*columns], driver="GPKG", append=True, **how)


def _texts(values: Iterable[str]) -> np.ndarray:
    return np.array(list(values), object)
