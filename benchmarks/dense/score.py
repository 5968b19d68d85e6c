"""How good a disparity map is."""

from __future__ import annotations

import numpy as np

from benchmarks.dense.data import Pair


def score(found: np.ndarray, pair: Pair) -> dict[str, float]:
    """completeness: answered share of the judged pixels; bad_1, bad_2: share of the answers off by more than 1 or 2 px;
    good_1, good_2: share of the judged pixels answered within 1 or 2 px; sigma_px: of errors below 1 px; locking:
    largest share of a tenth of a pixel among the fractions, 1 = none; bar_<w>: share of a bar within 2 px."""
    judged = pair.judged
    error = found - pair.truth
    answered = judged & np.isfinite(error)
    size = np.abs(error[answered])
    n = np.count_nonzero(judged)
    fraction = np.histogram(found[answered] % 1, 10, (0, 1))[0] / max(1, np.count_nonzero(answered))
    result = {
        "completeness": len(size) / n,
        "bad_1": float(np.mean(size > 1)),
        "bad_2": float(np.mean(size > 2)),
        "good_1": np.count_nonzero(size <= 1) / n,
        "good_2": np.count_nonzero(size <= 2) / n,
        "sigma_px": float(np.std(error[answered][size < 1])),
        "locking": float(fraction.max() * 10),
    }
    for width, bar in pair.bars.items():
        here = bar & judged
        if here.any():
            result[f"bar_{width}"] = float(np.mean(np.abs(error[here]) <= 2))
    return {k: round(v, 4) for k, v in result.items()}
