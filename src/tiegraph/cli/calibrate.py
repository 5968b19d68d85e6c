"""`tiegraph calibrate IMAGES --board BOARD -o rig.toml`: cameras and rig from images of a board."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from tiegraph.calibrate.settings import CalibrateSettings
from tiegraph.cli.options import options_of
from tiegraph.pipeline.calibrate import calibrate as calibrate_images
from tiegraph.project.progress import Reporter

_DEFAULT = CalibrateSettings()


@dataclass(frozen=True)
class CalibrateOptions:
    """Options of `tiegraph calibrate`."""

    board: str
    """charuco:7x5:0.04:0.03:DICT_5X5_1000 (squares across x down, side of a square and of a marker in metres,
    dictionary), checker:9x6:0.025 (inner corners, side of a square), or Kalibr's aprilgrid.yaml."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("rig.toml")
    """The rig file to write, with a folder of its name beside it; neither may be there."""
    pool: str = "local"
    """Where corners are looked for: serial, local, local:<workers>."""
    json: bool = False
    """One JSON object on standard output instead of text."""
    quiet: bool = False
    """Say nothing but errors."""


def main(arguments: list[str]) -> int:
    """`tiegraph calibrate`."""

    def calibrate(
        images: tyro.conf.Positional[Path],
        options: Annotated[CalibrateOptions, tyro.conf.arg(name="")],
        settings: Annotated[CalibrateSettings, tyro.conf.arg(name="")] = _DEFAULT,
    ) -> tuple[Path, CalibrateOptions, CalibrateSettings]:
        """Calibrate a camera, or the cameras of a rig, by images of a board; --rig reads what it writes.

        Args:
            images: The folder that holds the images, one folder a camera; equal names = one instant.
        """
        return images, options, settings

    images, options, settings = options_of(calibrate, "tiegraph calibrate", arguments)
    reporter = Reporter("json" if options.json else "quiet" if options.quiet else "auto")
    verdict = calibrate_images(images, options.board, options.out, settings, options.pool, reporter)
    reporter.event("calibrated", rig=options.out, advice=verdict.advice)
    return 0
