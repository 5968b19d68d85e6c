"""What a camera wrote into its files beside the pictures: tracks, the fixes of its receiver, the factory's calibration.

A ``Recording`` names one film: a file, a track of one, or a topic of a bag.
``tracks`` reads the tables of an MP4 file, and shows OpenCV one video track of several: its FFmpeg takes the first and
knows no other (``CAP_PROP_VIDEO_STREAM`` is refused), but reads from a Python stream, in which the other tracks are
named free space. GoPro's telemetry is a track of key, length, value (``gpmf``), Insta360's a trailer behind
the last box (``insta360``). Both end as ``Fixes``, positions by the stamps of the video. What the factory measured of
the lenses of an Insta360 is a string of numbers (``insta360``).

Of the libraries, telemetry-parser 0.3.0 (MIT or Apache) leaves GPS9 as bytes, knows no index of a trailer and has no
wheel for Python 3.13. What is needed of both formats is a table, so it is read here, each size checked before it is
used.
"""

from dataclasses import dataclass
from pathlib import Path

from tiegraph.scene.bags import shown
from tiegraph.scene.names import clean


@dataclass(frozen=True)
class Recording:
    """What is one video to the rest of scan: a file, one of the video tracks of a file, from 0, or an image topic of a
    bag."""

    file: Path
    track: int | None = None
    topic: str | None = None

    @property
    def name(self) -> str:
        """As it may be shown."""
        if self.topic is not None:
            return shown(self.file, self.topic)
        return clean(self.file.name) + ("" if self.track is None else f", track {self.track + 1}")
