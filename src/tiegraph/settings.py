"""The base of every settings class: frozen, strict about names, each field documented by a docstring below it."""

from pydantic import BaseModel, ConfigDict


class Section(BaseModel):
    """One section of ``tiegraph.toml`` = one stage. Unknown names and values out of range are refused."""

    model_config = ConfigDict(frozen=True, extra="forbid", use_attribute_docstrings=True, validate_default=True)
