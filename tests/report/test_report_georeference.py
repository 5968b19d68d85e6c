"""The georeference in words."""

from __future__ import annotations

from tiegraph.report.summary import georeference_sentences


def test_heights_lever_arm_and_adjustment_are_told() -> None:
    world = {
        "placed": True, "vertical": "heights are above the ellipsoid", "adjusted": True, "antenna_m": [0.1, 0.2, 0.3],
    }  # fmt: skip
    text = georeference_sentences(world)
    assert text[0] == "Heights are above the ellipsoid."
    assert any("0.10, 0.20, 0.30 m" in t for t in text) and any("adjusted together" in t for t in text)
    assert georeference_sentences({}) == []
