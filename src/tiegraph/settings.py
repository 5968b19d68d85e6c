"""The base of every settings class: frozen, strict about names, each field documented by a docstring below it.

What a user chooses is a section by stage. What an engine decides by is the class ``Tuning`` in the engine's
``tuning.py``, one group of constants for each of its modules or subpackages, each with unit, meaning and origin. It
is passed in like settings. A table ``[tuning.<engine>]`` of ``tiegraph.toml`` changes values, for measurements: they
count in the keys of the stages that follow them (``Stage.tuned``), and the receipt names those that differ. Numeric
epsilons, seeds, bounds of memory, definitions and what nobody has a reason to tune stay in their modules.
"""

from pathlib import Path
from typing import Any, get_origin

from pydantic import BaseModel, ConfigDict, Field, GetCoreSchemaHandler, field_validator, model_validator
from pydantic_core import CoreSchema

from tiegraph.text import acts, one_line


class Section(BaseModel):
    """One section of ``tiegraph.toml`` = one stage. Unknown names and values out of range, NaN and inf are refused."""

    # Validators are built at first use: a child or a worker of a pool needs a few of some hundred classes.
    model_config = ConfigDict(frozen=True, extra="forbid", validate_default=True, allow_inf_nan=False, defer_build=True)

    @classmethod
    def __get_pydantic_core_schema__(cls, source: Any, handler: GetCoreSchemaHandler) -> CoreSchema:
        """Classes within it first: their validators are then built once and not again in each class around them."""
        for field in cls.model_fields.values():
            # On Python 3.10 tuple[int, ...] is a type to isinstance, and no class to issubclass.
            if (
                get_origin(field.annotation) is None
                and isinstance(field.annotation, type)
                and issubclass(field.annotation, Section)
            ):
                field.annotation.model_rebuild()
        return handler(source)

    @model_validator(mode="before")
    @classmethod
    def _true_is_no_number(cls, data: Any) -> Any:
        """Pydantic takes true for 1 and 1 for true: of a file that is a value on the wrong line."""
        for name, given in data.items() if isinstance(data, dict) else ():
            wanted = cls.model_fields[name].annotation if name in cls.model_fields else None
            if isinstance(given, bool) and wanted in (int, float, float | None):
                raise ValueError(f"{name} = {str(given).lower()}: give a number")
            if isinstance(given, (int, float, str)) and not isinstance(given, bool) and wanted is bool:
                raise ValueError(f"{name} = {given!r}: give true or false")
        return data

    @field_validator("*")
    @classmethod
    def _is_text(cls, value: Any) -> Any:
        """Texts and paths that COLMAP, the report or ``tiegraph.toml`` could not hold."""
        if isinstance(value, (str, Path)) and any(map(acts, str(value))):
            raise ValueError(f"{one_line(str(value))!r} has control characters or bytes that are not UTF-8: rename it")
        return value


def user_path(kind: str) -> Any:
    """An optional setting that names something of the user's: ``kind`` is "file", "folder" or "file or folder".

    Before a run it must be there and be of that kind (``project.settings.check_files``).
    """
    return Field(None, json_schema_extra={"kind": kind})
