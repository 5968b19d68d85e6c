"""Where it is dark, flat or uneven: ``python -m benchmarks.conditions --sets canal_demo --work DIR -o FILE``.

Each survey with truth is made worse image by image, at three severities a condition, and run by tiegraph and by COLMAP
(every pair, its defaults). ``--write`` puts the table of FILE between its markers in docs/benchmarks.md and draws
docs/pictures/conditions.png. ``--ablation``
prints what the constants of the equalisation do (runs of ``--methods "limit 2" ...``). ``--contrast FOLDER ...`` prints
how much contrast the images below a folder show: the least, a tenth of them, the median, the most.

* ``contrast``: the local contrast that a tenth of an image shows is scaled to so many grey levels (the sea floor of
  ``benchmarks/real`` shows 3 to 7), with shot noise and read noise of 0.7 grey levels, and a veil of 40.
* ``lamp``: light from the camera's own side falls off to so small a share towards the corners; what it lights of the
  water in front stands still in the image.
* ``exposure``: each image has a gain of up to so many times more or less, and a gamma between 0.5 and 2.
* ``blur``: every image is smeared over so many pixels along its rows.
* ``rain``: so many drops on each lens blur what is behind them and stand still.
* ``fog``: a contrast of 1 falls to 0.05 over so many metres (the meteorological visibility); only where every image has
  a depth map of the truth (``canal@FOLDER``, rendered by the generator of the data sets).
"""

from __future__ import annotations

import argparse
import json
import shutil
import sys
from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from zlib import crc32

import cv2
import numpy as np
from matplotlib.figure import Figure

from benchmarks import datasets, variants
from benchmarks.papers.measure import COLMAP, one_run
from benchmarks.table import line, put
from tiegraph.errors import InputError
from tiegraph.features.sift import contrast
from tiegraph.features.tuning import ContrastTuning

_ROOT = Path(__file__).resolve().parents[1]
_RESULTS, _DOCUMENT = _ROOT / "benchmarks" / "results" / "conditions.json", _ROOT / "docs" / "benchmarks.md"
BEGIN, END = "<!-- python -m benchmarks.conditions --write -->", "<!-- end of the conditions -->"
_READ, _SHOT, _VEIL = 0.7, 0.05, 40.0  # grey levels; variance of the shot noise over the signal; grey levels

METHODS = ("tiegraph", "not evened", "COLMAP")  # the second: tiegraph without evening
# Constants of the equalisation halved and doubled, of which --ablation prints the rows.
ABLATION = {f"{name} {value:g}": {name: value} for name, values in (
    ("limit", (2, 8)), ("tiles", (4, 16)), ("enough", (5, 20)), ("block", (0.01, 0.04)),
) for value in values}  # fmt: skip

Image = np.ndarray
Worse = Callable[[Image, float, np.random.Generator, np.random.Generator], Image]
"""(H, W, 3) grey levels f4 (fog: and the depth), severity, random numbers of the image and of its camera -> the same
made worse."""
_SKY = 0  # in the masks of the truth
_FOG, _LAST = 190.0, 0.05  # grey levels of the fog itself; the contrast that is left at the visibility


def _dim(image: Image, levels: float, rng: np.random.Generator, _: np.random.Generator) -> Image:
    shown = contrast(cv2.cvtColor(image.astype(np.uint8), cv2.COLOR_BGR2GRAY), ContrastTuning())
    signal = image * min(levels / max(shown, 1e-6), 1.0)
    noise = rng.normal(size=image.shape) * np.sqrt(_READ**2 + _SHOT * signal)
    return _VEIL + signal + noise


def _lamp(image: Image, least: float, rng: np.random.Generator, fixed: np.random.Generator) -> Image:
    height, width = image.shape[:2]
    y, x = np.mgrid[:height, :width].astype(np.float32)
    at = np.array([width, height]) * fixed.uniform(0.4, 0.6, 2)
    far = ((x - at[0]) ** 2 + (y - at[1]) ** 2) / (0.25 * (width**2 + height**2))
    light = np.exp(np.log(least) * far)[..., None]
    scattered = 60 * np.exp(-8 * far)[..., None] * (1 + 0.2 * fixed.normal(size=(height, width, 1)))
    return image * light + scattered + rng.normal(size=image.shape) * _READ


def _exposed(image: Image, most: float, rng: np.random.Generator, _: np.random.Generator) -> Image:
    gain, gamma = most ** rng.uniform(-1, 1), 2.0 ** rng.uniform(-1, 1)
    return 255 * np.clip(gain * image / 255, 0, 1) ** gamma + rng.normal(size=image.shape) * _READ


def _smeared(image: Image, pixels: float, _: np.random.Generator, __: np.random.Generator) -> Image:
    return cv2.blur(image, (max(int(pixels), 1), 1))


def _rained(image: Image, drops: float, _: np.random.Generator, fixed: np.random.Generator) -> Image:
    height, width = image.shape[:2]
    cover = np.zeros((height, width), np.float32)
    for _drop in range(int(drops)):
        place = (int(fixed.integers(width)), int(fixed.integers(height)))
        cv2.circle(cover, place, int(fixed.uniform(0.01, 0.04) * width), 1.0, -1)
    cover = cv2.GaussianBlur(cover, (0, 0), 2)[..., None]
    behind = 0.85 * cv2.GaussianBlur(image, (0, 0), 0.02 * width) + 20
    return (1 - cover) * image + cover * behind


def _fogged(image: Image, visible_m: float, rng: np.random.Generator, _: np.random.Generator) -> Image:
    """The fourth channel is the depth, metres."""
    shown, depth_m = image[..., :3], image[..., 3:]
    left = _LAST ** (depth_m / visible_m)
    return left * shown + (1 - left) * _FOG + rng.normal(size=shown.shape) * _READ


CONDITIONS: dict[str, tuple[Worse, tuple[float, ...]]] = {
    "contrast": (_dim, (12, 6, 3)),
    "lamp": (_lamp, (0.3, 0.1, 0.03)),
    "exposure": (_exposed, (2, 4, 8)),
    "blur": (_smeared, (3, 6, 12)),
    "rain": (_rained, (5, 15, 40)),
    "fog": (_fogged, (60, 30, 15)),
}


def worsened(dataset: datasets.Dataset, name: str, severity: float, folder: Path) -> datasets.Dataset:
    """The survey with every image made worse, as PNG files of the same stems below ``folder``; the same each time."""
    worse = CONDITIONS[name][0]
    truth = {}
    for image, pose in dataset.cam_from_world.items():
        pixels = cv2.imread(str(dataset.images / image)).astype(np.float32)
        if name == "fog":
            pixels = np.dstack([pixels, _depth_m(dataset, image)])
        own, camera = (np.random.default_rng(crc32(f"{name} {k}".encode())) for k in (image, Path(image).parent))
        made = np.clip(np.rint(worse(pixels, severity, own, camera)), 0, 255).astype(np.uint8)
        target = (folder / image).with_suffix(".png")
        target.parent.mkdir(parents=True, exist_ok=True)
        cv2.imwrite(str(target), made)
        truth[target.relative_to(folder).as_posix()] = pose
    times = None if dataset.times is None else folder.with_suffix(".csv")
    if times is not None and dataset.times is not None:
        head, *rows = dataset.times.read_text().splitlines()
        at = head.split(",").index("image") if "image" in head.split(",") else None
        cells = [r.split(",") for r in rows]
        if at is not None:
            cells = [[str(Path(c).with_suffix(".png")) if k == at else c for k, c in enumerate(r)] for r in cells]
        times.write_text("\n".join([head, *(",".join(r) for r in cells)]) + "\n")
    return replace(dataset, images=folder, cam_from_world=truth, times=times)


def _depth_m(dataset: datasets.Dataset, image: str) -> np.ndarray:
    """(H, W) f4, inf = sky, 0 = the boat itself. Raises InputError where there is no map."""
    truth = dataset.images.parent / "gt"
    paths = [(truth / folder / image).with_suffix(".png") for folder in ("depth", "masks")]
    depth, mask = (cv2.imread(str(path), cv2.IMREAD_UNCHANGED) for path in paths)
    if depth is None or mask is None:
        raise InputError(f"{dataset.name}: fog needs {paths[0]} and {paths[1]} of the truth: omit it (--conditions)")
    return np.where(mask == _SKY, np.inf, depth / 256).astype(np.float32)


def main(argv: list[str] | None = None) -> int:
    """Measure what FILE lacks; a row is kept when it is made."""
    parser = argparse.ArgumentParser(description=__doc__, formatter_class=argparse.RawDescriptionHelpFormatter)
    parser.add_argument("--sets", nargs="*", default=[])
    parser.add_argument("--conditions", nargs="+", default=list(CONDITIONS), choices=list(CONDITIONS))
    parser.add_argument("--severities", nargs="+", type=float, help="only these of each condition")
    parser.add_argument("--methods", nargs="+", default=METHODS, choices=(*METHODS, *ABLATION))
    parser.add_argument("--work", type=Path)
    parser.add_argument("-o", "--output", type=Path, default=_RESULTS)
    parser.add_argument("--write", action="store_true")
    parser.add_argument("--ablation", action="store_true")
    parser.add_argument("--contrast", nargs="*", type=Path, default=[], metavar="FOLDER")
    args = parser.parse_args(argv)
    for folder in args.contrast:
        images = (cv2.imread(str(f), cv2.IMREAD_GRAYSCALE) for f in sorted(folder.rglob("*")) if f.is_file())
        shown = [contrast(i, ContrastTuning()) for i in images if i is not None]
        sys.stdout.write(f"{folder}: {len(shown)}, {np.round(np.percentile(shown, (0, 10, 50, 100)), 1)}\n")
    kept = json.loads(args.output.read_text()) if args.output.exists() else []
    for name in args.sets:
        dataset = datasets.load(name, args.work / "inputs")
        for condition in args.conditions:
            for severity in (s for s in CONDITIONS[condition][1] if s in (args.severities or [s])):
                _case(dataset, (dataset.name, condition, severity), args, kept)
    if args.ablation:
        sys.stdout.write(ablation(kept) + "\n")
    if args.write:
        put(_DOCUMENT, BEGIN, END, table(kept))
        curves(kept).savefig(_DOCUMENT.parent / "pictures" / "conditions.png", dpi=90)
    return 0


def _case(dataset: datasets.Dataset, case: tuple[str, str, float], args: argparse.Namespace, kept: list[dict]) -> None:
    done = {r["method"] for r in kept if (r["set"], r["condition"], r["severity"]) == case}
    left = [m for m in args.methods if m not in done]
    folder = args.work / f"{case[0]}-{case[1]}-{case[2]:g}"
    bad = worsened(dataset, case[1], case[2], folder / "images") if left else dataset
    for method in left:
        if method == "COLMAP":
            row = {k: v for k, v in one_run(bad, COLMAP, folder / "colmap").items() if k not in ("precision", "counts")}
            row["cpu_s"] = round(sum(s[0] for s in row.pop("stages").values()), 1)
        else:
            changed = {"enough": 0} if method == "not evened" else ABLATION.get(method, {})
            row = variants.run(bad, folder / "run", {"tuning": {"features": {"contrast": changed}}} if changed else {})
        kept.append({"set": case[0], "condition": case[1], "severity": case[2], "method": method, **row})
        args.output.write_text(json.dumps(kept, indent=1, default=str) + "\n")
        sys.stderr.write(f"{case} {method}: {row.get('registered')} {row.get('ate_m')}\n")
    shutil.rmtree(folder, ignore_errors=True)


def ablation(rows: list[dict]) -> str:
    """A row a condition and severity: images, ATE as they are and with each constant of the equalisation changed."""
    out = [line(["set", "condition", "severity", "as it is", *ABLATION]), line(["---"] * (4 + len(ABLATION)))]
    for case in dict.fromkeys((r["set"], r["condition"], r["severity"]) for r in rows if r["method"] in ABLATION):
        of = {r["method"]: r for r in rows if (r["set"], r["condition"], r["severity"]) == case}
        cells = (_cell(of.get(method, {})) for method in ("tiegraph", *ABLATION))
        out.append(line([f"`{case[0]}`", case[1], f"{case[2]:g}", *cells]))
    return "\n".join(out)


def table(rows: list[dict]) -> str:
    """A row a condition and severity; images in the largest model, ATE, and what tiegraph predicts over what is."""
    head = ["set", "condition", "severity", "tiegraph: images, ATE", "predicted over actual", "not evened", "COLMAP"]
    out = [line(head), line(["---"] * len(head))]
    cases = dict.fromkeys((r["set"], r["condition"], r["severity"]) for r in rows)
    for case in cases:
        of = {r["method"]: r for r in rows if (r["set"], r["condition"], r["severity"]) == case}
        ours = of.get("tiegraph", {})
        ratio = ours.get("predicted_over_actual")
        cells = [_cell(ours), "-" if ratio is None else f"{ratio:.2g}", _cell(of.get("not evened", {}))]
        out.append(line([f"`{case[0]}`", case[1], f"{case[2]:g}", *cells, _cell(of.get("COLMAP", {}))]))
    return "\n".join(out)


def curves(rows: list[dict]) -> Figure:
    """A column a condition; images in the largest model, ATE, and predicted over actual error over the severity."""
    figure = Figure(figsize=(15, 7.5), layout="constrained")
    axes = figure.subplots(3, len(CONDITIONS), sharey="row")
    sets = list(dict.fromkeys(r["set"] for r in rows))
    for column, (name, (_, severities)) in enumerate(CONDITIONS.items()):
        for survey, colour in zip(sets, ("#1b6ca8", "#c0392b", "#2e8b57", "#8e5ea2")):
            for method, style in (("tiegraph", "o-"), ("COLMAP", "x--")):
                found = {r["severity"]: r for r in rows
                         if (r["set"], r["condition"], r["method"]) == (survey, name, method)}  # fmt: skip
                at = [k for k, severity in enumerate(severities) if severity in found]
                values = np.array([_curve(found[severities[k]]) for k in at]).reshape(-1, 3)
                for panel, drawn in zip(axes[:, column], values.T):
                    panel.plot(at, drawn, style, color=colour, label=f"{survey}, {method}", ms=5)
        axes[0, column].set_title(name, loc="left", fontsize=11)
        for panel in axes[:, column]:
            panel.set_xticks(range(len(severities)), [f"{v:g}" for v in severities])
            panel.set_xlim(-0.3, len(severities) - 0.7)
            panel.grid(alpha=0.3)
    for panel, label in zip(axes[:, 0], ("images in the largest model, %", "ATE, mm", "predicted over actual")):
        panel.set_ylabel(label)
    axes[0, 0].set_ylim(-4, 104)
    for panel in axes[1:].ravel():
        panel.set_yscale("log")
    for panel in axes[2]:
        panel.axhspan(0.5, 2, color="#dddddd", lw=0, zorder=0)
    figure.legend(*axes[0, 0].get_legend_handles_labels(), loc="outside lower center", ncols=4, fontsize=9)
    return figure


def _curve(row: dict) -> tuple[float, float, float]:
    share = 100 * (row.get("largest", row.get("registered")) or 0) / row["images"]
    ate_mm = 1000 * (row.get("ate_m") or np.nan) if share else np.nan
    return share, ate_mm, row.get("predicted_over_actual") or np.nan


def _cell(row: dict) -> str:
    if not row:
        return "not run"
    images = row.get("largest", row.get("registered"))
    error = row.get("ate_m")
    if not images:
        return "none"
    shown = "" if error is None else f", {1000 * error:.0f} mm" if error < 0.1 else f", {error:.2g} m"
    return f"{images} of {row['images']}{shown}"


if __name__ == "__main__":
    sys.exit(main())
