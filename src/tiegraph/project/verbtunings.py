"""Constants of the verbs beside the pipeline, which have no run folder: tables ``[tuning.<engine>]`` of a file that
``--tuning`` names."""

from pathlib import Path
from typing import Any

from pydantic import Field, ValidationError

from tiegraph.calibrate.tuning import Tuning as CalibrateTuning
from tiegraph.errors import SettingsError
from tiegraph.lidar.tuning import Tuning as LidarTuning
from tiegraph.plan.tuning import Tuning as PlanTuning
from tiegraph.project.settings import Tunings, explain, read_file
from tiegraph.settings import Section
from tiegraph.stations.tuning import Tuning as StationsTuning
from tiegraph.watch.tuning import Tuning as WatchTuning


class VerbTunings(Tunings):
    """Those of the stages, of which the verbs use some, and the verbs' own."""

    calibrate: CalibrateTuning = Field(default_factory=CalibrateTuning)
    lidar: LidarTuning = Field(default_factory=LidarTuning)
    plan: PlanTuning = Field(default_factory=PlanTuning)
    stations: StationsTuning = Field(default_factory=StationsTuning)
    watch: WatchTuning = Field(default_factory=WatchTuning)

    def changed(self) -> dict[str, Any]:
        """What differs from the defaults, by engine."""
        return self.model_dump(mode="json", exclude_defaults=True)

    def of_stages(self) -> dict[str, Any]:
        """``changed`` of the engines of stages, for the settings of a run."""
        return {engine: values for engine, values in self.changed().items() if engine in Tunings.model_fields}


class _File(Section):
    tuning: VerbTunings = Field(default_factory=VerbTunings)


def read_tunings(path: Path | None) -> VerbTunings:
    """The constants of a file, those it does not name and those of no file (None) by default.

    Raises SettingsError for a file that is not there or is no TOML, for other tables, unknown names and wrong values.
    """
    if path is None:
        return VerbTunings()
    if not path.exists():
        raise SettingsError(f"--tuning {path}: not there; give a file with tables such as [tuning.calibrate]")
    try:
        return _File.model_validate(read_file(path)).tuning
    except ValidationError as error:
        raise SettingsError(f"{path}: " + "; ".join(explain(e, _File) for e in error.errors())) from None
