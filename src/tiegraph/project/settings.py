"""All settings of a run: one section a stage. Precedence: defaults < preset < tiegraph.toml < command line."""

import sys
from collections.abc import Iterable
from functools import cache
from pathlib import Path
from typing import Any

import tomli_w
from pydantic import Field, ValidationError

from tiegraph import papers
from tiegraph.cloud.settings import CloudSettings
from tiegraph.cloud.tuning import Tuning as CloudTuning
from tiegraph.dense.settings import DenseSettings, ShotsSettings
from tiegraph.dense.tuning import Tuning as DenseTuning
from tiegraph.design.settings import DesignSettings
from tiegraph.design.tuning import Tuning as DesignTuning
from tiegraph.errors import SettingsError, choose
from tiegraph.evaluate.settings import EvaluateSettings
from tiegraph.evaluate.tuning import Tuning as EvaluateTuning
from tiegraph.features.settings import FeaturesSettings, MatchSettings, PreviewSettings
from tiegraph.features.tuning import Tuning as FeaturesTuning
from tiegraph.lidar.tuning import Tuning as LidarTuning
from tiegraph.masks.settings import MasksSettings, RefineSettings
from tiegraph.masks.tuning import Tuning as MasksTuning
from tiegraph.mesh.settings import MeshSettings
from tiegraph.mesh.tuning import Tuning as MeshTuning
from tiegraph.network.settings import CandidatesSettings, CoarseSettings, NetworkSettings
from tiegraph.network.tuning import Tuning as NetworkTuning
from tiegraph.odometry.tuning import Tuning as OdometryTuning
from tiegraph.products.settings import ProductsSettings
from tiegraph.products.tuning import Tuning as ProductsTuning
from tiegraph.report.settings import ReportSettings
from tiegraph.scan.settings import ScanSettings
from tiegraph.scan.tuning import Tuning as ScanTuning
from tiegraph.scene.atomic import regular
from tiegraph.scene.tuning import Tuning as SceneTuning
from tiegraph.settings import Section
from tiegraph.sfm.settings import GeorefSettings, SparseSettings
from tiegraph.sfm.tuning import Tuning as SfmTuning
from tiegraph.stations.tuning import Tuning as StationsTuning
from tiegraph.targets.tuning import Tuning as TargetsTuning
from tiegraph.text import meant
from tiegraph.watch.tuning import Tuning as WatchTuning

if sys.version_info >= (3, 11):
    import tomllib
else:
    import tomli as tomllib

_SHOWN = 80  # characters of a wrong value in a message
RUN_KEYS = ("images", "rig", "camera", "gnss", "trajectory", "start", "times", "preset")
"""Of [run]: the inputs of a run."""
SETTING_OF = {"gcp": ("georef", "gcp"), "marks": ("georef", "marks"), "tolerance": ("evaluate", "tolerance_m")}
"""Inputs that are settings of a stage, so that only what follows it runs again when they change."""


class Tunings(Section):
    """The constants of the engines, and ``scene``, which they share: tables ``[tuning.<engine>]`` of tiegraph.toml. The
    same for every user, so the command line does not show them."""

    scene: SceneTuning = Field(default_factory=SceneTuning)
    scan: ScanTuning = Field(default_factory=ScanTuning)
    features: FeaturesTuning = Field(default_factory=FeaturesTuning)
    masks: MasksTuning = Field(default_factory=MasksTuning)
    network: NetworkTuning = Field(default_factory=NetworkTuning)
    design: DesignTuning = Field(default_factory=DesignTuning)
    sfm: SfmTuning = Field(default_factory=SfmTuning)
    dense: DenseTuning = Field(default_factory=DenseTuning)
    cloud: CloudTuning = Field(default_factory=CloudTuning)
    products: ProductsTuning = Field(default_factory=ProductsTuning)
    mesh: MeshTuning = Field(default_factory=MeshTuning)
    evaluate: EvaluateTuning = Field(default_factory=EvaluateTuning)
    targets: TargetsTuning = Field(default_factory=TargetsTuning)
    odometry: OdometryTuning = Field(default_factory=OdometryTuning)


class Settings(Section):
    """Every setting, by stage; and the engines' constants."""

    scan: ScanSettings = Field(default_factory=ScanSettings)
    masks: MasksSettings = Field(default_factory=MasksSettings)
    preview: PreviewSettings = Field(default_factory=PreviewSettings)
    candidates: CandidatesSettings = Field(default_factory=CandidatesSettings)
    coarse: CoarseSettings = Field(default_factory=CoarseSettings)
    network: NetworkSettings = Field(default_factory=NetworkSettings)
    design: DesignSettings = Field(default_factory=DesignSettings)
    features: FeaturesSettings = Field(default_factory=FeaturesSettings)
    match: MatchSettings = Field(default_factory=MatchSettings)
    sparse: SparseSettings = Field(default_factory=SparseSettings)
    georef: GeorefSettings = Field(default_factory=GeorefSettings)
    refine: RefineSettings = Field(default_factory=RefineSettings)
    dense: DenseSettings = Field(default_factory=DenseSettings)
    cloud: CloudSettings = Field(default_factory=CloudSettings)
    products: ProductsSettings = Field(default_factory=ProductsSettings)
    evaluate: EvaluateSettings = Field(default_factory=EvaluateSettings)
    report: ReportSettings = Field(default_factory=ReportSettings)
    shots: ShotsSettings = Field(default_factory=ShotsSettings)
    mesh: MeshSettings = Field(default_factory=MeshSettings)
    tuning: Tunings = Field(default_factory=cache(Tunings))


STAGED = tuple(name for name in Settings.model_fields if name != "tuning")
"""The sections that a user sets, one for each stage."""


def preset(name: str) -> dict[str, dict[str, Any]]:
    """The settings a preset changes, by section. Raises SettingsError for an unknown name."""
    papers.plug_in(papers.PRESETS, name, _PRESETS)
    return choose("preset", name, {**dict.fromkeys(PRESETS), **_PRESETS})  # type: ignore[return-value]


def merged(*layers: dict[str, dict[str, Any]], where: str = "settings") -> Settings:
    """Settings from layers of {section: {name: value}}, later ones win. Raises SettingsError naming the setting."""
    together: dict[str, dict[str, Any]] = {}
    for layer in layers:
        for section, values in layer.items():
            if not isinstance(values, dict):
                name = section if section in Settings.model_fields else "masks"
                raise SettingsError(
                    f"{where}: {section!r} must be a section such as [{name}], and is {shortened(values)}"
                )
            together[section] = _laid_over(together.get(section, {}), values)
    try:
        return Settings.model_validate(together)
    except ValidationError as error:
        raise SettingsError(f"{where}: " + "; ".join(explain(e, Settings) for e in error.errors())) from None


def _laid_over(below: dict[str, Any], above: dict[str, Any]) -> dict[str, Any]:
    """Two layers of one section: tables within it are merged too."""
    tables = {
        name: _laid_over(below[name], value)
        for name, value in above.items()
        if isinstance(value, dict) and isinstance(below.get(name), dict)
    }
    return {**below, **above, **tables}


def changed(settings: Settings) -> dict[str, dict[str, Any]]:
    """The differences from the defaults, by section, ready for TOML."""
    full = settings.model_dump(mode="json", exclude_defaults=True)
    return {section: _without_none(values) for section, values in full.items() if values}


def read_file(path: Path) -> dict[str, Any]:
    """The tables of a tiegraph.toml, {} if it is not there.

    Raises SettingsError for a file that is no UTF-8 text, with the line of a TOML error, and for invalid sections.
    """
    if not path.exists():
        return {}
    try:
        data = parse(regular(path).read_bytes().decode("utf-8-sig"))
    except OSError as error:
        raise SettingsError(f"{path}: cannot be read ({error.strerror}): move it away to begin anew") from None
    except UnicodeDecodeError as error:
        raise SettingsError(
            f"{path}: not a text file in UTF-8 (byte {error.start + 1}): save it so, or move it away to begin anew"
        ) from None
    except (tomllib.TOMLDecodeError, RecursionError) as error:
        raise SettingsError(f"{path}: not valid TOML: {error}") from None
    run_table(data, str(path))
    return data


def read_settings(path: Path, made_with: dict[str, dict[str, Any]] | None = None) -> Settings:
    """The settings of a run folder's tiegraph.toml, on top of those that its results were made with
    (sections of receipts) and of its preset; the defaults if it is not there. Raises SettingsError."""
    stored = read_file(path)
    run = stored.pop("run", {})
    return merged(preset(run.get("preset", "default")), made_with or {}, stored, where=str(path))


def run_table(data: dict[str, Any], where: str) -> dict[str, str]:
    """The section [run] of a tiegraph.toml: inputs by name. Raises SettingsError for unknown names and non-text."""
    run = data.get("run", {})
    if not isinstance(run, dict):
        raise SettingsError(f"{where}: run = {shortened(run)} must be a section [run] that holds {', '.join(RUN_KEYS)}")
    for name, value in run.items():
        if name not in RUN_KEYS:
            own = next((s for s, fields in sections() if name in fields), "")
            remedy = f": it is the setting {name} of [{own}]" if own else _meant(name, RUN_KEYS)
            raise SettingsError(f"{where}: unknown name {name!r} in [run]{remedy}")
        if not isinstance(value, str) or not value.strip() or "\0" in value:
            raise SettingsError(
                f"{where}: run.{name} = {shortened(value)}: give a path or name in quotes, or remove it"
            )
    return run


def without(stored: dict[str, Any], keys: Iterable[str]) -> dict[str, Any]:
    """The tables of a tiegraph.toml without some values, which may be absent: inputs ("gnss") and settings
    ("masks.folder"). Raises SettingsError for a name that is neither."""
    settings = {f"{section}.{name}": (section, name) for section, fields in sections() for name in fields}
    places = {**{n: ("run", n) for n in RUN_KEYS[1:]}, **SETTING_OF, **settings}
    out = {section: dict(values) if isinstance(values, dict) else values for section, values in stored.items()}
    for key in keys:
        name = key.replace("-", "_")
        if name not in places:
            inputs = ", ".join(n for n in places if n not in settings)
            hint = meant(name, places)
            raise SettingsError(f"--unset {key}: neither one of {inputs} nor a setting such as masks.folder{hint}")
        section, entry = places[name]
        if isinstance(out.get(section), dict):
            out[section].pop(entry, None)
    return out


def sections() -> list[tuple[str, dict[str, Any]]]:
    """(section, its fields by name) of the section of every stage."""
    settings = Settings()
    return [(name, dict(type(getattr(settings, name)).model_fields)) for name in STAGED]


def shortened(value: Any) -> str:
    """A wrong value, shortened for a message."""
    text = repr(value)
    return text if len(text) <= _SHOWN else text[:_SHOWN] + " ..."


def parse(text: str) -> dict[str, Any]:
    """The tables of TOML text."""
    return tomllib.loads(text)


def file_text(run: dict[str, Any], settings: dict[str, dict[str, Any]]) -> str:
    """Text of a tiegraph.toml: the run's inputs and the settings that differ from the defaults."""
    head = (
        "# The inputs of this run and every setting that differs from its default.\n"
        "# Edit it and run again; `tiegraph run --help-all` lists all settings. A command line that changes a\n"
        "# setting rewrites this file.\n"
    )
    return head + tomli_w.dumps({"run": _without_none(run), **settings})


def _without_none(values: dict[str, Any]) -> dict[str, Any]:
    return {k: v for k, v in values.items() if v is not None}


def explain(error: Any, root: type[Section]) -> str:
    """A validation error in words, with the name of the setting below ``root`` and the likely intended one."""
    where = [str(part) for part in error["loc"]]
    name = ".".join(where)
    if error["type"] != "extra_forbidden":
        value = "" if isinstance(error.get("input"), dict) else f" = {shortened(error.get('input'))}"
        return f"{name}{value}: {error['msg'].removeprefix('Value error, ')}"
    fields: Any = root
    for part in where[:-1]:
        fields = fields.model_fields[part].annotation
    return f"unknown setting {name!r}{_meant(where[-1], fields.model_fields)}"


def _meant(name: str, known: Iterable[str]) -> str:
    return meant(name, known) or f": known are {', '.join(known)}"


class VerbTunings(Tunings):
    """The constants of the stages, of which the verbs outside the pipeline use some, and the verbs' own: tables
    ``[tuning.<engine>]`` of the file ``--tuning``, for they have no run folder."""

    lidar: LidarTuning = Field(default_factory=LidarTuning)
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
        raise SettingsError(f"--tuning {path}: not there; give a file with tables such as [tuning.stations]")
    try:
        return _File.model_validate(read_file(path)).tuning
    except ValidationError as error:
        raise SettingsError(f"{path}: " + "; ".join(explain(e, _File) for e in error.errors())) from None


# The settings of each preset; those of the papers are added when they are requested.
_PRESETS: dict[str, dict[str, dict[str, Any]]] = {
    "default": {},
    # Small depth maps of two partners each: for a check on site.
    "fast": {"dense": {"max_image_size": 800, "partners": 2}},
    # A rig or camera within arm's reach (paper 004): every pixel of the images, and every useful neighbour.
    "close-range": {"dense": {"max_image_size": 8000, "partners": 6}},
}
PRESETS = (*_PRESETS, *papers.PRESETS)
"""The names of all presets."""
