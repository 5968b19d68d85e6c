"""A LiDAR beside the images: odometry, place and clock of the LiDAR, and a run against it, with the truth beside.

``python -m benchmarks.lidar canal=RUN pandaset --work DIR [-o FILE] [--write]``: ``tiegraph lidar`` on the scans of the
sets; with a run folder also hand-eye and the rows of paper 001's tables 1 and 3 to 5. ``--write`` puts the tables of
FILE between their markers in docs/lidar.md.
"""

from __future__ import annotations

import argparse
import json
import math
import sys
import time
from collections.abc import Mapping, Sequence
from pathlib import Path
from typing import Any

import numpy as np

from benchmarks.datasets import data_root
from benchmarks.table import line, put
from tiegraph.evaluate.reference import read_tum
from tiegraph.evaluate.trajectory import PoseMatch, evaluate_trajectory
from tiegraph.evaluate.tuning import Tuning
from tiegraph.geometry import transforms
from tiegraph.lidar.settings import LidarSettings
from tiegraph.pipeline.lidar import TRAJECTORY, lidar

_ROOT = Path(__file__).resolve().parents[1]
_RESULTS, _DOCUMENT = _ROOT / "benchmarks" / "results", _ROOT / "docs" / "lidar.md"
BEGIN, END = "<!-- python -m benchmarks.lidar --write -->", "<!-- end of the figures -->"


def canal(work: Path, run: Path | None) -> dict[str, Any]:
    """40 scans of a rendered VLP-16; the truth is the path of the body and the scanner's place on it."""
    truth = data_root() / "canal" / "gt"
    settings = LidarSettings(columns=("x", "y", "z", "intensity", "ring", "t"), run=run)
    told = lidar(truth / "vlp16", work, settings)
    on_body = np.eye(4)
    on_body[:3, 3] = json.loads((truth / "meta.json").read_text())["vlp16"]["sensor_in_body"]
    time_s, poses = read_tum(work / TRAJECTORY)
    true = transforms.interpolate(*read_tum(truth / "rig_up.tum"), time_s) @ on_body
    out = {**_odometry(told, poses, true), "survey": told["tables"].get("survey")}
    if run is not None:
        mount = json.loads((truth / "rig.json").read_text())["cam0"]
        camera = transforms.from_quaternion_wxyz(mount["cam_from_body_qwxyz"], mount["cam_from_body_t"])
        out["hand_eye"] = _hand_eye(told["hand_eye"], camera @ on_body)
    return out


def pandaset(work: Path, run: Path | None) -> dict[str, Any]:
    """50 scans of a car's LiDAR that stand in the world frame: their poses are undone and are the truth."""
    folder = data_root() / "pandaset" / "lidar"
    told = lidar(folder, work, LidarSettings(poses=folder / "poses.json", run=run))
    given = dict(told["tables"]["against the given poses"]["rows"])
    return {
        "scans": told["scans"],
        "path_m": given["path [m]"],
        "drift_m": given["drift at the end [m]"],
        "turn_deg": given["turn at the end [deg]"],
        "ate_m": given["ATE after SE3 [m]"],
        "survey": told["tables"].get("survey"),
    }


_SETS = {"canal": canal, "pandaset": pandaset}


def _odometry(told: Mapping[str, Any], poses: np.ndarray, true: np.ndarray) -> dict[str, Any]:
    """Poses (T, 4, 4) against true ones: drift at the end in the frame of the first scan, ATE."""
    moved, should = (transforms.invert(p[0]) @ p[-1] for p in (poses, true))
    match = PoseMatch(estimate=poses, reference=true, group=np.zeros(len(poses), int), order=np.arange(len(poses)))
    error = evaluate_trajectory(match, (1.0,), Tuning().trajectory)
    return {
        "scans": told["scans"],
        "path_m": float(np.linalg.norm(np.diff(true[:, :3, 3], axis=0), axis=1).sum()),
        "drift_m": float(np.linalg.norm(moved[:3, 3] - should[:3, 3])),
        "turn_deg": float(transforms.angle_deg(moved[:3, :3], should[:3, :3])),
        "ate_m": error.se3.rmse_m,
    }


def _hand_eye(found: Mapping[str, Any], rig_from_lidar: np.ndarray) -> dict[str, Any]:
    """What was found of the LiDAR's place and clock against the truth (its clock is the cameras'): errors, sigmas."""
    place = np.array(found["rig_from_lidar"])
    return {
        "clock_off_s": float(found["clock_s"]),
        "clock_sigma_s": float(found["clock_sigma_s"]),
        "place_off_m": (place[:3, 3] - rig_from_lidar[:3, 3]).tolist(),
        "place_sigma_m": np.asarray(found["place_sigma_m"], float).tolist(),
        "turn_off_deg": float(transforms.angle_deg(place[:3, :3], rig_from_lidar[:3, :3])),
        "scale": float(found["scale"]),
        "frames": found["frames"],
        "tied_points": found["tied_points"],
    }


def tables(rows: Sequence[Mapping[str, Any]]) -> str:
    """The tables for the page."""
    head = ["set", "scans", "path", "drift at the end", "of the path", "turn at the end", "ATE", "CPU s"]
    lines = [line(head), line(["---"] * len(head))]
    for r in rows:
        lines.append(line([
            f"`{r['set']}`", r["scans"], f"{r['path_m']:.2f} m", f"{1000 * r['drift_m']:.0f} mm",
            f"{100 * r['drift_m'] / r['path_m']:.2f} %", f"{r['turn_deg']:.2f} deg", f"{1000 * r['ate_m']:.0f} mm",
            f"{r['cpu_s']:.0f}",
        ]))  # fmt: skip
    for r in rows:
        lines += ["", *_place(r)] if r.get("hand_eye") else []
        lines += ["", *_survey(r)] if r.get("survey") else []
    return "\n".join(lines)


def _place(row: Mapping[str, Any]) -> list[str]:
    found = row["hand_eye"]
    lines = [line([f"place and clock, `{row['set']}`", "off by", "sigma"]), line(["---"] * 3)]
    clock = [f"{1000 * found[k]:.1f} ms" for k in ("clock_off_s", "clock_sigma_s")]
    lines.append(line(["clock offset", *clock]))
    for axis, off, sigma in zip("xyz", found["place_off_m"], found["place_sigma_m"]):
        lines.append(line([f"lever arm {axis}", f"{1000 * off:.1f} mm", f"{1000 * sigma:.1f} mm"]))
    lines.append(line(["turn", f"{found['turn_off_deg']:.2f} deg", ""]))
    return lines


def _survey(row: Mapping[str, Any]) -> list[str]:
    columns, rows = row["survey"]["columns"], row["survey"]["rows"]
    lines = [line([f"`{row['set']}`, as paper 001", *columns[1:]]), line(["---"] * len(columns))]
    return [*lines, *(line([name, *map(_cell, values)]) for name, *values in rows)]


def _cell(value: float | None) -> str:
    if value is None or math.isnan(value):
        return ""
    return f"{value:,.0f}".replace(",", " ") if value == int(value) else f"{value:.3g}" if value < 2 else f"{value:.1f}"


def write(file: Path) -> None:
    """Put the tables between their markers in docs/lidar.md."""
    put(_DOCUMENT, BEGIN, END, tables(json.loads(file.read_text())["rows"]))


def main(argv: list[str] | None = None) -> int:
    """Command line."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("sets", nargs="*", help=f"SET or SET=RUN, of {', '.join(_SETS)}")
    parser.add_argument("--work", type=Path, default=Path("lidar_work"), help="trajectories and maps; a new folder")
    parser.add_argument("-o", "--out", type=Path, default=_RESULTS / "lidar.json")
    parser.add_argument("--write", action="store_true", help="the tables into docs/lidar.md")
    args = parser.parse_args(argv)
    rows = json.loads(args.out.read_text())["rows"] if args.out.exists() else []
    for item in args.sets:
        name, _, run = item.partition("=")
        start = time.process_time()
        found = _SETS[name](args.work / name, Path(run) if run else None)
        row = {"set": name, "cpu_s": round(time.process_time() - start, 1), **found}
        rows = sorted([*(r for r in rows if r["set"] != name), row], key=lambda r: str(r["set"]))
        args.out.write_text(json.dumps({"rows": rows}, indent=1) + "\n")
        sys.stdout.write(json.dumps(row) + "\n")
    if args.write:
        write(args.out)
    return 0


if __name__ == "__main__":
    sys.exit(main())
