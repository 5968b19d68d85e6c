"""Which files of a folder have arrived whole, while they are still being copied."""

import os
from dataclasses import dataclass
from pathlib import Path

from tiegraph.errors import InputError
from tiegraph.scene.images import find_images, searched
from tiegraph.watch.tuning import ArrivalsTuning


@dataclass
class _File:
    """What is known of a file: size and time of change, since when (s), and how often it was handed out so."""

    stamp: tuple[int, int]
    since: float
    tries: int = 0
    due: float = 0.0  # when a broken one is handed out again
    whole: bool = False


class Arrivals:
    """The image files below a folder, each handed out when it has settled, and again when it has changed."""

    def __init__(self, folder: Path, tuning: ArrivalsTuning) -> None:
        self.folder, self._tuning = folder, tuning
        self.trouble = ""  # why the folder cannot be looked into now
        self._files: dict[str, _File] = {}

    @property
    def root(self) -> Path:
        """The folder that names are relative to."""
        return searched(self.folder)

    def waiting(self) -> int:
        """Files that are there and were not handed out as they are now."""
        return sum(not f.tries for f in self._files.values())

    def look(self, now: float) -> list[str]:
        """Names of files to open, in the order they came. Never raises: a folder that is gone is ``trouble``."""
        try:
            names = find_images(self.folder)
            self.trouble = ""
        except (InputError, OSError) as error:
            there = os.path.isdir(self.folder)
            self.trouble = str(error) if there else f"{self.folder} is gone (card pulled out, share lost?)"
            return []
        root = self.root
        ready = []
        for name in names:
            try:
                info = (root / name).stat()
            except OSError:  # gone since the folder was listed
                continue
            if self._is_ready(name, (info.st_size, info.st_mtime_ns), now):
                ready.append(name)
        return sorted(ready, key=lambda name: (self._files[name].stamp[1], name))

    def _is_ready(self, name: str, stamp: tuple[int, int], now: float) -> bool:
        file = self._files.get(name)
        if file is None or file.stamp != stamp:
            self._files[name] = _File(stamp, now)
            return self._tuning.settled_s == 0
        if file.whole or now - file.since < self._tuning.settled_s:
            return False
        return file.tries == 0 or (file.tries < self._tuning.tries and now >= file.due)

    def opened(self, name: str, whole: bool, now: float) -> None:
        """What became of a file that was handed out."""
        file = self._files[name]
        file.whole, file.tries = whole, file.tries + 1
        file.due = now + self._tuning.again_s * 2 ** (file.tries - 1)

    def came(self, name: str) -> float:
        """When a file was first seen as it is now, s."""
        return self._files[name].since
