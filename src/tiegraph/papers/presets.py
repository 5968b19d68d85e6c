"""What the presets of the papers have in common: nothing but COLMAP, masks and a pair list."""

from typing import Any

_NEVER = 10**6  # votes, or frames: more than any survey has

COLMAP_ALONE: dict[str, dict[str, Any]] = {
    # Matches alone say which images tie.
    "coarse": {"method": "off"},
    # Every listed pair is matched, and what COLMAP verifies is kept.
    "design": {"method": "all"},
    "filter": {"method": "off"},
    # COLMAP's incremental mapper by images alone: "even when the relative positions of the cameras are unknown".
    "sparse": {"rig": "absent", "mapper": "incremental", "use_positions": False, "covariance_frames": 0},
    # Positions "were used to determine the scale": a similarity to the cameras, without lever arm or adjustment.
    "georef": {"adjust": "no", "antenna": "ignored"},
    "refine": {"geometry": "off"},
    "tuning": {
        # The rig is believed as it is given.
        "network": {"rig": {"check": {"min_votes": _NEVER}, "order": {"better": 3.0}}},
        # The model stays as the mapper leaves it, but for a last bundle adjustment by least squares.
        "sfm": {"placement": {"max_left_out": 0}, "adjust": {"robust_rounds": 0}},
    },
}
"""Switched off is what the papers did not have. What they had and tiegraph does otherwise stays tiegraph's: who
extracts SIFT, the lens model, dense matching."""
