"""`tiegraph calibrate IMAGES --board BOARD -o rig.toml`: cameras and rig from images of a board; `--from OUT`: as a run
found them, beside those of a board."""

from dataclasses import asdict, dataclass
from pathlib import Path
from typing import Annotated

import tyro

from tiegraph.calibrate.settings import CalibrateSettings
from tiegraph.cli.options import Talk, options_of
from tiegraph.errors import SettingsError
from tiegraph.pipeline.calibrate import calibrate as calibrate_images
from tiegraph.pipeline.calibrate import self_calibration
from tiegraph.project.verbtunings import read_tunings


@dataclass(frozen=True, kw_only=True)
class _Calibrate(Talk):
    """Calibrate a camera, or the cameras of a rig, by images of a board; --rig reads what it writes."""

    images: tyro.conf.Positional[Path | None] = None
    """The folder that holds the images, one folder a camera; equal names = one instant."""
    board: str | None = None
    """charuco:7x5:0.04:0.03:DICT_5X5_1000 (squares across x down, side of a square and of a marker in metres,
    dictionary), checker:9x6:0.025 (inner corners, side of a square), or Kalibr's aprilgrid.yaml."""
    run: Annotated[Path | None, tyro.conf.arg(name="from")] = None
    """A run folder instead of images: the calibration that this survey found (as `tiegraph rig` writes it)."""
    against: Path | None = None
    """With --from: a rig file, such as a board's, that it is compared with."""
    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("rig.toml")
    """The rig file to write, with a folder of its name beside it; neither may be there."""
    tuning: Path | None = None
    """A file with other constants: tables [tuning.calibrate] and [tuning.scan]."""
    pool: str = "local"
    """Where corners are looked for: serial, local, local:<workers>."""
    settings: Annotated[CalibrateSettings, tyro.conf.arg(name="")] = CalibrateSettings()


def main(arguments: list[str]) -> int:
    """`tiegraph calibrate`."""
    options = options_of(_Calibrate, "tiegraph calibrate", arguments)
    images, reporter, tunings = options.images, options.reporter(), read_tunings(options.tuning)
    if options.run is not None:
        if images is not None or options.board is not None:
            raise SettingsError("--from OUT takes the calibration of a run: leave the images and --board away")
        rows = self_calibration(options.run, options.out, options.against, reporter, tunings)
        reporter.event("calibrated", rig=options.out, differences=[asdict(r) for r in rows])
        return 0
    if images is None or options.board is None or options.against is not None:
        raise SettingsError("give images and --board, or --from OUT (and --against RIG_FILE)")
    settings = options.settings
    verdict = calibrate_images(images, options.board, options.out, settings, options.pool, reporter, tunings)
    reporter.event("calibrated", rig=options.out, advice=verdict.advice)
    return 0
