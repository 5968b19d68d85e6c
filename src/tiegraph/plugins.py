"""Plug-ins: methods of other packages, which they offer as entry points of the groups ``tiegraph.masks`` (a
``MaskSource``), ``tiegraph.pairs`` (a pair source), ``tiegraph.features`` (an ``Extractor``), ``tiegraph.matchers`` (a
``Matcher``), ``tiegraph.dense`` (a ``DenseEngine``) and ``tiegraph.products`` (a function that writes files of a
surface into a folder). A setting that chooses such a method takes their names beside its own. Package and version of
what is chosen belong to the keys of the stages that use it: another version makes them run again.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from importlib.metadata import EntryPoint, entry_points
from typing import Any, get_args

from pydantic import AfterValidator, BaseModel

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


@dataclass(frozen=True)
class OrPlugin(AfterValidator):
    """The mark of a setting that takes a name of ``own``, a Literal or None, or that of a plug-in of the group."""

    group: str
    own: Any


def or_plugin(group: str, own: Any) -> OrPlugin:
    """Validator of a setting ``Annotated[own | str, or_plugin(group, own)]``; ``own``: Literal of tiegraph's names, or
    None."""

    def check(name: str) -> str:
        if name in get_args(own) or name in (there := installed(group)):
            return name
        plugins = f"installed plug-ins: {', '.join(sorted(there))}" if there else "no plug-in is installed"
        names = f"valid are {', '.join(get_args(own))}; " if own else ""
        raise ValueError(f"{names}{plugins} (entry points of the group tiegraph.{group})")

    return OrPlugin(func=check, group=group, own=own)


def packages(section: BaseModel) -> dict[str, dict[str, str]]:
    """The packages of the plug-ins that settings choose, with their versions: setting -> {package: version}."""
    found: dict[str, dict[str, str]] = {}
    for name, field in type(section).model_fields.items():
        value = getattr(section, name)
        for mark in _marks(field):
            others = {*(value if isinstance(value, tuple) else (value,))} - {*get_args(mark.own)}
            if others:
                points = [point for one, point in sorted(installed(mark.group).items()) if one in others]
                found[name] = {p.dist.name: p.dist.version for p in points if p.dist is not None}
    return found


def _marks(kind: Any) -> Iterator[OrPlugin]:
    """The marks of a field, or of the items of one."""
    for one in getattr(kind, "metadata", getattr(kind, "__metadata__", ())):
        if isinstance(one, OrPlugin):
            yield one
    for part in get_args(getattr(kind, "annotation", kind)):
        yield from _marks(part)
