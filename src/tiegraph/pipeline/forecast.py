"""What a run will need before it begins: images, disk, CPU time."""

import shutil
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tiegraph.features.sift import most_features
from tiegraph.plan.effort import Effort, effort
from tiegraph.plan.tuning import EffortTuning
from tiegraph.project.run import Run
from tiegraph.scan.videos.video import find_videos
from tiegraph.scene.bags import is_bag, source_of
from tiegraph.scene.images import find_images, probe_image

_PROBED = 40  # images whose size stands for all
_GB = 1e9


@dataclass(frozen=True)
class Forecast:
    """What a survey costs, and the disk of its run folder: bytes that are there already, and that are free."""

    cost: Effort
    there_bytes: int
    free_bytes: int

    def enough(self) -> bool:
        """Whether the disk has room for it."""
        # What is still to be written, with what is only there for a while
        return max(self.cost.run_bytes + self.cost.scratch_bytes - self.there_bytes, 0.0) < self.free_bytes

    def lines(self, folder: Path) -> list[str]:
        """For people."""
        cost = self.cost
        cpu = (cost.sparse_cpu_s / 3600, cost.dense_cpu_s / 3600)
        verdict = "enough" if self.enough() else "NOT ENOUGH: give -o on another disk, or stop before dense by --until"
        return [
            f"images: {cost.images}",
            f"disk: about {_gb(cost.model_bytes)} to georef, {_gb(cost.dense_bytes)} more with depth maps and cloud "
            f"(0.7 to 2.1 times what five sets took), and {_gb(cost.scratch_bytes)} for a while during sparse; "
            f"{_gb(self.there_bytes)} are there, {_gb(self.free_bytes)} free at {folder}: {verdict}",
            f"CPU time: about {cpu[0]:.2g} h to georef, {cpu[1]:.2g} h more with depth maps and cloud, of one core of "
            "an AMD EPYC (the larger part runs on all cores)",
        ]


def forecast(run: Run) -> Forecast | None:
    """The cost of a run by the sizes of some of its images; None where they are frames of videos or bags, which only
    `scan` counts. Nothing is written. Raises InputError for folders without images."""
    source = source_of(run.inputs.images)
    if is_bag(source) or find_videos(source):
        return None
    names = find_images(source)
    some = names[:: max(len(names) // _PROBED, 1)]
    probes = [probe_image(source / name, run.settings.tuning.scene.images) for name in some]
    sizes = [(p.width, p.height) for p in probes if not p.reason]
    if not sizes:
        return None
    megapixels = np.prod(sizes, axis=1) / 1e6
    settings = run.settings
    most = most_features(megapixels, settings.features.max_features, settings.tuning.features.sift)
    tuning = EffortTuning(features_px=settings.features.max_image_size, dense_px=settings.dense.max_image_size)
    count = len(names)
    cost = effort((sizes * (count // len(sizes) + 1))[:count], 1, 0.0, None, float(most.mean()), tuning)
    where = next(p for p in (run.folder, *run.folder.parents) if p.exists())
    return Forecast(cost, _size(run.folder), shutil.disk_usage(where).free)


def _size(folder: Path) -> int:
    files = (p for p in folder.rglob("*") if p.is_file() and not p.is_symlink()) if folder.is_dir() else ()
    return sum(p.stat().st_size for p in files)


def _gb(size: float) -> str:
    return f"{size / _GB:.2g} GB"
