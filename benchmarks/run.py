"""Run competitors on data sets and keep the figures as JSON: ``python benchmarks/run.py --sets canal_demo -o x.json``.

Competitors take turns on each set; each run is a fresh process in an empty folder; its CPU time is that of the process
and all its children. A run that fails or takes too long is a row too. What does not depend on the seed of a mapper is
made once, and its time counts in the rows of all seeds.
"""

from __future__ import annotations

import argparse
import json
import os
import platform
import shutil
import sys
import tempfile
from collections.abc import Sequence
from datetime import datetime, timezone
from importlib import metadata
from pathlib import Path
from typing import Any

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

import numpy as np

import tiegraph  # noqa: F401  before pycolmap
from benchmarks import accuracy, datasets, table
from benchmarks.measure import measured
from tiegraph.geometry import transforms
from tiegraph.geometry.geodesy import Origin
from tiegraph.scan.rigfiles.rigfile import read_rig_file
from tiegraph.scan.tuning import RigTuning
from tiegraph.scene.rig import camera_to_dict

_COMPETITORS = Path(__file__).resolve().parent / "competitors"
_PROGRAMS: dict[str, tuple[str, ...]] = {  # program and its words
    "tiegraph": ("tiegraph_run.py",),
    "colmap_exhaustive": ("colmap.py",),
    "colmap_sequential": ("colmap.py", "sequential"),
    "colmap_spatial": ("colmap.py", "spatial"),
    "colmap_exhaustive_mixed": ("colmap.py", "mixed"),
    "colmap_sequential_mixed": ("colmap.py", "sequential", "mixed"),
    "colmap_spatial_mixed": ("colmap.py", "spatial", "mixed"),
    "colmap_rig": ("colmap.py", "rig"),
    "colmap_sequential_rig": ("colmap.py", "sequential", "rig"),
    "glomap": ("colmap.py", "global"),
    "glomap_sequential": ("colmap.py", "sequential", "global"),
    "glomap_sequential_rig": ("colmap.py", "sequential", "rig", "global"),
    "openmvg": ("openmvg.py",),
}
_PACKAGES = ("tiegraph", "pycolmap", "opencv-python-headless", "numpy", "scipy")


def main(argv: list[str] | None = None) -> int:
    """Run what the command line asks; 0 if every run was done, 1 if one failed."""
    args = _arguments(argv)
    results = load_results(args.output, args.note)
    if args.work is not None:
        args.work.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(prefix="tiegraph-benchmark-", dir=args.work) as folder:
        for name in args.sets:
            dataset = datasets.load(name, Path(folder) / "inputs")
            first: dict[str, dict[str, Any]] = {}
            for seed in args.seeds:
                for competitor in args.competitors:
                    row = run_one(dataset, competitor, seed, Path(folder), args, first.get(competitor))
                    first.setdefault(competitor, row)
                    add_row(results, row, args.output)
                    sys.stderr.write(f"{name} {competitor}: {row['status']}, {row['wall_s']:.0f} s\n")
    sys.stdout.write(table.markdown(results, args.against) + "\n")
    wanted = [row for row in results["runs"] if row["set"] in args.sets and row["competitor"] in args.competitors]
    return 0 if all(row["status"] == "done" for row in wanted) else 1


def _arguments(argv: list[str] | None) -> argparse.Namespace:
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0])
    parser.add_argument("--sets", nargs="+", required=True, choices=sorted(datasets.LOADERS), metavar="SET")
    parser.add_argument(
        "--competitors", nargs="+", default=["tiegraph", "colmap_exhaustive"], type=_competitor,
        help=f"{', '.join(_PROGRAMS)}; tiegraph:PRESET, or tiegraph:masks.source=none for any setting",
    )  # fmt: skip
    parser.add_argument(
        "--seeds", type=int, nargs="+", default=[0],
        help="of the mappers: the first is a whole run of each competitor, the others map its matches anew",
    )  # fmt: skip
    parser.add_argument("--until", default="georef", help="last stage of tiegraph (report: the whole way)")
    parser.add_argument("--calibrated", action="store_true", help="give COLMAP the calibration that tiegraph is given")
    parser.add_argument("--timeout", type=float, default=7200.0, help="seconds a run may take")
    parser.add_argument("--work", type=Path, help="where the work folders go (default: the system's temporary folder)")
    parser.add_argument("--keep", type=Path, help="keep the run folders below this folder")
    parser.add_argument("--against", default="colmap_exhaustive", help="competitor the printed ratios refer to")
    parser.add_argument("--note", default="", help="said in the JSON, for instance what else the machine was doing")
    parser.add_argument("-o", "--output", type=Path, required=True, help="JSON file; runs are added to it")
    return parser.parse_args(argv)


def _competitor(name: str) -> str:
    if name.partition(":")[0] not in _PROGRAMS:
        raise argparse.ArgumentTypeError(f"unknown competitor {name!r}: valid are {', '.join(_PROGRAMS)}")
    return name


def run_one(
    dataset: datasets.Dataset,
    competitor: str,
    seed: int,
    folder: Path,
    args: argparse.Namespace,
    first: dict[str, Any] | None = None,
) -> dict[str, Any]:
    """One competitor on one data set in a fresh process; one row of the results. It starts in an empty folder, or from
    that of the ``first`` seed."""
    place = (args.keep or folder) / f"{dataset.name}-{competitor.replace(':', '-')}"
    work = place.with_name(f"{place.name}-{seed}")
    shutil.rmtree(work, ignore_errors=True)
    (work / "out").mkdir(parents=True)
    command = _command(dataset, competitor, seed, work, args)
    if first is not None:
        command[2:2] = ["--base", str(place.with_name(f"{place.name}-{first['repeat']}") / "out")]
    row: dict[str, Any] = {
        "set": dataset.name,
        "competitor": competitor,
        "repeat": seed,
        "calibration": "given" if _given(dataset, competitor, args) else "estimated",
        "started": datetime.now(timezone.utc).isoformat(timespec="seconds"),
        "load_at_start": round(os.getloadavg()[0], 2),
        "software": _software(),
    }
    row |= measured(command, work / "log.txt", args.timeout)
    said = json.loads((work / "figures.json").read_text()) if (work / "figures.json").exists() else {}
    row |= _outcome(row.pop("returncode"), said)
    row |= {key: _without_paths(said[key], folder, work, dataset.images) for key in ("stages", "pairs") if key in said}
    for clock in ("cpu_s", "wall_s") if first is not None else ():
        again, once = (sum(s[clock] for s in r.get("stages", ())) for r in (row, first))
        row[clock] = first[clock] + again - once
    world = Origin.from_dict(said["world"]) if said.get("world") else None
    row |= accuracy.evaluate([Path(m) for m in said.get("models", [])], dataset, world)
    if not args.keep and (first is not None or len(args.seeds) < 2):  # else others start from it
        shutil.rmtree(work)
    return row


def _without_paths(value: Any, *places: Path) -> Any:
    """The same with the folders of this machine taken out of all texts."""
    text = json.dumps(value)
    for place in places:
        text = text.replace(json.dumps(f"{place.resolve()}/")[1:-1], "").replace(json.dumps(f"{place}/")[1:-1], "")
    return json.loads(text)


def _given(dataset: datasets.Dataset, competitor: str, args: argparse.Namespace) -> bool:
    return bool(dataset.cameras) and (args.calibrated or competitor.startswith("tiegraph"))


def _command(dataset: datasets.Dataset, competitor: str, seed: int, work: Path, args: argparse.Namespace) -> list[str]:
    program, _, preset = competitor.partition(":")
    file, *words = _PROGRAMS[program]
    command = [sys.executable, str(_COMPETITORS / file)]
    command += ["--images", str(dataset.images), "--out", str(work / "out"), "--json", str(work / "figures.json")]
    command += ["--seed", str(seed)]
    if program == "tiegraph":
        command += dataset.options("gcp")
        name, is_setting, value = preset.partition("=")
        options = [f"--{name}", value] if is_setting else ["--preset", preset]
        return [*command, "--until", args.until, *(["--", *options] if preset else [])]
    if _given(dataset, competitor, args):
        (work / "cameras.json").write_text(json.dumps({k: _colmap_camera(c) for k, c in dataset.cameras.items()}))
        command += ["--cameras", str(work / "cameras.json")]
    if "rig" in words and dataset.rig is not None:
        command += _colmap_rig(dataset.rig, work / "rig_config.json")
    return [*command, *(["--", *words] if words else [])]


def _colmap_rig(rig: Path, path: Path) -> list[str]:
    """The options of a rig file for COLMAP: its own rig configuration, without intrinsics; none for a lone camera."""
    (spec,) = read_rig_file(rig, RigTuning())
    if len(spec.sensors) < 2:
        return []
    reference, cameras = spec.sensors[0].body_from_sensor, []
    for k, sensor in enumerate(spec.sensors):
        row: dict[str, Any] = {"image_prefix": f"{sensor.folder or sensor.name}/"}
        if k == 0:
            row["ref_sensor"] = True
        elif reference is not None and sensor.body_from_sensor is not None:
            pose = transforms.invert(sensor.body_from_sensor) @ reference
            row["cam_from_rig_rotation"] = np.roll(transforms.quaternion_xyzw(pose[:3, :3]), 1).tolist()
            row["cam_from_rig_translation"] = pose[:3, 3].tolist()
        cameras.append(row)
    path.write_text(json.dumps([{"cameras": cameras}]))
    return ["--rig", str(path), *([] if spec.nominal else ["--hold-rig"])]


def _colmap_camera(camera: Any) -> dict[str, Any]:
    data = camera_to_dict(camera)
    assert data is not None
    return {key: data[key] for key in ("model", "width", "height", "params")}


def _outcome(returncode: int | None, said: dict[str, Any]) -> dict[str, Any]:
    """Status of a run: what it says itself, unless its process did not end well."""
    stage = said.get("running")
    where = f" in stage {stage}" if stage else ""
    if returncode is None:
        return {"status": "timeout", "reason": f"took longer than the limit{where}"}
    if returncode != 0:
        return {"status": "failed", "reason": f"the process ended with code {returncode}{where}"}
    return {"status": said.get("status", "failed"), **({"reason": said["reason"]} if "reason" in said else {})}


# --------------------------------------------------------------------------------------------------- results file


def load_results(path: Path, note: str) -> dict[str, Any]:
    """The results file, or an empty one; ends the program if it was measured on another machine."""
    machine = _machine()
    if not path.exists():
        return {"format": 1, "machine": machine, "note": note, "runs": []}
    results = json.loads(path.read_text())
    if results["machine"] != machine:
        sys.exit(f"{path} was measured on another machine: figures of two machines do not mix, choose another -o")
    return {**results, "note": note or results["note"]}


_ROW = ("set", "competitor", "repeat", "calibration")


def add_row(results: dict[str, Any], row: dict[str, Any], path: Path, key: Sequence[str] = _ROW) -> None:
    """Add a run (in the place of an earlier one of the same ``key``) and write the file in one step."""
    results["runs"] = [old for old in results["runs"] if any(old[k] != row[k] for k in key)] + [row]
    path.parent.mkdir(parents=True, exist_ok=True)
    temporary = path.with_suffix(".part")
    temporary.write_text(json.dumps(_rounded(results), indent=1) + "\n")
    os.replace(temporary, path)


def _rounded(value: Any) -> Any:
    """Floats to six significant digits: the rest is noise."""
    if isinstance(value, float):
        return float(f"{value:.6g}")
    if isinstance(value, dict):
        return {key: _rounded(item) for key, item in value.items()}
    return [_rounded(item) for item in value] if isinstance(value, list) else value


def _machine() -> dict[str, Any]:
    """What the figures depend on; no host name, no paths."""
    model = next((w.split(":")[1].strip() for w in _lines("/proc/cpuinfo") if w.startswith("model name")), "unknown")
    memory = os.sysconf("SC_PAGE_SIZE") * os.sysconf("SC_PHYS_PAGES") / 2**30
    return {
        "cpu": model,
        "cores": len(os.sched_getaffinity(0)),
        "memory_gib": round(memory, 1),
        "system": f"{platform.system()} {platform.machine()}",
    }


def _software() -> dict[str, str]:
    return {"python": platform.python_version(), **{name: metadata.version(name) for name in _PACKAGES}}


def _lines(path: str) -> list[str]:
    return Path(path).read_text().splitlines() if Path(path).exists() else []


if __name__ == "__main__":
    sys.exit(main())
