"""How a bag and its topics are named: ``run.bag``, ``run.bag:/gps/fix``, ``run.bag:/left/image,/right/image``."""

from pathlib import Path

from tiegraph.scene.names import clean
from tiegraph.scene.regular import regular

ROS1 = (".bag", ".active")  # the second while it is recorded
SUFFIXES = (*ROS1, ".mcap", ".db3")
METADATA, _MARK, _HEAD = "metadata.yaml", b"rosbag2_bagfile_information", 4096


def split_topics(path: Path) -> tuple[Path, tuple[str, ...]]:
    """What a path names, and the topics that stand behind it: (``run.bag``, ("/gps/fix",)), or (the path, ())."""
    head, _, tail = str(path).rpartition(":")
    bag = Path(head)
    if not head or not tail or path.exists() or not (bag.is_dir() or _is_file(bag)):
        return path, ()
    return bag, tuple(in_full(name) for name in tail.split(",") if name.strip("/"))


def in_full(topic: str) -> str:
    """A topic's name with the slash before it, which need not be written."""
    return f"/{topic.strip('/')}"


def source_of(path: Path) -> Path:
    """What a path names, without topics."""
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
