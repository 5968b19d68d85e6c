"""XML as a tree of elements with their lines; no entities, no name spaces."""

from collections.abc import Iterator
from dataclasses import dataclass, field
from pathlib import Path
from xml.parsers import expat

from tiegraph.errors import InputError


@dataclass
class Element:
    """An element without the prefix of its name."""

    name: str
    line: int
    given: dict[str, str]
    text: str = ""
    children: "list[Element]" = field(default_factory=list)

    def all(self, name: str) -> "Iterator[Element]":
        """Elements of a name at any depth, in their order."""
        todo: list[Element] = [self]
        while todo:
            node = todo.pop()
            if node.name == name:
                yield node
            todo.extend(reversed(node.children))

    def said(self, name: str) -> str:
        """Text of the first child of a name, "" without one."""
        return next((c.text.strip() for c in self.children if c.name == name), "")


def parse_xml(path: Path, raw: bytes) -> Element:
    """The elements of an XML file. Raises InputError, with the line, for one that is damaged or defines entities."""
    parser = expat.ParserCreate()
    parser.buffer_text = True
    root = Element("", 0, {})
    open_ = [root]

    def start(name: str, given: dict[str, str]) -> None:
        open_[-1].children.append(Element(name.rpartition(":")[2], parser.CurrentLineNumber, given))
        open_.append(open_[-1].children[-1])

    def data(text: str) -> None:
        open_[-1].text += text

    def entity(*_: object) -> None:
        raise InputError(f"{path}, line {parser.CurrentLineNumber}: defines entities, which no export needs: remove it")

    parser.StartElementHandler, parser.CharacterDataHandler, parser.EntityDeclHandler = start, data, entity
    parser.EndElementHandler = lambda name: open_.pop()
    try:
        parser.Parse(raw, True)
    except InputError:
        raise
    except expat.ExpatError as error:
        raise InputError(
            f"{path}, line {error.lineno}: XML that is cut off or damaged ({expat.ErrorString(error.code)}): export "
            "it again"
        ) from None
    except (LookupError, ValueError) as error:  # of an encoding that expat does not know itself
        raise InputError(f"{path}, line 1: XML that cannot be decoded ({error}): save it as UTF-8") from None
    return root
