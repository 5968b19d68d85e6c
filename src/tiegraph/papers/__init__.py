"""The papers' own recipes, one file a paper, so that a reader of a paper finds it complete.

| paper | file | what it plugs in |
|---|---|---|
| 000 | ``meguro2024`` | mask source and preset ``meguro2024``, constant offsets, preset ``conventional`` |
| 001 | ``meguro2025`` | mask sources ``meguro2025`` and ``sky``, sections and preset ``meguro2025`` |
| 002 | ``fuse2014`` | design methods ``fuse2014`` and ``fuse2014_safe``, the accuracy of a pair |

What tiegraph took over from papers and made its own stands in its engines: pairs by poses (Nakagawa et al., paper 003)
in ``network.poses``, clouds of single shots and hierarchical semi-global matching (Wenzel et al., paper 004) in
``dense``.

**Where it fits.** A plug-in point is a dictionary of its engine, from names to functions. This room lies above the
engines and may import them; they do not know it. The glue puts the recipe that the settings name into the dictionary
(``plug_in``), and its file is loaded only then.
"""

from collections.abc import Mapping
from importlib import import_module
from typing import Any

# Of each plug-in point: the names of the recipes, and where they stand.
PRESETS = {
    "conventional": "meguro2024.CONVENTIONAL",
    "meguro2024": "meguro2024.PRESET",
    "meguro2025": "meguro2025.PRESET",
}
MASKS = {"meguro2024": "meguro2024.MASKS", "meguro2025": "meguro2025.MASKS", "sky": "meguro2025.SKY"}
OFFSETS = {"constant": "meguro2024.constant_offsets"}
LIGHTS = {"meguro2025": "meguro2025.light"}
DESIGNS = {"fuse2014": "fuse2014.fuse2014", "fuse2014_safe": "fuse2014.fuse2014_safe"}


def colmap_alone(upright: bool = False) -> dict[str, dict[str, Any]]:
    """Settings that leave off what the papers did not have; ``upright``: but for the ring that tells what is up.

    What they had and tiegraph does otherwise stays tiegraph's: who extracts SIFT, the lens model, dense matching.
    """
    return {
        # Matches alone say which images tie.
        "coarse": {"method": "off"},
        # Every listed pair is matched, and what COLMAP verifies is kept.
        "design": {"method": "all"},
        # COLMAP's incremental mapper by images alone: "even when the relative positions of the cameras are unknown".
        "sparse": {"rig": "absent", "mapper": "incremental", "use_positions": False, "covariance_frames": 0},
        # Positions "were used to determine the scale": a similarity to the cameras, without lever arm or adjustment.
        "georef": {"adjust": "no", "antenna": "ignored"},
        "refine": {"geometry": "off"},
        "tuning": {
            # The rig is believed as it is given.
            "network": {"rig": {"frames": 0}},
            "sfm": {
                # The models are COLMAP's, as its mapper leaves them.
                "mapping": {"min_model_images": 10},
                "adjust": {"iterations": 0},
                # Each stands where its cameras' positions put it: neither matches nor points join it to the others.
                "placement": {"ties": {"trials": 0}},
                "world": {"fixes": {"rows_per_frame": 0}} | ({} if upright else {"up": {"agreement": 1.0}}),
            },
        },
    }


def plug_in(recipes: Mapping[str, str], name: str, point: dict[str, Any]) -> None:
    """Put the recipe of this name into the dictionary of its plug-in point; a name of another's changes nothing."""
    if name in recipes and name not in point:
        file, what = recipes[name].split(".")
        point[name] = getattr(import_module(f"tiegraph.papers.{file}"), what)
