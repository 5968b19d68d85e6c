"""Constants of the verbs outside the pipeline, which have no run folder: tables ``[tuning.<engine>]`` of the file
``--tuning``."""

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
    """The constants of the stages, of which the verbs use some, and the verbs' own."""

    calibrate: CalibrateTuning = Field(default_factory=CalibrateTuning)
    lidar: LidarTuning = Field(default_factory=LidarTuning)
    plan: PlanTuning = Field(default_factory=PlanTuning)
    stations: StationsTuning = Field(default_factory=StationsTuning)
    watch: WatchTuning = Field(default_factory=WatchTuning)

    def changed(self) -> dict[str, Any]:
        """The differences from the defaults, by engine."""
        return self.model_dump(mode="json", exclude_defaults=True)

    def of_stages(self) -> dict[str, Any]:
        """``changed`` of the engines of stages, for the settings of a run."""
        return {engine: values for engine, values in self.changed().items() if engine in Tunings.model_fields}


class _File(Section):
    tuning: VerbTunings = Field(default_factory=VerbTunings)


def read_tunings(path: Path | None) -> VerbTunings:
    """The constants of a file; defaults for those it does not name, or without a file (None).

    Raises SettingsError for a missing or invalid TOML file, for other tables, unknown names and wrong values.
    """
    if path is None:
        return VerbTunings()
    if not path.exists():
        raise SettingsError(f"--tuning {path}: not there; give a file with tables such as [tuning.calibrate]")
    try:
        return _File.model_validate(read_file(path)).tuning
    except ValidationError as error:
        raise SettingsError(f"{path}: " + "; ".join(explain(e, _File) for e in error.errors())) from None
