"""Control points as files: OpenDroneMap's ``gcp_list.txt``, or a CSV, which keeps sigmas and points without marks."""

from collections.abc import Sequence

from tiegraph.errors import InputError
from tiegraph.scene.gcp import FileMark, GcpFile
from tiegraph.text import csv_text


def odm_text(file: GcpFile, crs: str, marks: Sequence[FileMark]) -> str:
    """A gcp_list.txt: a row a mark, check points with the word ``check``. Raises InputError for names with blanks."""
    rows = [crs]
    points = {p.name: p for p in file.points}
    for mark in marks:
        point = points[mark.name]
        bad = next((n for n in (mark.name, mark.image) if not n or len(n.split()) != 1), None)
        if bad is not None:
            raise InputError(f"{bad!r} has blanks, which a gcp_list.txt cannot hold: give -o a name that ends in .csv")
        x, y, z = (point.xyz[k] for k in ((1, 0, 2) if file.geographic else (0, 1, 2)))
        place = f"{x:.10g} {y:.10g} {z:.6g}" if file.geographic else f"{x:.4f} {y:.4f} {z:.4f}"
        role = " check" if point.check else ""
        rows.append(f"{place} {mark.xy[0]:.3f} {mark.xy[1]:.3f} {mark.image} {mark.name}{role}")
    return "\n".join(rows) + "\n"


def gcp_csv(file: GcpFile, crs: str, marks: Sequence[FileMark]) -> str:
    """A CSV with a table of points and a table of marks."""
    heads = ["name", *(("lat", "lon", "height") if file.geographic else "xyz"), "sigma_xy", "sigma_z", "role"]
    points = (
        [p.name, *(repr(v) for v in p.xyz), p.sigma_m[0], p.sigma_m[2], "check" if p.check else "gcp"]
        for p in file.points
    )
    placed = ([m.name, m.image, f"{m.xy[0]:.3f}", f"{m.xy[1]:.3f}"] for m in marks)
    return f"# crs: {crs}\n{csv_text(heads, points)}{csv_text(['name', 'image', 'px', 'py'], placed)}"
