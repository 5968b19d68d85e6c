"""Point clouds as E57 (ASTM E2807), which scanner software and CAD read; written by pye57, an extra."""

from collections.abc import Iterable
from pathlib import Path

import numpy as np

from tiegraph.errors import EngineMissing
from tiegraph.scene.atomic import replacing
from tiegraph.scene.cloudfile import shift_of
from tiegraph.scene.results import Cloud


def write_e57(clouds: Iterable[Cloud], path: Path) -> int:
    """Write clouds with their colours, each as a scan of its own in coordinates of the CRS; how many points they have.

    pye57 keeps single precision about the place of a scan: its middle, in whole metres. Raises EngineMissing without
    pye57, InputError for a full disk.
    """
    try:
        import pye57
    except ImportError:
        raise EngineMissing(
            f"{path}: E57 is written by pye57, which is not installed: pip install 'tiegraph[e57]'"
        ) from None
    count = 0
    with replacing(path) as temporary, pye57.E57(str(temporary), mode="w") as file:
        for number, cloud in enumerate(clouds, 1):
            place = np.round((cloud.xyz_m + shift_of(cloud.origin)).mean(axis=0))
            local = cloud.xyz_m + (shift_of(cloud.origin) - place)
            columns = {f"cartesian{name}": np.ascontiguousarray(local[:, k]) for k, name in enumerate("XYZ")}
            colours = {
                f"color{n}": np.ascontiguousarray(cloud.rgb[:, k]) for k, n in enumerate(("Red", "Green", "Blue"))
            }
            crs = "no CRS" if cloud.origin is None else cloud.origin.crs
            file.write_scan_raw({**columns, **colours}, name=f"tiegraph {number} ({crs})", translation=place)
            count += len(cloud)
    return count
