"""Recordings of ROS 1 and ROS 2 (bags), as far as a survey needs them; read by ``rosbags``, an extra.

A bag is named by its path, and some of its contents by topics, ``run.bag:/gps/fix`` or
``run.bag:/left/image,/right/image``, wherever a file can be named. Only messages of ROS's own packages are read. Their
definitions are the same in every release, so those in the bag are not used, and missing ones do not matter.
Messages come one after another: a bag may be larger than the memory. Positions are read in ``scene.gnss.solutions``,
poses in ``scan.priors.trajectory``, pixels in ``scan.videos.bagfilms``, which asks which topics are cameras.

A message has two times: in its header, of the measurement, and of its receipt, later by the transmission. The first
counts; if it is not set, the second.
"""

from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import dataclass
from importlib import import_module
from pathlib import Path
from typing import Any

from tiegraph.errors import InputError, optional
from tiegraph.scene.atomic import regular
from tiegraph.scene.names import clean
from tiegraph.text import some

ROS1 = (".bag", ".active")  # the second while it is recorded
SUFFIXES = (*ROS1, ".mcap", ".db3")
METADATA, _MARK, _HEAD = "metadata.yaml", b"rosbag2_bagfile_information", 4096


def split_topics(path: Path) -> tuple[Path, tuple[str, ...]]:
    """Path and topics of a name: (``run.bag``, ("/gps/fix",)), or (the path, ())."""
    head, _, tail = str(path).rpartition(":")
    bag = Path(head)
    if not head or not tail or path.exists() or not (bag.is_dir() or _is_file(bag)):
        return path, ()
    return bag, tuple(in_full(name) for name in tail.split(",") if name.strip("/"))


def in_full(topic: str) -> str:
    """A topic's name with the leading slash, which may be omitted."""
    return f"/{topic.strip('/')}"


def source_of(path: Path) -> Path:
    """The path of a name, without topics."""
    return split_topics(path)[0]


def of_topic(bag: Path, topic: str) -> Path:
    """The name of a topic of a bag."""
    return Path(f"{bag}:{topic}")


def shown(bag: Path, topic: str) -> str:
    """A topic of a bag, without the folders it lies in."""
    return clean(str(of_topic(Path(bag.name), topic)))


def is_bag(path: Path) -> bool:
    """Whether a path is that of a bag, or of topics of one: a file by its suffix, a folder by its metadata.yaml and the
    files beside it."""
    bag = source_of(path)
    if not bag.is_dir():
        return _is_file(bag)
    try:
        with regular(bag / METADATA).open("rb") as file:
            return _MARK in file.read(_HEAD) or any(f.suffix.lower() in SUFFIXES for f in bag.iterdir())
    except OSError:
        return False


def _is_file(path: Path) -> bool:
    return path.suffix.lower() in SUFFIXES and path.exists()


@dataclass(frozen=True)
class Topic:
    """A topic, the kind of its messages ("sensor_msgs/Image", perhaps with an encoding that is not ROS's own) and their
    number."""

    name: str
    kind: str
    count: int

    def __str__(self) -> str:
        return f"{clean(self.name)} ({clean(self.kind)}, {self.count})"


class Bag:
    """The result of ``open_bag``."""

    def __init__(self, path: Path, reader: Any, decoded: Callable[[bytes, str], Any]) -> None:
        self.path, self._reader, self._decoded = path, reader, decoded
        self._name = clean(str(path))
        self._connections: dict[Topic, list[Any]] = {}
        by_name: dict[tuple[str, str], list[Any]] = {}
        for connection in reader.connections:
            encoding = getattr(connection.ext, "serialization_format", "cdr")
            kind = connection.msgtype.replace("/msg/", "/") + ("" if encoding == "cdr" else f" in {encoding}")
            by_name.setdefault((connection.topic, kind), []).append(connection)
        for (name, kind), mine in sorted(by_name.items()):
            self._connections[Topic(name, kind, sum(c.msgcount for c in mine))] = mine
        self.topics = tuple(self._connections)

    def messages(self, topic: Topic) -> Iterator[tuple[Any, int]]:
        """The messages of a topic in the order of their receipt, with its time (ns); at least one, if it counts any.
        Raises InputError for a damaged bag."""
        left = topic.count
        with _reading(self.path):
            for connection, received_ns, data in self._reader.messages(connections=self._connections[topic]):
                yield self._decoded(data, connection.msgtype), received_ns
                left = 0
            if left:
                raise ValueError(f"it should have {topic}, and has none")

    def of_kinds(self, kinds: Sequence[str], asked: Sequence[str] = ()) -> list[Topic]:
        """The topics that have messages of some kinds; the requested ones, if any.

        Raises InputError, with a list, if a requested one is not among them, and if there is none.
        """
        found = [t for t in self.topics if t.kind in kinds and t.count]
        for name in asked:
            mine = [t for t in self.topics if in_full(t.name) == name]
            if not set(mine) & set(found):
                what = f"topic {mine[0]} has no messages of" if mine else f"has no topic {clean(name)} of"
                raise InputError(f"{self._name}: {what} {_either(kinds)}; {self._listed(found)}")
        if not found:
            raise InputError(f"{self._name}: no messages of {_either(kinds)}; {self._listed([])}")
        return [t for t in found if in_full(t.name) in asked] if asked else found

    def only(self, kinds: Sequence[str], asked: Sequence[str]) -> Topic:
        """The one topic of some kinds. Raises InputError, naming them, for several, and as ``of_kinds``."""
        found = self.of_kinds(kinds, asked)
        if len(found) > 1 or len(asked) > 1:
            one = of_topic(self.path, found[0].name)
            raise InputError(f"{self._name}: {self._listed(found)}: name one of them, such as {clean(str(one))}")
        return found[0]

    def _listed(self, topics: Sequence[Topic]) -> str:
        """Topics in words; if there are none, all topics of the bag."""
        listed, what = topics or self.topics, "topics of that kind" if topics else "topics in it"
        return f"{len(listed)} {what}: {some(map(str, listed), 12)}" if listed else "it is empty"


@contextmanager
def open_bag(path: Path) -> Iterator[Bag]:
    """A bag of ROS 1 (a file) or ROS 2 (a folder, or a file of one).

    Raises EngineMissing without ``rosbags``, and InputError for what cannot be opened: no bag, cut off, not indexed.
    """
    ros1 = path.suffix.lower() in ROS1 and not path.is_dir()
    rosbags = optional("rosbags.rosbag1" if ros1 else "rosbags.rosbag2", "ros", f"{clean(str(path))}: a bag of ROS")
    types = import_module("rosbags.typesys")
    store = types.get_typestore(types.Stores.ROS1_NOETIC if ros1 else types.Stores.LATEST)
    with _reading(path):
        for file in [f for f in path.iterdir() if f.suffix] if path.is_dir() else [path]:
            regular(file, None)
        reader = rosbags.Reader(path)
        reader.open()
    try:
        yield Bag(path, reader, store.deserialize_ros1 if ros1 else store.deserialize_cdr)
    finally:
        reader.close()


@contextmanager
def _reading(path: Path) -> Iterator[None]:
    """Errors of rosbags and its readers for a damaged bag, as an InputError."""
    try:
        yield
    except InputError:
        raise
    except Exception as error:  # also MemoryError (of lengths that are none), and those of SQLite, LZ4, Zstandard, YAML
        why = clean(str(getattr(error, "strerror", None) or error).replace("\n", " ")) or type(error).__name__
        kinds = {f.suffix.lower() for f in (path.iterdir() if path.is_dir() else [path])}
        tool = "`rosbag reindex`" if kinds & {*ROS1} else "`mcap recover`" if ".mcap" in kinds else "`sqlite3 .recover`"
        more = " or `ros2 bag reindex`" if path.is_dir() else ""
        raise InputError(
            f"{clean(str(path))}: cannot be read as a ROS bag ({why:.200}); if its recording was interrupted, "
            f"{tool}{more} may repair it, else copy it again"
        ) from None


def stamp_ns(header: Any, received_ns: int) -> int:
    """Time of measurement of a message (ns): by its header, or if that is not set, of its receipt."""
    return int(header.stamp.sec) * 10**9 + int(header.stamp.nanosec) or received_ns


def _either(kinds: Sequence[str]) -> str:
    return " or ".join([", ".join(kinds[:-1]), kinds[-1]] if len(kinds) > 1 else kinds)
