"""Every reason a pair can be dropped for has words and a colour."""

from tiegraph.report.charts import REASON_LOOKS
from tiegraph.scene.pairs import REASONS


def test_every_reason_has_a_look() -> None:
    assert tuple(REASON_LOOKS) == REASONS
    assert len({colour for _, colour in REASON_LOOKS.values()}) == len(REASONS)
