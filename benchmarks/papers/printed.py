"""What the papers print, typed in once: paper -> table -> columns and rows, None where a cell is empty.

000 Meguro et al. 2024; 001 Meguro et al. 2025; 002 Fuse and Harada 2014; 003 Nakagawa, visual odometry; 004 Wenzel et
al. 2012. Times in seconds.
"""

from __future__ import annotations

from dataclasses import dataclass


@dataclass(frozen=True)
class Printed:
    """A table of a paper."""

    title: str
    columns: tuple[str, ...]
    rows: tuple[tuple, ...]


_CP = ("", "conventional", "proposed")
_SECTION = (
    "Final mask processing", "Feature point extraction", "Matching search", "SfM", "MVS", "Overall processing",
    "Input images", "Used images", "MVS points", "RMSE, m",
)  # fmt: skip


def _turned(names: tuple[str, ...], *columns: tuple[float, ...]) -> tuple[tuple, ...]:
    return tuple((name, *(column[k] for column in columns)) for k, name in enumerate(names))


PRINTED: dict[str, tuple[Printed, ...]] = {
    "000": (
        Printed("table 1: matching search and SfM", _CP, (
            ("Mask image creation", 813.0, 813.0),
            ("Inter-image range search", None, 744.9),
            ("Matching list creation", 10274.4, 446.3),
            ("Feature extraction", 22.4, 23.0),
            ("Feature matching", 333.4, 3.5),
            ("Reconstruction", 1591.8, 39.3),
            ("SfM, total", 12222.0, 1257.0),
            ("Images used", 500, 222),
            ("Sparse points", 45473, 6779),
        )),
        Printed("table 2: total time and error", _CP, (
            ("Mask image creation", 813.0, 813.0),
            ("SfM", 12222.0, 1257.0),
            ("MVS", 40276.0, 16359.0),
            ("Total", 53311.0, 18429.0),
            ("Dense points", 2294850, 1698971),
            ("RMSE, m", 0.0234, 0.0266),
        )),
    ),
    "001": (
        Printed("table 1: conventional; table 5: conventional and proposed", _CP, (
            ("Final mask processing", 804.0, 804.0),
            ("SfM", 400777.0, 19177.7),
            ("MVS", 369288.6, 77308.4),
            ("Overall processing", 770869.6, 97290.1),
            ("Input images", 4020, 4020),
            ("Used images", 3981, 937),
            ("MVS points", 39142809, 5936986),
            ("RMSE, m", 2.168, 0.396),
        )),
        Printed("table 2: accuracy of masks, %", ("", "cam0", "cam1", "cam2", "cam3", "cam4", "cam5", "all"), (
            ("Accuracy", 94, 95, 92, 87, 95, 86, 91),
        )),
        Printed("table 3: bridge sections", ("", "Bridge 1", "Bridge 2"), _turned(
            _SECTION,
            (120.0, 308.8, 1194.9, 544.2, 3597.5, 5765.5, 600, 62, 329578, 0.045),
            (126.0, 324.3, 1724.4, 396.6, 7349.2, 9920.4, 630, 104, 480113, 0.007),
        )),
        Printed("table 4: other sections", ("", "River 1", "River 2", "River 3"), _turned(
            _SECTION,
            (32.4, 83.4, 427.8, 158.2, 3812.9, 4514.7, 162, 54, 210732, 1.319),
            (488.4, 1256.9, 7829.2, 3388.3, 50373.8, 63336.7, 2442, 562, 3818276, 0.023),
            (37.2, 95.7, 950.2, 494.8, 12174.8, 13752.7, 186, 155, 1372927, 0.316),
        )),
    ),
    "002": (
        Printed("table 1: image pairs after each stage", ("", "initial", "matches >= 25", "not similar", "graph cut"), (
            ("pairs", 19581, 18227, 15892, 14731),
        )),
        Printed("table 2: coordinates of points and their sd", ("", "X", "sd", "Y", "sd", "Z", "sd"), (
            ("(A) all pairs", 36.648, 1.584, -37.019, 1.239, 51.935, 1.945),
            ("(B) chosen pairs", 35.793, 1.226, -35.849, 1.324, 50.856, 1.803),
        )),
        Printed("table 3: camera positions and their sd", ("", "X", "sd", "Y", "sd", "Z", "sd"), (
            ("(A) all pairs", 146.054, 6.014, -137.498, 6.515, 214.513, 9.021),
            ("(B) chosen pairs", 146.054, 6.268, -137.498, 6.79, 214.513, 9.402),
        )),
    ),
    "003": (
        Printed(
            "tables 1 and 2: all pairs / pairs by odometry",
            ("scene", "pairs", "total", "feature detection", "image matching", "dense", "others", "dense points"),
            (
                ("ID 1", (10440, 2864), (5488, 4419), (26, 25), (1344, 318), (3954, 3943), (164, 133),
                 (6044488, 6033970)),
                ("ID 2", (4656, 369), (2574, 2275), (18, 17), (559, 42), (1905, 2131), (92, 85), (3135355, 3427755)),
                ("ID 3", (3240, 374), (2536, 2048), (16, 15), (357, 47), (2101, 1930), (62, 56), (2329981, 2119187)),
                ("ID 4", (24753, 7512), (8236, 6423), (34, 41), (2469, 775), (5481, 5381), (252, 226),
                 (10104306, 9766795)),
                ("ID 5", (6903, 1378), (2915, 3208), (20, 20), (716, 161), (2080, 2937), (99, 90), (1990045, 2982274)),
                ("ID 6", (6441, 1440), (4567, 3374), (20, 20), (696, 167), (3726, 3374), (125, 124),
                 (6928877, 6231082)),
            ),
        ),
    ),
    "004": (
        Printed("table 1: precision, resolution, footprint", ("", "50 cm", "70 cm", "100 cm", "120 cm"), (
            ("Precision, mm", 0.43, 0.84, 1.73, 2.48),
            ("Resolution, px/mm2", 21.5, 11.0, 5.4, 3.7),
            ("Footprint, cm", "45*36", "65*53", "98*81", "119*98"),
        )),
        Printed("abstract: a shot at 70 cm", ("", "points"), (("up to", 3500000),)),
    ),
}  # fmt: skip
