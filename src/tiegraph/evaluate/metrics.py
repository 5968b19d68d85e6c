"""metrics.json: figures of merit and tables, and what they mean."""

import math
from collections.abc import Iterable
from dataclasses import asdict
from typing import Any

from tiegraph.scene.accuracy import Accuracy
from tiegraph.scene.results import Metric


def metrics_to_dict(
    metrics: Iterable[Metric],
    tables: dict[str, dict] | None = None,
    notes: Iterable[str] = (),
    contradictions: Iterable[str] = (),
    accuracy: Accuracy | None = None,
) -> dict[str, Any]:
    """{"accuracy": the layers, "metrics": [{name, value, unit, better, target}], "tables", "notes", "contradictions"}.

    NaN and infinity as null.
    """
    rows = [{k: _finite(v) for k, v in asdict(m).items()} for m in metrics]
    clean = {n: {**t, "rows": [[_finite(v) for v in row] for row in t["rows"]]} for n, t in (tables or {}).items()}
    said = {} if accuracy is None else {"accuracy": accuracy.to_dict()}
    return {**said, "metrics": rows, "tables": clean, "notes": list(notes), "contradictions": list(contradictions)}


def _finite(value: Any) -> Any:
    if hasattr(value, "item"):
        value = value.item()
    return None if isinstance(value, float) and not math.isfinite(value) else value
