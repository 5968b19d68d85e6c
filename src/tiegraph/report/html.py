"""report.html: one self-contained file from receipts and artefacts only, for the client first, then the engineer. And
report.pdf: the page printed by a headless browser, because nothing else lays it out as it is read."""

import os
import re
import shutil
import subprocess
from collections import Counter
from datetime import datetime, timezone
from functools import cache
from pathlib import Path
from typing import Any

import jinja2
import numpy as np
from markupsafe import Markup

from tiegraph.errors import EngineMissing, InputError
from tiegraph.report import accuracy, formatting, maps, parts, summary
from tiegraph.report.client import client_page, json_text
from tiegraph.report.cloudview import viewer_part, views
from tiegraph.report.drawing import ALERT, CLASSES, Series, arrows, mask_share, pass_colour, plot, thumbnail
from tiegraph.report.network import network_part
from tiegraph.report.runfolder import Model, RunFolder, read_run
from tiegraph.report.settings import ReportSettings
from tiegraph.report.texts import capital, language, said, t
from tiegraph.scene.atomic import replacing, scratch_folder
from tiegraph.scene.scene import Scene

VIEW_POINTS = 4_000_000  # of the cloud, drawn in the static views
_DROPPED_SHOWN = 200
_IMAGES_SHOWN = 5000
_RIGS_SHOWN, _CAMERAS_SHOWN = 8, 24
_ARROW_SHARE = 0.1  # of the width of an image: the longest residual of a lens as drawn
_HEADING = re.compile(r'<h2 id="(\w+)">(.*?)</h2>')
_WORDS = {
    "accuracy in the world": "how far a point may be from its true coordinates; what holds the survey there is named",
    "accuracy in shape": "how far parts may be off each other, wherever the survey as a whole stands",
    "accuracy of a point": "how far a point may be off its neighbours: the noise of a surface",
    "predicted": "one standard deviation, by the run itself: about two thirds of the errors are smaller",
    "measured": "root mean square of the differences from references that the run did not use",
    "sigma": "standard deviation",
    "camera": "one lens with its sensor",
    "rig": "cameras that are mounted together and fire together",
    "frame": "the images that a rig takes at one instant",
    "pass": "a sequence of frames along one path",
    "section": "a part of the survey under a bridge or under open sky",
    "registered": "an image whose pose is confirmed by points that it sees",
    "placed by the rig": "an image whose pose follows from the other cameras of its rig, without points of its own",
    "tie": "two images in which the same points were found and verified",
    "weak link": "a tie whose loss would disconnect the survey",
    "candidate": "two images that may see the same surface",
    "mask": "the part of an image that is not used: sky, water, the vehicle, what moves",
    "prior pose": "position or direction known before the images were used: GNSS, EXIF, odometry",
    "sparse model": "camera positions and the points that tie the images",
    "reprojection error": "how far a point falls from where it was seen in an image, in pixels",
    "georeferencing": "placing the model in coordinates of the Earth",
    "lever arm": "vector from the camera to the antenna, or between two cameras",
    "check point": "a surveyed point that the adjustment did not use: it tests the result",
    "control point": "a surveyed point that the adjustment used",
    "held-out position": "a given position that a fit did not use and is then compared with",
    "dense cloud": "points of the surface from every pixel that several images agree on",
    "pixel on the surface": "ground sampling distance: size of one pixel at the distance of the surface",
    "error ellipse": "where a point lies with 39 % probability by its standard deviations east and north",
    "M3C2": "distance of two clouds along the normal of the surface",
    "completeness": "share of the reference's points that have a point of the cloud nearby",
    "F-score": "mean (harmonic) of accuracy and completeness at a distance",
    "CRS": "coordinate reference system: the reference of the coordinates",
}


def write_report(folder: Path, settings: ReportSettings, planned: formatting.Table | None = None) -> Path:
    """Write ``folder/report.html`` and ``report.json`` from its contents; stages that have not run are left out.

    ``planned``: planned and reached values. Raises InputError if the folder contains no run or the disk is full.
    """
    run = read_run(folder, VIEW_POINTS)
    target = folder / "report.html"
    for path, text in ((target, render(run, settings, planned)), (folder / "report.json", json_text(run, settings))):
        with replacing(path) as temporary:
            temporary.write_text(text, encoding="utf-8")
    return target


def render(run: RunFolder, settings: ReportSettings, planned: formatting.Table | None = None) -> str:
    """The page as text."""
    with language(settings.language):
        seen = maps.scenery(run)
        verdict = summary.verdict(run)
        made = datetime.now(timezone.utc).strftime("%Y-%m-%d %H:%M UTC")
        context = {
            "language": settings.language,
            "client": client_page(run, settings, seen, verdict),
            "title": settings.title or run.path.resolve().name,
            "made": made,
            "verdict": verdict,
            "tiles": summary.tiles(run),
            "sure": _how_sure(run),
            "scan": _scan(run),
            "images": _images(run),
            "masks": _masks(run, settings),
            "network": network_part(run),
            "model": _model(run),
            "planned": planned,
            "evaluation": parts.evaluation(run),
            "effort": parts.effort(run),
            "glossary": [(t(word), t(meaning)) for word, meaning in _WORDS.items()],
            **_space(run, seen, settings),
        }
        page = environment().get_template("template.html.jinja").render(context)
        links = (f'<li><a href="#{key}">{title}</a></li>' for key, title in _HEADING.findall(page))
        return page.replace("<!--contents-->", "".join(links))


@cache
def environment() -> jinja2.Environment:
    """Templates of this package, everything escaped, also invisible characters (``text.printable``), and paths
    of the maker's machine reduced to their last name."""
    made = jinja2.Environment(
        loader=jinja2.PackageLoader("tiegraph.report", "."),
        autoescape=True,
        finalize=lambda value: formatting.shown(value) if type(value) is str else value,  # not of Markup, which is ours
        undefined=jinja2.StrictUndefined,
        trim_blocks=True,
        lstrip_blocks=True,
    )
    shared: dict[str, Any] = {"t": t, "said": said, "capital": capital}
    made.globals.update(shared)
    return made


def _how_sure(run: RunFolder) -> dict[str, Any]:
    """Every accuracy with what it does not prove, the statement of each source, and unknown values."""
    out: dict[str, Any] = {"table": None, "placement": "", "evidence": parts.evidence_table(run), "without": []}
    out["passes"] = parts.passes_part(run)
    if run.accuracy is None:
        return out
    out |= {"table": accuracy.table(run.accuracy), "placement": accuracy.placement(run.accuracy)}
    out["without"] = accuracy.without(run.accuracy)
    if run.scene is not None and len(run.scene.sequences) > 1 and out["passes"]["table"] is None:
        text = "The clouds of the passes were not compared with each other, which takes depth maps of two that "
        out["without"].append(t(text + "meet (`tiegraph cloud` does it): an error of one pass may be hidden."))
    return out


def _scan(run: RunFolder) -> dict[str, Any]:
    scene, dropped, facts = run.scene, summary.dropped_images(run), []
    notes = list(dict.fromkeys([*(scene.notes if scene else ()), *run.notes("scan")]))
    if scene is not None:
        rigs = [t("{} ({} cameras)", r.name, len(r.sensors)) if len(r.sensors) > 1 else r.name for r in scene.rigs]
        facts = [
            (t("images"), formatting.count(len(scene))),
            (t("frames"), formatting.count(scene.frames)),
            (t("rig"), Markup(t(", ")).join(rigs[:_RIGS_SHOWN]) + (" …" if len(rigs) > _RIGS_SHOWN else "")),
            (t("passes"), t(", ").join(scene.sequences[:12]) or t("none: loose photographs")),
            (t("prior poses"), _prior(scene)),
        ]
    more, tables = max(0, len(dropped) - _DROPPED_SHOWN), parts.receipt_tables(run, "scan")
    return {"facts": facts, "notes": notes, "dropped": dropped[:_DROPPED_SHOWN], "more": more, "tables": tables}


def _prior(scene: Scene) -> str:
    given = said({"gnss": "GNSS", "exif": "EXIF"}.get(scene.prior, scene.prior))
    if not scene.started:
        return given
    return t("start model") if scene.prior == "trajectory" else t("{}, start model", given)


def _images(run: RunFolder) -> dict[str, Any]:
    rows = summary.image_rows(run)
    shown = rows[:_IMAGES_SHOWN]
    odd, used = (_image_table(run, [r for r in shown if bool(r.reason) == wanted]) for wanted in (True, False))
    found = Counter(row.state for row in rows)
    counts = [(said(state), formatting.count(found[state])) for state in summary.STATES if found[state]]
    return {"there": bool(rows), "counts": counts, "more": max(0, len(rows) - _IMAGES_SHOWN), "odd": odd, "used": used}


def _image_table(run: RunFolder, rows: list[summary.ImageRow]) -> formatting.Table | None:
    body = []
    for row in rows:
        size = formatting.length(row.gsd, "m" if run.metric else t("units"))
        numbers = (formatting.count(row.points), formatting.count(row.ties), size)
        body.append((row.name, said(row.state), t("; ").join(map(said, row.reason.split("; "))), *numbers))
    names = tuple(map(t, ("image", "state", "reason", "points seen", "verified pairs", "pixel on the surface")))
    return formatting.Table(names, tuple(body), (False, False, False, True, True, True)) if body else None


def _masks(run: RunFolder, settings: ReportSettings) -> dict[str, Any]:
    strips: list[dict[str, Any]] = []
    if run.scene is not None and (run.path / "images").is_dir() and settings.mask_images:
        for key, sensor in enumerate(run.scene.all_sensors[:_CAMERAS_SHOWN]):
            chosen = [run.scene.names[k] for k in np.flatnonzero(run.scene.sensor_key == key)]
            strips += _mask_strip(run, chosen, sensor.name, settings.mask_images) if chosen else []
    classes = CLASSES[1:] if any((run.path / "classes").rglob("*.png")) else ()
    return {
        "strips": strips,
        "any": any(s["share"] is not None for s in strips),
        "classes": [(t(name), colour) for name, colour in classes],
        "notes": run.notes("masks", "refine"),
        "tables": parts.receipt_tables(run, "masks", "refine"),
    }


def _mask_strip(run: RunFolder, names: list[str], camera: str, shown: int) -> list[dict[str, Any]]:
    """Images of a camera, spread over its images (N,), with their final masks, else the first ones."""

    def folder(image: str) -> Path:
        refined = run.path / "refine"
        return refined if (refined / "masks" / f"{image}.png").exists() else run.path

    spread = np.unique(np.linspace(0, len(names) - 1, 25).astype(int))  # masks opened for a camera's mean share
    shares = [mask_share(folder(names[k]) / "masks" / f"{names[k]}.png") for k in spread]
    known = [share for share in shares if share is not None]
    mean = formatting.percent(float(np.mean(known))) if known else ""
    out = []
    for place in (np.arange(shown) + 0.3) / shown:
        image = names[int(place * len(names))]
        mask, classes = (folder(image) / kind / f"{image}.png" for kind in ("masks", "classes"))
        made = thumbnail(run.path / "images" / image, mask, classes)
        if made is not None:
            out.append({"picture": made[0], "camera": camera, "image": image, "share": made[1], "mean": mean})
    return out


def _model(run: RunFolder) -> dict[str, Any]:
    notes = [*run.notes("sparse", "georef"), *map(str, (run.world or {}).get("notes") or [])]
    out: dict[str, Any] = {"there": run.model is not None, "facts": [], "residuals": None, "lenses": []}
    out |= {"notes": list(dict.fromkeys(notes))}
    out |= {"tables": parts.receipt_tables(run, "georef"), "more": parts.receipt_tables(run, "sparse")}
    if run.model is None:
        return out
    rig = parts.rig_table(run)
    out["tables"] += [*summary.registered_tables(run), *([rig] if rig else [])]
    return out | {"facts": _model_facts(run, run.model), "residuals": _residuals(run), "lenses": _lenses(run.model)}


def _model_facts(run: RunFolder, m: Model) -> list[tuple[str, str]]:
    whole = m.reconstruction
    registered = formatting.count(int(m.images.registered.sum())), formatting.count(len(m.images.registered))
    out = [
        (t("registered images"), t("{} of {}", *registered)),
        (t("images placed by the rig"), formatting.count(int(m.images.by_rig.sum()) + run.hanging[1])),
        (t("sparse points"), formatting.count(m.points)),
        (t("observations of an image"), formatting.number(whole.compute_mean_observations_per_reg_image())),
        (t("images of a point (track length)"), formatting.number(whole.compute_mean_track_length())),
        (t("mean reprojection error"), f"{formatting.number(m.reprojection_px)} px"),
        (t("models"), formatting.count(1 + len(m.others))),
    ]
    explained = run.counts("sparse").get("matches_explained_percent")
    if explained is not None and formatting.is_number(explained):
        out.append((t("verified matches that the model explains"), formatting.percent(explained / 100)))
    texts = [formatting.length(v, "m" if run.metric else t("units")) for v in parts.gsd(run) or ()]
    name = t("a pixel on the surface (nearest tenth, half, nine in ten images)")
    return [*out, (name, t(", ").join(texts))] if texts else out


def _lenses(model: Model) -> list[tuple[Markup, str]]:
    known = {k: lens for k, lens in model.lenses.items() if len(lens.at)}
    longest = {k: float(np.linalg.norm(lens.moved, axis=1).max()) for k, lens in known.items()}
    widest = max((lens.size[0] for lens in known.values()), default=0)
    factor = _ARROW_SHARE * widest / max([*longest.values(), 1e-9])
    names = [s.name for s in model.scene.all_sensors]
    out = []
    for key, lens in list(known.items())[:_CAMERAS_SHOWN]:
        at, seen = formatting.number(longest[key], 2), formatting.count(lens.observations)
        caption = t("{}: the longest arrow is {} px; {} observations", names[key], at, seen)
        out.append((arrows(lens.size, lens.at, lens.moved, factor, names[key]), caption))
    return out


def _residuals(run: RunFolder) -> Markup | None:
    """The fit of the frames to their positions, a panel for each component; outliers in red."""
    rows = [r for r in (run.world or {}).get("frames") or [] if np.shape(r.get("residual_m")) == (3,)]
    scene = run.scene
    if scene is None or len(rows) < 2:
        return None
    frames = np.array([int(r.get("frame", k)) for k, r in enumerate(rows)])
    track = np.array([scene.sequence[f] if 0 <= f < scene.frames else -1 for f in frames])
    used = np.array([bool(r.get("inlier", True)) for r in rows])
    off = np.array([r["residual_m"] for r in rows], float)
    groups = [
        (scene.sequences[k] if k >= 0 else t("frames"), pass_colour(k), used & (track == k))
        for k in np.unique(track).tolist()
    ]
    groups = [group for group in [*groups, (t("outlier"), ALERT, ~used)] if group[2].any()]
    panels = [
        (name, [Series(name=n, colour=k, x=frames[of], y=off[of, c], joined=False) for n, k, of in groups])
        for c, name in enumerate((t("east, m"), t("north, m"), t("up, m")))
    ]
    return plot(panels, t("frame"), t("Fit to the given positions"))


def _space(run: RunFolder, seen: maps.Scenery | None, settings: ReportSettings) -> dict[str, Any]:
    out: dict[str, Any] = {"overlap": None, "ellipses": None, "views": [], "viewer": None, "viewer_script": ""}
    out["cloud"] = parts.cloud_facts(run)
    if seen is None:
        return out
    out |= {"overlap": maps.overlap_map(seen), "ellipses": maps.ellipse_map(run, seen)}
    out["views"] = [*views(run, seen), *parts.product_views(run)]
    return out | viewer_part(run, seen, settings.viewer_points)


BROWSERS = ("chromium", "chromium-browser", "google-chrome", "google-chrome-stable", "chrome", "microsoft-edge")
_BEGIN = b"%PDF"
_REMEDY = "open it in a browser and print it to a file there"


def find_browser() -> str:
    """Path of a browser that prints. Raises EngineMissing with the remedy if there is none."""
    found = next(filter(None, map(shutil.which, BROWSERS)), "")
    if found:
        return found
    raise EngineMissing(
        f"--pdf needs a browser of the Chromium family, and none of {', '.join(BROWSERS)} is on the PATH: install one, "
        "or open report.html in any browser and print it to a file there"
    )


def print_pdf(page: Path, target: Path) -> None:
    """Write ``target`` as the browser prints ``page``.

    Raises EngineMissing without a browser or if it prints nothing, InputError if ``target`` exists and is no PDF.
    """
    browser = find_browser()
    if target.exists() and (not target.is_file() or target.read_bytes()[:4] != _BEGIN):
        raise InputError(f"{target} exists and is no PDF: move it away, and run the same again")
    with scratch_folder() as scratch, replacing(target) as temporary:
        made = scratch / "report.pdf"
        command = [browser, "--headless", "--disable-gpu", "--no-first-run", f"--user-data-dir={scratch}/profile"]
        command.append("--no-pdf-header-footer")
        if hasattr(os, "geteuid") and os.geteuid() == 0:  # Chromium refuses its sandbox to root
            command.append("--no-sandbox")
        command += [f"--print-to-pdf={made}", page.resolve().as_uri()]
        try:
            done = subprocess.run(command, capture_output=True, timeout=120.0, check=False)
        except (OSError, subprocess.TimeoutExpired) as error:
            raise EngineMissing(f"{browser} did not print {page.name} ({error}): {_REMEDY}") from None
        if not made.is_file() or made.read_bytes()[:4] != _BEGIN:
            raise EngineMissing(f"{browser} did not print {page.name} (exit code {done.returncode}): {_REMEDY}")
        shutil.copyfile(made, temporary)
