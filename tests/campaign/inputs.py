"""Inputs spoiled by rule: every kind of input times the rules of `mutate` and `spoil`."""

from __future__ import annotations

import json
import random
import shutil
from collections.abc import Callable
from dataclasses import dataclass, replace
from pathlib import Path

from campaign import mutate, oracle, spoil
from campaign.case import Case, Result
from campaign.compare import (
    INPUT_CLOUD_SHARE,
    INPUT_POSE_M,
    differences,
    outcome_differences,
    stated_sigma,
    summary,
)
from campaign.process import Ended, Server
from campaign.spoil import Spoiled
from campaign.world import NAMES, PATIENCE_S, World, fingerprint
from tiegraph.pipeline import STAGES
from tiegraph.text import printable

SCAN_S = 120.0
_METRIC_SHARE = 0.25
_PLACE = ["--evaluate.reference-origin", "35.6965", "139.7695", "40.0"]


@dataclass(frozen=True)
class Kind:
    """A kind of input. ``file`` below the inputs; ``options``: what makes the run read it ({} = the inputs); ``after``:
    the stage whose clean run it starts from; ``until``: where its effect shows; ``words``: one must be named."""

    name: str
    file: str
    rules: tuple[Callable, ...]
    words: tuple[str, ...]
    options: tuple[str, ...] = ()
    after: str = ""
    until: str = "georef"
    weight: int = 2


_TABLE = (*mutate.TABLES, *mutate.TABLES, *mutate.BYTES, *mutate.PLACES)
_TEXT = (*mutate.STRUCTURED, *mutate.STRUCTURED, *mutate.BYTES, *mutate.PLACES)
_PLAIN = (*mutate.BYTES, *mutate.PLACES)
_GNSS = ("gnss", "position", "lat", "lon", "height", "sigma", "receiver", "crs", "metres", "time")
_RIG = ("rig", "sensor", "camera", "cam0", "cam1", "focal", "axes", "calibrat", "baseline", "lens", "yaw")
_GCP = ("gcp", "control", "point", "mark", "p1", "p2", "p3", "p4")
_PAIRS = (*mutate.BYTES, *mutate.PLACES, mutate.names, mutate.encoded, mutate.separators, mutate.row)
_CLOUD = (*_PLAIN, mutate.number, mutate.encoded, mutate.names)
KINDS = (
    Kind("images", "images", (), (), weight=6),
    Kind("names", "images", (), (), weight=4),
    Kind("gnss", "gnss.csv", _TABLE, _GNSS, weight=6),
    Kind("times", "times.csv", _TABLE, ("times", "time", "frame", "pass", "clock"), weight=4),
    Kind("rig", "rig.toml", _TEXT, _RIG, weight=5),
    Kind("rig json", "rig_config.json", _TEXT, _RIG, ("--rig", "{}/rig_config.json")),
    Kind("trajectory", "trajectory.tum", _TABLE, ("trajectory", "pose", "quaternion", "time", "position", "prior"),
         ("--trajectory", "{}/trajectory.tum"), weight=3),
    Kind("gcp", "gcp.csv", _TABLE, _GCP, ("--gcp", "{}/gcp.csv"), "sparse"),
    Kind("gcp list", "gcp_list.txt", _TABLE, _GCP, ("--gcp", "{}/gcp_list.txt"), "sparse"),
    Kind("pairs", "pairs.txt", _PAIRS, ("pairs", "pair list", "pair"),
         ("--candidates.sources", "file", "--candidates.pairs-file", "{}/pairs.txt", "--coarse.method", "off"),
         "preview", "network"),
    Kind("masks", "masks", _PLAIN, ("mask",), ("--masks.folder", "{}/masks"), "scan", "masks"),
    Kind("mask model", "model.toml", _TEXT, ("model", "onnx", "class", "size", "mean", "deviation"),
         ("--masks.source", "model", "--masks.model", "{}/model.toml"), "scan", "masks", 1),
    Kind("reference", "reference.tum", _TABLE, ("reference", "pose", "trajectory", "quaternion"),
         ("--evaluate.reference", "{}/reference.tum", *_PLACE), "cloud", "evaluate"),
    Kind("ref. cloud", "reference.ply", _CLOUD, ("reference", "cloud", "point", "ply"),
         ("--evaluate.reference-cloud", "{}/reference.ply", *_PLACE), "cloud", "evaluate"),
    Kind("video", "video/walk.avi", _PLAIN, ("walk.avi", "video"), until="scan"),
    Kind("values", "", (), (), weight=6),
    Kind("settings", "", (), (), weight=4),
)  # fmt: skip
_ROUND = [k for k in KINDS for _ in range(k.weight)]


class Clean(dict):
    """{kind: (clean run folder, what it said)}, made when it is asked for: of the kinds that need other options than
    the clean run a run of its own. ``short``: whether the campaign is."""

    def __init__(self, world: World, server: Server, short: bool) -> None:
        super().__init__(short=short)
        self._world, self._server = world, server

    def __missing__(self, name: str) -> tuple[Path, str]:
        kind = next(k for k in KINDS if k.name == name)
        self[name] = self._made(kind) if kind.options or name == "video" else self._as_clean(kind)
        return self[name]

    def _made(self, kind: Kind) -> tuple[Path, str]:
        until = "scan" if self["short"] and not kind.after else kind.until
        folder = self._world.root / "kinds" / f"{kind.name.replace(' ', '-')}-{until}"
        ended = None
        if not (folder / "said.txt").exists():
            shutil.rmtree(folder, ignore_errors=True)
            run_folder = self._world.after(kind.after, folder / "out")
            command = _command(kind, self._world, self._world.inputs, run_folder, until)
            ended = self._server.run(command, folder, PATIENCE_S)
        if ended is not None and not ended.good and kind.name != "mask model":  # without ONNX Runtime it fails
            raise RuntimeError(f"the clean run of {kind.name} failed: {ended}")
        return folder / "out", _all_said(folder / "out", (folder / "said.txt").read_text(), self._world.inputs)

    def _as_clean(self, kind: Kind) -> tuple[Path, str]:
        said = "\n".join((self._world.root / "clean" / "said.txt").read_text().splitlines())
        return self._world.clean[kind.until], _all_said(self._world.clean["report"], said, self._world.inputs)


def prepare(world: World, server: Server, short: bool) -> Clean:
    """What clean runs said; in the long form, whose workers go side by side, of all kinds at once."""
    clean = Clean(world, server, short)
    for kind in () if short else KINDS:
        clean[kind.name]
    return clean


def _command(kind: Kind, world: World, inputs: Path, out: Path, until: str = "") -> list[str]:
    end = ["--pool", "serial", "--until", until or kind.until]
    if kind.name == "video":
        return ["run", str(inputs / "video"), "-o", str(out), *end]
    base = world.inputs if kind.after else inputs  # else all that was made from another folder would be out of date
    command = world.command(out, *(o.replace("{}", str(inputs)) for o in kind.options), *end, inputs=base)
    if kind.name == "trajectory":  # in the place of GNSS
        at = command.index("--gnss")
        del command[at : at + 2]
    return command


def _all_said(out: Path, text: str, inputs: Path) -> str:
    """What was said on the terminal and in the receipts, paths of the inputs made equal."""
    lines = [text]
    for path in [*out.glob("receipts/*.json"), *out.glob("*/receipts/*.json")]:
        try:
            receipt = json.loads(path.read_text())
        except (OSError, ValueError):
            continue
        # A receipt holds what was said as it is; escaped it goes to people only.
        lines += [printable(f". {note}") for note in receipt.get("notes", [])]
        lines += [printable(f". {name}: {reason}") for name, reason in receipt.get("dropped", [])]
    return "\n".join(lines).replace(str(inputs), "INPUTS")


def run(case: Case) -> Result:
    """One spoiled input; the kinds go round with the case's number."""
    kind = _ROUND[case.index * 17 % len(_ROUND)]  # 17 and the length have no common divisor
    if kind.name == "values":
        return _value(case)
    if kind.name == "settings":
        return _settings(case)
    inputs = Path(shutil.copytree(case.world.inputs, case.folder / "inputs", symlinks=True))
    spoiled = _spoil(kind, inputs, case.rng)
    marks = fingerprint(inputs)
    out = case.world.after(kind.after, case.folder / "out")
    verdict, ended = _judge(case, kind, spoiled, inputs, out)
    verdict = _nothing_lost(case, inputs, marks) or verdict
    return case.result(kind.name, spoiled.what, verdict, ended.text)


def _spoil(kind: Kind, inputs: Path, rng: random.Random) -> Spoiled:
    for _ in range(50):
        try:
            if kind.name == "images":
                return spoil.images(inputs / "images", rng)
            if kind.name == "names":
                return spoil.image_names(inputs / "images", rng)
            path = inputs / kind.file
            if kind.name == "masks":
                path = rng.choice(sorted(p for p in path.rglob("*.png")))
            what = rng.choice(kind.rules)(path, rng)
            return Spoiled(what, (path.name, *kind.words))
        except (mutate.Unfit, UnicodeError):
            continue
    raise RuntimeError(f"no rule fits {kind.name}")


def _nothing_lost(case: Case, inputs: Path, marks: dict[bytes, str]) -> oracle.Verdict | None:
    """The inputs are as they were and nothing was written beside the run folder."""
    if fingerprint(inputs) != marks:
        return oracle.Verdict(oracle.LOSS, "the inputs were changed")
    strange = {p.name for p in case.folder.iterdir()} - {"inputs", "out", "said.txt"}
    return oracle.Verdict(oracle.LOSS, f"written beside the run folder: {sorted(strange)}") if strange else None


def _judge(case: Case, kind: Kind, spoiled: Spoiled, inputs: Path, out: Path) -> tuple[oracle.Verdict, Ended]:
    """Run to the scan first, where most must end; further where the scene has changed."""
    clean, clean_text = case.context[kind.name]
    at_scan = not kind.after and kind.until != "scan"
    if at_scan:
        ended = case.server.run(_command(kind, case.world, inputs, out, "scan"), case.folder, SCAN_S)
        if ended.code != 0 or ended.hung:
            return oracle.refusal(ended, spoiled.words), ended
        told = oracle.said(_all_said(out, ended.text, inputs), clean_text, spoiled.words)
        told = told if all(oracle.holds("\n".join(told), [name]) for name in spoiled.each) else []
        looks_same = kind.name not in ("images", "names") and not _other_scene(clean, out)
        if looks_same or (told and (case.context["short"] or (kind.name != "names" and case.rng.random() < 0.67))):
            text = _all_said(out, ended.text, inputs)
            return oracle.passed(replace(ended, text=text), clean_text, spoiled.words, ()), ended
        if case.context["short"]:
            return oracle.text_fault(ended) or oracle.Verdict(oracle.LATER), ended
    ended = case.server.run(_command(kind, case.world, inputs, out), case.folder, PATIENCE_S)
    if ended.code != 0 or ended.hung:
        return oracle.refusal(ended, spoiled.words), ended
    text = _all_said(out, ended.text, inputs)
    notes = oracle.said(text, clean_text, spoiled.words)
    told = "\n".join(notes)
    named = tuple(n for n in spoiled.each if oracle.holds(told, [n]))
    allowed = replace(spoiled, without=(*spoiled.without, *named))
    different = [] if legitimate(kind, inputs) else _different(kind, clean, out, allowed)
    verdict = oracle.passed(replace(ended, text=text), clean_text, spoiled.words, different)
    contradicted = any(line.startswith("! ") for line in notes)
    if verdict.name == oracle.SAID and len(named) < len(spoiled.each) and different and not contradicted:
        verdict = oracle.Verdict(oracle.SILENT, f"only {named} named; {'; '.join(different[:4])}")
    return verdict, ended


def _other_scene(clean: Path, out: Path) -> bool:
    """Does the scene differ in more than what it says of itself?"""
    scenes = [json.loads(next(f.rglob("scene.json")).read_text()) for f in (clean, out)]
    for scene in scenes:
        for name in ("notes", "dropped"):
            scene.pop(name, None)
    return scenes[0] != scenes[1]


def legitimate(kind: Kind, inputs: Path) -> bool:
    """Is the spoiled file a right one that says something else? Then nothing has to be said."""
    if kind.name != "pairs":
        return False
    try:
        rows = [line.split() for line in (inputs / kind.file).read_text().splitlines() if line.strip()]
    except (OSError, UnicodeError):
        return False
    names = {p.relative_to(inputs / "images").as_posix() for p in (inputs / "images").rglob("*.jpg")}
    pairs = {frozenset(row) for row in rows}
    return bool(rows) and len(pairs) == len(rows) and all(len(p) == 2 and p <= names for p in pairs)


def _different(kind: Kind, clean: Path, out: Path, spoiled: Spoiled) -> list[str]:
    """How the result differs from the clean run's beyond what the user took away."""
    if kind.until == "evaluate":
        return _metrics(clean, out)
    if kind.until == "scan":
        a, b = (len(json.loads(next(f.rglob("scene.json")).read_text())["names"]) for f in (clean, out))
        return [] if a == b else [f"{b} images instead of {a}"]
    if kind.until in ("masks", "network"):
        return differences(clean, out, until=kind.until)
    a, b = summary(clean, kind.until), summary(out, kind.until)
    # What is wrong by less than the run itself says is not wrong without a word.
    return outcome_differences(a, b, max(INPUT_POSE_M, stated_sigma(out)), INPUT_CLOUD_SHARE, spoiled.without)


def _metrics(clean: Path, out: Path) -> list[str]:
    a, b = ({k: v for k, v in _flat(json.loads((f / "metrics.json").read_text()))} for f in (clean, out))
    lost = [f"{k} is missing" for k in a if k not in b]
    return lost + [
        f"{k}: {b[k]} instead of {a[k]}"
        for k in a
        if k in b and not abs(b[k] - a[k]) <= _METRIC_SHARE * max(abs(a[k]), abs(b[k]), 0.05)
    ]


def _flat(value: object, name: str = "") -> list[tuple[str, float]]:
    if isinstance(value, dict):
        return [pair for k, v in value.items() for pair in _flat(v, f"{name}.{k}")]
    if isinstance(value, list):
        return [pair for k, v in enumerate(value) for pair in _flat(v, f"{name}.{k}")]
    return [(name, float(value))] if isinstance(value, (int, float)) else []


def _value(case: Case) -> Result:
    """An odd value on the command line: run the stage it is for, from the clean run of the stage before."""
    rng = case.rng
    if rng.random() < 0.25:
        arguments = list(rng.choice(spoil.FLAGS))
        stage, spoiled = "scan", Spoiled(" ".join(arguments), (*arguments, *(a.lstrip("-") for a in arguments)))
    else:
        while True:
            try:
                stage, arguments, spoiled = spoil.setting(rng)
                break
            except mutate.Unfit:
                continue
    before = NAMES[NAMES.index(stage) - 1] if stage != NAMES[0] else ""
    out = case.world.after(before, case.folder / "out")
    command = case.world.command(out, "--pool", "serial", "--until", stage)
    if arguments[0] in command and len(arguments) == 2 and arguments[0] != "-o":
        command[command.index(arguments[0]) + 1] = arguments[1]
    else:
        command += arguments
    return _one_stage(case, "values", stage, command, spoiled)


def _settings(case: Case) -> Result:
    """A spoiled tiegraph.toml in the run folder."""
    rng = case.rng
    base = (case.world.clean[NAMES[0]] / "tiegraph.toml").read_text()
    stage, text = spoil.settings_text(base, rng)
    before = NAMES[NAMES.index(stage) - 1] if stage != NAMES[0] else NAMES[0]
    out = case.world.after(before, case.folder / "out")
    path = out / "tiegraph.toml"
    path.write_text(text)
    what = ""
    while not what:
        try:
            if rng.random() < 0.4:
                what = _nonsense(path, rng)
            else:
                rules = (mutate.structure, mutate.encoded, *_PLAIN)
                what = rng.choice(rules)(path, rng)
        except (mutate.Unfit, UnicodeError):
            continue
    command = case.world.command(out, "--pool", "serial", "--until", stage)
    return _one_stage(case, "settings", stage, command, Spoiled(what, ("tiegraph.toml", stage, "setting", "run")))


def _nonsense(path: Path, rng: random.Random) -> str:
    lines = path.read_text().splitlines()
    at = rng.choice([k for k, line in enumerate(lines) if "=" in line])
    key = lines[at].split("=")[0]
    value = rng.choice(("nan", "inf", "-inf", "-1e9", "1e300", "5", "[5]", '"abc"', "{}", "1979-05-27", ""))
    lines[at] = f"{key}= {value}"
    path.write_text("\n".join(lines) + "\n")
    return f"{path.name}, line {at + 1}: {lines[at]}"


def _one_stage(case: Case, kind: str, stage: str, command: list[str], spoiled: Spoiled) -> Result:
    ended = case.server.run(command, case.folder, PATIENCE_S)
    clean_text = case.context["images"][1]
    out = case.folder / "out"
    if ended.code != 0 or ended.hung:
        verdict = oracle.refusal(ended, spoiled.words)
    else:
        text = _all_said(out, ended.text, case.world.inputs)
        until = next(s.name for s in STAGES if s.name == stage)
        different = differences(case.world.clean[stage], out, until=until)
        verdict = oracle.passed(replace(ended, text=text), clean_text, spoiled.words, different)
    if fingerprint(case.world.inputs) != case.world.marks:
        verdict = oracle.Verdict(oracle.LOSS, "the inputs were changed")
    return case.result(kind, f"{stage}: {spoiled.what}", verdict, ended.text)


__all__ = ["KINDS", "prepare", "run"]
