"""Scans of a Velodyne's packets (.pcap), decoded by velodyne-decoder (BSD)."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

from tiegraph.errors import EngineMissing, InputError
from tiegraph.lidar.formats import Points
from tiegraph.scene.regular import regular


def pcap_scans(path: Path) -> Iterator[tuple[float, Points]]:
    """Stamp (s) and points of each turn; the first and the last, which may be parts of one, included.

    Raises EngineMissing without velodyne-decoder, and InputError for a file that it cannot read.
    """
    try:
        import velodyne_decoder
    except ImportError:
        raise EngineMissing(
            f"{path}: .pcap files are read by velodyne-decoder, which is not installed: pip install 'tiegraph[lidar]'"
        ) from None
    regular(path, None)
    try:
        for stamp, table in velodyne_decoder.read_pcap(str(path)):
            yield float(getattr(stamp, "host", stamp)), Points(table[:, :3].astype(float), table[:, 4].astype(float))
    except Exception as error:  # dpkt raises what is no child of OSError or ValueError
        raise InputError(f"{path}: cannot be read as packets of a Velodyne: {error}") from error
