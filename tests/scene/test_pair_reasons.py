"""Every reason a pair can be dropped for has words and a colour."""

from tiegraph.scene.pairs import REASON_LOOKS, REASONS


def test_every_reason_has_a_look() -> None:
    assert all(words and colour for words, colour in REASON_LOOKS.values())
    assert len({colour for _, colour in REASON_LOOKS.values()}) == len(REASONS)
