"""Shares and quantiles of distances in a file are those of all of them in memory."""

from pathlib import Path

import numpy as np
import pytest

from tiegraph.evaluate.clouds import tally
from tiegraph.evaluate.clouds.tally import Judged, Tally


def test_what_is_counted_part_by_part_is_what_numpy_says(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(tally, "_PART", 700)
    rng = np.random.default_rng(2)
    distance = rng.gamma(2, 0.03, 5000).astype(np.float32)
    distance[:40], distance[40:90] = 0, np.inf
    group, counts = rng.integers(0, 3, (5000, 2)).astype(np.uint8), rng.uniform(size=5000) < 0.8
    path = tmp_path / "judged"
    path.write_bytes(Judged(distance, group, counts).tobytes())
    for which, of in ((Tally(path), counts), (Tally(path).where(1, 2), counts & (group[:, 1] == 2))):
        known = distance[of]
        assert which.count()[0] == len(known)
        assert which.below([0.02, 0.1]) == pytest.approx([np.mean(known < 0.02), np.mean(known < 0.1)], abs=1e-15)
        assert which.beyond(0.1) == pytest.approx(np.mean(known > 0.1), abs=1e-15)
        assert which.quantiles([0.0, 0.5, 0.9]) == pytest.approx(np.quantile(known, [0, 0.5, 0.9]), rel=1e-6)
        assert np.isnan(which.quantiles([0.9999])[0]), "further than was looked for"
    none = Tally(path).where(0, 7)
    assert (
        none.count() == (0, 0) and np.isnan(none.quantiles([0.5])[0]) and none.below([1.0]) == [0] == [none.beyond(1)]
    )
