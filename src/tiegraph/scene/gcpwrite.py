"""Control points as files: OpenDroneMap's ``gcp_list.txt``, or a CSV, which keeps sigmas and points without marks."""

from __future__ import annotations

import csv
import io
from collections.abc import Sequence

from tiegraph.errors import InputError
from tiegraph.scene.gcp import FileMark, GcpFile


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


def csv_text(file: GcpFile, crs: str, marks: Sequence[FileMark]) -> str:
    """A CSV with a table of points and a table of marks."""
    out = io.StringIO()
    out.write(f"# crs: {crs}\n")
    writer = csv.writer(out, lineterminator="\n")
    writer.writerow(["name", *(("lat", "lon", "height") if file.geographic else "xyz"), "sigma_xy", "sigma_z", "role"])
    for point in file.points:
        role = "check" if point.check else "gcp"
        writer.writerow([point.name, *(repr(v) for v in point.xyz), point.sigma_m[0], point.sigma_m[2], role])
    writer.writerow(["name", "image", "px", "py"])
    for mark in marks:
        writer.writerow([mark.name, mark.image, f"{mark.xy[0]:.3f}", f"{mark.xy[1]:.3f}"])
    return out.getvalue()
