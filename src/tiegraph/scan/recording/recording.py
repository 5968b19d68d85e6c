"""How a film is named, whatever it comes in."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from tiegraph.scene.bags.topics import shown
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
