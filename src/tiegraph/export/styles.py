"""How QGIS draws the layers of a map: arrows by heading, lines of sight, ties as wide as their matches are many."""

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


def _style(drawn: str, alpha: float, options: dict[str, str], by: tuple[str, str] | None = None) -> str:
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


_MM = {"size_unit": "MM"}
STYLES = {
    "cameras": _style(
        "SimpleMarker",
        1.0,
        {"name": "arrow", "color": "27,108,168,255", "outline_color": "255,255,255,255", "size": "4", **_MM},
        by=("angle", "&quot;heading_deg&quot;"),
    ),
    "views": _style("SimpleLine", 0.5, {"line_color": "27,108,168,255", "line_width": "0.15", "line_width_unit": "MM"}),
    "ties": _style(
        "SimpleLine",
        0.6,
        {"line_color": "242,166,90,255", "line_width": "0.3", "line_width_unit": "MM"},
        by=("outlineWidth", "min(1.5, 0.1 + &quot;matches&quot; / 400.0)"),
    ),
}
