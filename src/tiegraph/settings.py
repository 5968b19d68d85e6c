"""The base of every settings class: frozen, strict about names, each field documented by a docstring below it."""

from pathlib import Path
from typing import Any

from pydantic import BaseModel, ConfigDict, field_validator

from tiegraph.text import acts, one_line


class Section(BaseModel):
    """One section of ``tiegraph.toml`` = one stage. Unknown names and values out of range are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True, validate_default=True)

    @field_validator("*")
    @classmethod
    def _is_text(cls, value: Any) -> Any:
        """Texts and paths that COLMAP, the report or ``tiegraph.toml`` could not hold."""
        if isinstance(value, (str, Path)) and any(map(acts, str(value))):
            raise ValueError(f"{one_line(str(value))!r} has control characters or bytes that are not UTF-8: rename it")
        return value
