"""`tiegraph demo`: the example survey that comes with the package, from images to the report."""

from dataclasses import dataclass
from importlib.util import find_spec
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
    """The folder of the example survey: that of the checkout, or the package `tiegraph-canal`. Raises InputError if
    neither is there."""
    installed = find_spec("tiegraph_canal")
    folders = [Path(__file__).resolve().parents[3] / "examples" / "canal"]
    folders += [Path(p) for p in (installed and installed.submodule_search_locations) or ()]
    for folder in folders:
        if (folder / "images").is_dir():
            return folder
    raise InputError(
        "the example survey is a package of its own, and it is not installed: `pip install tiegraph-canal` "
        "(in a checkout of tiegraph: `pip install ./examples/canal`)"
    )


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
