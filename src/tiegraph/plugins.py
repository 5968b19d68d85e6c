"""Plug-ins: methods of other packages, which they offer as entry points of the groups ``tiegraph.masks`` (a
``MaskSource``), ``tiegraph.pairs`` (a pair source), ``tiegraph.features`` (an ``Extractor``) and ``tiegraph.dense`` (a
``DenseEngine``). A setting that chooses such a method takes their names beside its own.
"""

from importlib.metadata import EntryPoint, entry_points
from typing import Any, get_args

from pydantic import AfterValidator

from tiegraph.errors import EngineMissing


def installed(group: str) -> dict[str, EntryPoint]:
    """The plug-ins of a group by name."""
    return {point.name: point for point in entry_points(group=f"tiegraph.{group}")}


def chosen(group: str, name: str, own: dict[str, Any]) -> Any:
    """The method of that name: one of ``own``, else a plug-in. Raises EngineMissing if it cannot be loaded."""
    if name in own:
        return own[name]
    try:
        return installed(group)[name].load()
    except KeyError:
        raise EngineMissing(f"no plug-in {name!r} of the group tiegraph.{group} is installed here") from None
    except Exception as error:  # whatever the package of somebody else does
        raise EngineMissing(
            f"the plug-in {name!r} of the group tiegraph.{group} cannot be loaded: {error!r}"
        ) from error


def or_plugin(group: str, own: Any) -> AfterValidator:
    """Validator of a setting ``Annotated[own | str, or_plugin(group, own)]``; ``own``: Literal of tiegraph's names."""

    def check(name: str) -> str:
        if name in get_args(own) or name in (there := installed(group)):
            return name
        plugins = f"installed plug-ins: {', '.join(sorted(there))}" if there else "no plug-in is installed"
        raise ValueError(
            f"valid are {', '.join(get_args(own))}; {plugins} (entry points of the group tiegraph.{group})"
        )

    return AfterValidator(check)
