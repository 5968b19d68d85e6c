"""What is spoiled in a folder of images, and odd values of command lines and settings files."""

from __future__ import annotations

import os
import random
import shutil
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Any, get_args

import cv2

from campaign import mutate
from campaign.mutate import Unfit
from campaign.world import SIZE
from tiegraph.project.settings import Settings

NONSENSE = ("nan", "inf", "-inf", "-1e9", "1e300", "abc", "99999999999999999999", "1,5", "None", "", "[]")
CRS = ("foo", "", "EPSG:4326", "EPSG:27700", "EPSG:32632", "EPSG:3857", "EPSG:999999", "EPSG:-1", "32654", "+proj=bad")
FLAGS = (
    ("--pool", "local:0"),
    ("--pool", "local:-3"),
    ("--pool", "nosuch"),
    ("--until", "nosuch"),
    ("--preset", "nosuch"),
    ("--rig", "nosuch"),
    ("--rig", "ring:0"),
    ("--rig", "ring:99999999"),
    ("--rig", "ladybug5"),
    ("--gnss", "/dev/null"),
    ("--times", "/"),
    ("--trajectory", "/dev/null"),
    ("--nosuch", "1"),
    ("-o",),
    ("--gcp", "/nosuch"),
)


@dataclass(frozen=True)
class Spoiled:
    """What was done; ``words``: one of them must be named; ``without``: images that the user took away; ``each``:
    images of which every one must be named if the result is another one without it."""

    what: str
    words: tuple[str, ...]
    without: tuple[str, ...] = ()
    each: tuple[str, ...] = ()


def images(folder: Path, rng: random.Random) -> Spoiled:
    """One to three images, or the folders they are in."""
    rules: tuple[Callable, ...] = (_bytes, _bytes, _bytes, _place, _other_picture, _folders, _taken)
    return rng.choice(rules)(folder, rng)


def image_names(folder: Path, rng: random.Random) -> Spoiled:
    """A file or folder gets an odd name, or an image that does not belong lies there under one."""
    path = rng.choice(_files(folder))
    victim = rng.choice((path, path, path.parent, path.parent.parent))
    way = rng.choice(("renamed", "added"))
    if way == "added" or victim == folder:
        victim = mutate.copied(path, rng)
    before = set(_files(folder))
    what = mutate.renamed(victim, rng)
    lost = [p for p in before if not p.exists() and not p.name.startswith("x")]
    new = [p for p in _files(folder) if p not in before]
    stem = os.fsencode(new[0].name if new else victim.name).decode(errors="replace")
    words = ("name", "encod", victim.name, stem, stem[:20], "UTF-8", "frame", "folder", "image")
    return Spoiled(what, words, tuple(p.relative_to(folder).as_posix() for p in lost))


def _files(folder: Path) -> list[Path]:
    return sorted(p for p in folder.rglob("*") if p.is_file() and not p.is_symlink())


def _some(folder: Path, rng: random.Random) -> list[Path]:
    return rng.sample(_files(folder), rng.choice((1, 1, 1, 2, 3)))


def _words(paths: list[Path], folder: Path) -> tuple[str, ...]:
    return tuple(p.relative_to(folder).as_posix() for p in paths)


def _bytes(folder: Path, rng: random.Random) -> Spoiled:
    paths, rule = _some(folder, rng), rng.choice(mutate.BYTES)
    what = "; ".join(f"{p.parent.name}/{rule(p, rng)}" for p in paths)
    return Spoiled(what, _words(paths, folder), each=_words(paths, folder))


def _place(folder: Path, rng: random.Random) -> Spoiled:
    paths, rule = _some(folder, rng), rng.choice(mutate.PLACES)
    what = "; ".join(f"{p.parent.name}/{rule(p, rng)}" for p in paths)
    names = _words(paths, folder)
    taken = names if rule in (mutate.gone, mutate.folder_instead) else ()
    return Spoiled(what, names, taken, () if taken else names)


def _other_picture(folder: Path, rng: random.Random) -> Spoiled:
    """Another size, another format under the same name, another image of the survey."""
    path = rng.choice(_files(folder))
    picture = cv2.imread(str(path))
    what = rng.choice(("half size", "one pixel less", "1x1", "PNG", "TIFF", "GIF", "black", "text", "another image"))
    if what == "half size":
        cv2.imwrite(str(path), cv2.resize(picture, (SIZE[0] // 2, SIZE[1] // 2)))
    elif what == "one pixel less":
        cv2.imwrite(str(path), picture[:-1])
    elif what == "1x1":
        cv2.imwrite(str(path), picture[:1, :1])
    elif what in ("PNG", "TIFF"):
        path.write_bytes(cv2.imencode(f".{what.lower()}", picture)[1].tobytes())
    elif what == "GIF":
        path.write_bytes(b"GIF89a\x01\x00\x01\x00\x00\x00\x00;")
    elif what == "black":
        cv2.imwrite(str(path), picture * 0)
    elif what == "text":
        path.write_text("no picture\n")
    else:
        shutil.copyfile(rng.choice([p for p in _files(folder) if p != path]), path)
    return Spoiled(f"{path.relative_to(folder)}: {what}", _words([path], folder))


def _folders(folder: Path, rng: random.Random) -> Spoiled:
    """Folders within folders that no walk may follow for ever, and things beside the images."""
    place = rng.choice([folder, *(p for p in folder.rglob("*") if p.is_dir())])
    what = rng.choice(
        ("link to itself", "two links to the images", "link to /", "deep", "pipe", "socket name", "table")
    )
    if what == "link to itself":
        (place / "again").symlink_to(".")
    elif what == "two links to the images":
        (place / "a").symlink_to(folder)
        (place / "b").symlink_to(folder)
    elif what == "link to /":
        (place / "root").symlink_to("/proc/self/fdinfo")
    elif what == "deep":
        deep = place / "/".join(["d"] * 200)
        deep.mkdir(parents=True)
    elif what == "pipe":
        os.mkfifo(place / "x.jpg")
    elif what == "socket name":
        (place / "x.jpg").symlink_to("nowhere.jpg")
    else:
        (place / "Thumbs.db").write_bytes(rng.randbytes(100))
        (place / "._000000.jpg").write_bytes(rng.randbytes(100))
    return Spoiled(f"{place.name}: {what}", ("x.jpg", "again", "link", "folder", "._000000.jpg", place.name))


def _taken(folder: Path, rng: random.Random) -> Spoiled:
    """Images, a camera or a pass taken away: the rest is a survey still."""
    level = rng.choice(("image", "camera", "pass camera"))
    path = rng.choice(_files(folder))
    if level == "image":
        gone = _some(folder, rng)
    else:
        camera = path.parent.name
        gone = [p for p in _files(folder) if p.parent.name == camera and (level == "camera" or p.parent == path.parent)]
    for each in gone:
        each.unlink()
        if level != "image" and not any(each.parent.iterdir()):
            each.parent.rmdir()
    names = _words(gone, folder)
    return Spoiled(
        f"{len(gone)} images taken away ({level})", (*names, "cam", "sensor", "rig", "frame", "image"), names
    )


def setting(rng: random.Random) -> tuple[str, list[str], Spoiled]:
    """(stage, arguments, what) of a value that cannot be meant."""
    stage = rng.choice([s for s in Settings.model_fields if s not in ("shots", "tuning")])
    section = type(getattr(Settings(), stage))
    name = rng.choice(list(section.model_fields))
    option = f"--{stage}.{name.replace('_', '-')}"
    value = rng.choice(CRS if name == "crs" else NONSENSE)
    annotation = section.model_fields[name].annotation
    if annotation is bool:
        raise Unfit
    arguments = [option, value]
    if _is_path(annotation):
        arguments = [option, rng.choice(("/nosuch/file", "/dev/null", "/proc/self/mem", "/", "x" * 300, "a\nb"))]
    return (
        stage,
        arguments,
        Spoiled(" ".join(arguments)[:100], (name, option[2:], value, arguments[-1].split("\n")[0][:40])),
    )


def _is_path(annotation: Any) -> bool:
    return annotation is Path or Path in get_args(annotation)


def settings_text(text: str, rng: random.Random) -> tuple[str, str]:
    """(stage, text of a tiegraph.toml) with the values of a stage spelled out as they are by default."""
    import tomli_w

    stage = rng.choice([s for s in Settings.model_fields if s not in ("shots", "tuning")])
    values = getattr(Settings(), stage).model_dump(mode="json")
    table = {stage: {k: v for k, v in values.items() if v is not None}}
    return stage, f"{text}\n{tomli_w.dumps(table)}"
