"""`tiegraph demo`: the example survey that comes with the package, from images to the report."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated

import tyro

from tiegraph.api import open_project
from tiegraph.cli.options import options_of
from tiegraph.cli.run import Common, finish
from tiegraph.errors import InputError

_ORIGIN = (35.6965, 139.7695, 37.0)  # of the truth's east-north-up metres (truth/meta.json)


@dataclass(frozen=True, kw_only=True)
class _Demo(Common):
    """The example survey from images to the report: 6 cameras, 2 passes, 120 images, GNSS, truth."""

    out: Annotated[Path, tyro.conf.arg(aliases=["-o"])] = Path("tiegraph_demo")
    """The run folder."""
    until: str | None = None
    """The last stage to run (default: all)."""
    preset: str | None = None
    """A named way of working: default, fast, close-range, conventional, meguro2024, meguro2025."""


def example() -> Path:
    """The folder of the example survey. Raises InputError if the package was installed without it."""
    package = Path(__file__).resolve().parents[1]
    for folder in (package / "examples" / "canal", package.parents[1] / "examples" / "canal"):
        if (folder / "images").is_dir():
            return folder
    raise InputError("the example survey is not installed: run the demo from a checkout (examples/canal)")


def main(arguments: list[str]) -> int:
    """Run the example: a boat with six cameras, up and down a canal, under a bridge."""
    options = options_of(_Demo, "tiegraph demo", arguments)
    survey = example()
    truth = survey / "truth"
    evaluate = {
        "reference": truth / "colmap",
        "reference_cloud": truth / "reference.laz",
        "reference_masks": truth / "masks",
        "mask_labels": (4,),
        "reference_origin": _ORIGIN,
    }
    project = open_project(
        survey / "images",
        options.out,
        preset=options.preset,
        pool=options.pool,
        unset=options.unset,
        settings={"evaluate": evaluate},
        rig=survey / "rig.toml",
        gnss=survey / "gnss.csv",
        times=survey / "times.csv",
    )
    return finish(project, options.until, options)
