"""Glue of candidates: which images may tie, by previews and priors."""

from collections.abc import Sequence
from functools import partial
from pathlib import Path
from typing import Any

import numpy as np

from tiegraph import papers
from tiegraph.network.candidates import find_candidates
from tiegraph.network.offsets import OFFSETS, curves_csv
from tiegraph.network.passes import MatchCache
from tiegraph.pipeline.files import save_npz, scanned
from tiegraph.pipeline.preview import Matcher, read_preview
from tiegraph.project.run import Run
from tiegraph.project.stages import Outcome, write_atomic
from tiegraph.scene.scene import Scene


def candidates(run: Run) -> Outcome:
    """Candidate pairs from every source, judged by previews; the order of passes and the rig checked by them."""
    scene = scanned(run)
    cache = MatchCache(Matcher(run, "candidates/matched"), len(scene))
    settings, tuning = run.settings.candidates, run.settings.tuning.network
    papers.plug_in(papers.OFFSETS, settings.offsets, OFFSETS)
    found = find_candidates(scene, cache, settings, tuning, partial(_Descriptors, run.folder, scene))
    save_npz(run.path("candidates.npz"), **found.pairs.to_npz())
    save_npz(run.path("candidates", "matches.npz"), **found.ties.to_npz())
    write_atomic(run.path("candidates", "scene.json"), found.scene.to_json())
    for name, picture in found.pictures():
        write_atomic(run.path("candidates", f"{name}.png"), picture)
    if found.curves:
        write_atomic(run.path("candidates", "offsets.csv"), curves_csv(found.curves))
    counts = {"previews": len(found.ties), "candidates": len(found.pairs), "kept": len(found.pairs.kept())}
    return Outcome(counts, notes=found.notes)


class _Descriptors(Sequence[np.ndarray]):
    """Descriptors (K, 128) u1 of every image, read on demand: those of thousands of images would fill memory."""

    def __init__(self, folder: Path, scene: Scene) -> None:
        self._folder, self._names = folder, scene.names

    def __len__(self) -> int:
        return len(self._names)

    def __getitem__(self, image: Any) -> Any:
        return read_preview(self._folder, self._names[image]).descriptors
