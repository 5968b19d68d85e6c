"""The classes a mask can tell apart; what is written to disk is only used or not."""

from __future__ import annotations

USE, SKY, WATER, EGO, OVEREXPOSED = range(5)
NAMES = ("used", "sky", "water", "platform", "overexposed")
"""Names by number, for tables."""
