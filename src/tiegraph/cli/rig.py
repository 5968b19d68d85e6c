"""`tiegraph rig OUT`: the rig as a run found it, for the next survey, `shots` or COLMAP."""

from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

import tyro

from tiegraph.api import open_project
from tiegraph.cli.options import options_of
from tiegraph.cli.output import complain, say
from tiegraph.project.stages import write_atomic
from tiegraph.scene.atomic import must_be_new


@dataclass(frozen=True)
class _Rig:
    """Write the rig as a run found it: cameras, places and turns in the rig, with their sigmas.

    Read it with --rig in the next run; `tiegraph run IMAGES --rig FOLDER` takes it from the run folder at once.
    """

    folder: tyro.conf.Positional[Path]
    """A run folder with a sparse model."""
    out: Annotated[Path | None, tyro.conf.arg(name="out", aliases=["-o"])] = None
    """The file to write; it must not exist (default: standard output)."""
    format: Literal["rig", "rig_config"] = "rig"
    """rig = a rig.toml with sigmas, lengths in metres; rig_config = COLMAP's rig_config.json, which has neither."""


def main(arguments: list[str]) -> int:
    """`tiegraph rig`."""
    options = options_of(_Rig, "tiegraph rig", arguments)
    if options.out is not None:
        must_be_new(options.out)
    text, said = open_project(None, options.folder).rig_file(options.format)
    if options.out is not None:
        write_atomic(options.out, text)
        say(f"written: {options.out}")
    else:
        say(text.rstrip("\n"))
    for line in said if options.format != "rig" else ():  # a rig.toml has them as comments
        complain(line)
    return 0
