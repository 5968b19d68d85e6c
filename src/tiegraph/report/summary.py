"""The report in words: the verdict, the numbers at the top, the tables of registered images; points to check before
using the products; and every image, whether it is used, and if not why.
"""

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Any

import numpy as np
from markupsafe import Markup

from tiegraph.report import accuracy, formatting
from tiegraph.report.formatting import Table, count, is_number
from tiegraph.report.network import FEW_TIES, is_matched, tied, ties
from tiegraph.report.parts import about, contradictions, section_name
from tiegraph.report.runfolder import STAGES, RunFolder
from tiegraph.report.texts import capital, many, said, t
from tiegraph.scene.colmapmodel import BY_RIG

GOOD_SHARE, POOR_SHARE = 0.95, 0.6  # of the images registered


@dataclass(frozen=True)
class Verdict:
    """The box at the top: level good, check, doubtful, poor or open; sentences; contradictions; warnings."""

    level: str
    headline: str
    sentences: tuple[str, ...]
    warnings: tuple[str, ...]
    contradictions: tuple[str, ...] = ()


def verdict(run: RunFolder) -> Verdict:
    """The result in plain words, from the existing data."""
    found = contradictions(run)
    if run.model is None or run.scene is None:
        last = [s for s in STAGES if run.done(s) and s != "report"]
        stop = t("The run has finished the stage {}.", last[-1]) if last else t("No stage has finished.")
        lost = any("lost" in r for r in run.receipts.values())
        level, headline = ("poor", "No model could be made of the images") if lost else ("open", "No model yet")
        sentences = [stop, _pairs_sentence(run)]
    else:
        level, headline = _level(run, found)
        known = accuracy.sentences(run.accuracy) if run.accuracy is not None else []
        if run.accuracy is None and run.done("georef"):
            known = [t("Its accuracy has not been evaluated yet.")]
        sentences = [*known, _registered_sentence(run), _world_sentence(run), *georeference_sentences(run.world or {})]
    headline = t(headline, about(found)) if level == "doubtful" else t(headline)
    told = tuple(s for s in sentences if s)
    return Verdict(level=level, headline=headline, sentences=told, warnings=tuple(warnings(run)), contradictions=found)


def _level(run: RunFolder, found: tuple[str, ...]) -> tuple[str, str]:
    assert run.model is not None
    share = float(np.mean(run.model.images.registered)) if len(run.model.images.registered) else 0.0
    answer = run.accuracy.answer if run.accuracy is not None else None
    unplaced = run.done("georef") and not run.georeferenced
    if share < POOR_SHARE:
        return "poor", "A large part of the survey is missing"
    if found:
        return "doubtful", "The survey contradicts itself: {}"
    if share < GOOD_SHARE or run.model.others or unplaced or weak_placement(run):
        return "check", "The survey is usable with care"
    if answer is not None and answer.said != "yes":
        return "check", "The survey is usable with care"
    return "good", "The survey is complete"


def _pairs_sentence(run: RunFolder) -> str:
    if run.pairs is None or run.scene is None or len(run.scene) < 2:
        return ""
    kept, n = int(np.sum(run.pairs.dropped == 0)), len(run.scene)
    text = "{} of {} possible pairs of {} images are to be matched."
    return t(text, *map(count, (kept, n * (n - 1) // 2, n)))


def _registered_sentence(run: RunFolder) -> str:
    assert run.model is not None
    registered, total = int(run.model.images.registered.sum()), len(run.model.images.registered)
    by_rig, (hanging, posed) = int(run.model.images.by_rig.sum()), run.hanging
    more = rest = ""
    if by_rig:
        text = "; the pose of {} more comes from the rig, because fewer than {} points are seen"
        more = t(text, count(by_rig), run.model.images.min_points)
    if hanging:
        text = "; {} images of other cameras have no pose, because the scale is unknown"
        text = "; {} images of other cameras have poses by the rig" if posed else text
        more += t(text, count(posed or hanging))
    if run.model.others:
        others = ", ".join(map(count, run.model.others[:4])) + (" ..." if len(run.model.others) > 4 else "")
        text = ", the largest of {}; the others have {} images and are not in the products"
        rest = t(text, len(run.model.others) + 1, others)
    share = formatting.percent(registered / max(total, 1))
    text = "{} of {} images ({}) are registered in one connected model{}{}."
    return t(text, count(registered), count(total), share, more, rest)


def _world_sentence(run: RunFolder) -> str:
    world = run.world or {}
    scale = source_text(world.get("scale_from"))
    if not run.georeferenced and world.get("placed"):
        text = "It lies in the frame of {}, which is not tied to the Earth."
        return t(text, scale or t("the given positions"))
    if not run.georeferenced:
        based = t(", with the scale from {}", scale) if scale else t(" and without scale")
        return t("It is not georeferenced: coordinates are in the model's own frame{}.", based)
    prior = source_text(run.scene.prior) if run.scene is not None else ""
    come = ""
    if run.accuracy is not None and (world.get("accuracy") or {}).get("gcp"):
        come = t("; it is held there by {}", said(run.accuracy.held_by))
    elif prior and scale and prior != scale:
        come = t("; the position comes from {}, the scale from {}", prior, scale)
    elif scale:
        come = t("; position and scale come from {}", scale)
    text = t("It is georeferenced in {}{}.", crs_text(world.get("crs"), world.get("origin")), come)
    if run.shift.any():
        text += t(
            " The files of the cloud are in its coordinates; those of the model, to keep numbers short, in these minus "
            "({}, {}, {}) m.",
            *(f"{v:.0f}" for v in run.shift),
        )
    return text


def source_text(source: Any) -> str:
    """Sources of scale or position, in words; "" if there is none."""
    baselines = "the distances between the rig's cameras"
    names = {"gnss": "the GNSS positions", "exif": "the GPS positions in the images", "trajectory": "the trajectory",
             "rig baseline": baselines, "rig": baselines}  # fmt: skip
    name = names.get(str(source).lower())
    return "" if source in (None, "", "none") else t(name) if name else str(source)


def crs_text(crs: Any, origin: Any = None) -> str:
    """Code and name of a CRS; of a local frame its origin."""
    if str(crs).upper() == "ENU":
        at = [(origin or {}).get(k) for k in ("lat_deg", "lon_deg", "height_m")]
        place = t("its origin")
        if all(map(is_number, at)):
            figures = (f"{at[0]:.6f}", f"{at[1]:.6f}", f"{at[2]:.2f}")
            place = t("latitude {}°, longitude {}°, height {} m", *figures)
        return t("a local east-north-up frame about {} (WGS 84)", place)
    try:
        import pyproj

        return f"{crs} ({pyproj.CRS.from_user_input(crs).name})"
    except Exception:
        return str(crs)


def what_was_done(run: RunFolder) -> list[str]:
    """The survey and its results, in one or two sentences."""
    if run.scene is None:
        return []
    passes = len(run.scene.sequences)
    figures = count(len(run.scene)), count(run.scene.frames), passes
    out = [many(passes, "{} images of {} frames in {} pass", "{} images of {} frames in {} passes", *figures)]
    out = out if passes else [t("{} loose photographs", figures[0])]
    if run.model is not None:
        out.append(t("{} of them used in the model", formatting.percent(float(np.mean(run.model.images.registered)))))
    if run.cloud is not None:
        out.append(t("a cloud of {} points", count(run.cloud.count)))
    return out


def tiles(run: RunFolder) -> list[tuple[str, str]]:
    """(number, label) of the figures at the top."""
    out: list[tuple[str, str]] = [*accuracy.tiles(run.accuracy)] if run.accuracy is not None else []
    if run.scene is not None and run.model is None:
        out.append((count(len(run.scene)), t("images")))
    if run.model is not None:
        registered = run.model.images.registered
        out.append((f"{int(registered.sum())} / {len(registered)}", t("registered images")))
    if run.pairs is not None:
        label = t("verified pairs") if is_matched(run.pairs) else t("pairs to match")
        out.append((count(len(tied(run.pairs))), label))
    if run.model is not None:
        out.append((count(run.model.points), t("sparse points")))
        if run.model.reprojection_px > 0:
            out.append((f"{formatting.number(run.model.reprojection_px, 2)} px", t("mean reprojection error")))
    if run.cloud is not None:
        out.append((count(run.cloud.count), t("points in the cloud")))
    total = sum(r.get("seconds") or 0 for r in run.receipts.values())
    return [*out, (formatting.seconds(total), t("computing time"))] if total else out


def metric_values(run: RunFolder) -> dict[str, float]:
    """name -> value of the known figures of merit."""
    found = (run.metrics or {}).get("metrics") or []
    return {m["name"]: m["value"] for m in found if isinstance(m, dict) and is_number(m.get("value"))}


def registered_tables(run: RunFolder) -> list[Table]:
    """Registered of all images: a matrix of passes and cameras, and by section; those posed by their rig beside."""
    if run.scene is None or run.model is None:
        return []
    scene, registered, by_rig = run.scene, run.model.images.registered, run.model.images.by_rig
    of_pass, of_camera = np.array(scene.image_label()).reshape(-1, 2).T
    every = np.ones(len(scene), bool)
    passes = {p or t("(loose)"): of_pass == p for p in (*scene.sequences, "") if np.any(of_pass == p)}
    parts = {**(passes if len(passes) > 1 else {}), t("all images"): every}
    cameras = {c: of_camera == c for c in dict.fromkeys(of_camera.tolist())}
    rows = []
    for name, own in {**cameras, t("all cameras"): every}.items():
        some = ((int(registered[own & part].sum()), int((own & part).sum())) for part in parts.values())
        cells = (t("{} of {}", *pair) if pair[1] else formatting.NONE for pair in some)
        rows.append((name, *cells, count(int(by_rig[own].sum()))))
    columns = (t("camera"), *parts, said(BY_RIG))
    numeric = (False, *[True] * (len(columns) - 1))
    out = [Table(columns=columns, rows=tuple(rows), numeric=numeric, title=t("Registered images"))]
    sections = scene.section[scene.frame]
    if len(np.unique(sections)) > 1:
        body = []
        for s in np.unique(sections):
            sums = (count(int(what[sections == s].sum())) for what in (registered, by_rig, every))
            body.append((section_name(run, int(s)), *sums))
        columns = (t("section"), t("registered"), said(BY_RIG), t("images"))
        out.append(Table(columns=columns, rows=tuple(body), numeric=(False, True, True, True), title=t("By section")))
    return out


def georeference_sentences(world: dict[str, Any]) -> list[str]:
    """In words: the reference of the heights, the lever arm of the antenna, and whether the model was adjusted."""
    out = []
    if world.get("vertical") and world.get("placed"):
        out.append(t("{}.", capital(said(str(world["vertical"])))))
    arm = world.get("antenna_m")
    if world.get("placed") and isinstance(arm, list) and len(arm) == 3:
        given = ", ".join(f"{v:.2f}" for v in arm)
        out.append(t("The lever arm of the GNSS antenna is {} m in the frame of the rig's first camera.", given))
    if world.get("adjusted"):
        text = "The model was adjusted together with its positions, not only shifted to them."
        if (world.get("accuracy") or {}).get("gcp"):
            text = "The model was adjusted together with its positions and control points, not only shifted to them."
        out.append(t(text))
    return out


_WEAK = {"yaw_deg": 1.0, "tilt_deg": 1.0, "scale": 0.01}


def warnings(run: RunFolder) -> list[str]:
    """Points to check before using the products, the worst first."""
    return [text for _, text in sorted(_ranked(run), key=lambda row: row[0])]


def _ranked(run: RunFolder) -> Iterator[tuple[int, str]]:
    """(rank, sentence): 0 the products are not whole, 1 they may be wrong as a whole, 2 in parts, 3 something lacks."""
    for stage, receipt in run.receipts.items():
        if not {"key", "lost"} & set(receipt) and stage != "report":
            yield 0, t("The stage {} was interrupted; run the same command again to finish it.", stage)
    if dropped := len(dropped_images(run)):
        one = "{} image file was not used; the reasons are listed below."
        yield 3, many(dropped, one, "{} image files were not used; the reasons are listed below.", count(dropped))
    if run.scene is not None and run.model is not None:
        yield from _coverage_warnings(run)
    if run.pairs is not None and run.scene is not None and np.any(run.pairs.inliers >= 0):
        if few := int(np.sum(ties(run.pairs, len(run.scene)) < FEW_TIES)):
            one = "{} image has fewer than {} verified ties to other images."
            yield 3, many(few, one, "{} images have fewer than {} verified ties to other images.", count(few), FEW_TIES)
    if run.done("georef") and not run.georeferenced and not (run.world or {}).get("placed"):
        text = "The model is not georeferenced: positions of the images (GNSS) give coordinates on the Earth."
        yield 1, t(text)
    if weak := weak_placement(run):
        yield 1, t("The placement in the world is weak: {}. More or better positions along the way help.", weak)
    if run.accuracy is not None:
        held, fit = (run.accuracy.figure(f"world.{name}").measured for name in ("held_out", "positions"))
        if held > 2.0 * fit:  # held-out positions this much worse than those used: the model bends to its control
            text = "Positions held back from the fit are met far worse than those used: the model bends to its control."
            yield 1, t(text)


def _coverage_warnings(run: RunFolder) -> Iterator[tuple[int, str]]:
    assert run.scene is not None and run.model is not None
    if run.model.others:
        text = "The images fell into {} separate models: the parts do not share enough ties."
        yield 0, t(text, len(run.model.others) + 1)
    few = run.counts("sparse").get("on_few_points")
    if is_number(few) and few:
        rest = "on few points (named in the remarks of sparse): these images may be off by more than is stated."
        one, several = f"The place of {{}} frame rests {rest}", f"The places of {{}} frames rest {rest}"
        yield 2, many(few, one, several, count(few))
    registered = run.model.images.registered
    several_passes = len(run.scene.sequences) > 1
    labels = np.array([" ".join(x).strip() if several_passes else x[1] for x in run.scene.image_label()])
    for label in dict.fromkeys(labels):
        of = labels == label
        if label and np.mean(registered[of]) < 0.5:
            by_rig = int(run.model.images.by_rig[of].sum())
            more = t("; {} more have poses by their rig.", by_rig) if by_rig else t(".")
            text = "Of {} only {} of {} images are registered{}"
            yield 2, t(text, str(label), int(registered[of].sum()), int(of.sum()), more)


def weak_placement(run: RunFolder) -> str:
    """Poorly known components of the placement in the world, in words; "" if none."""
    if run.accuracy is None:
        return ""
    weak = [name for name, limit in _WEAK.items() if run.accuracy.placement.get(name, 0.0) > limit]
    return Markup(t(", ")).join(accuracy.placement_part(run.accuracy, name) for name in weak)


def dropped_images(run: RunFolder) -> list[tuple[str, str]]:
    """Files left out by the scan, with reasons."""
    own = [] if run.scene is None else [(d.name, d.reason) for d in run.scene.dropped]
    return own or run.dropped("scan")


REGISTERED, ABSENT, LEFT_OUT = "registered", "not in the model", "left out by the scan"
HANGING = "hangs on the rig"  # no part of structure from motion (``scene.composed``)
STATES = (REGISTERED, BY_RIG, HANGING, ABSENT, LEFT_OUT)


@dataclass(frozen=True)
class ImageRow:
    """One image: ``state`` is one of ``STATES``; ``reason``: why it is not used, or gives no depth map, "" if it is;
    points it sees, verified pairs (None = not known), size of a pixel on the surface in units of the world, NaN."""

    name: str
    state: str
    reason: str = ""
    points: int | None = None
    ties: int | None = None
    gsd: float = float("nan")


def image_rows(run: RunFolder) -> list[ImageRow]:
    """Those that are not used first, each group by name; [] where no model was made."""
    m = run.model
    if run.scene is None or m is None:
        return []
    out = [ImageRow(name, LEFT_OUT, reason) for name, reason in dropped_images(run)]
    sparse, georef, dense = (dict(run.dropped(stage)) for stage in ("sparse", "georef", "dense"))
    pairs = ties(run.pairs, len(run.scene)).tolist() if run.pairs is not None else [None] * len(run.scene)
    for k, name in enumerate(run.scene.names):
        state = REGISTERED if m.images.registered[k] else BY_RIG if m.images.by_rig[k] else ABSENT
        points, known = int(m.images.points[k]), [found[name] for found in (sparse, georef) if name in found]
        if state == BY_RIG:
            known = known or [f"sees {points} points that agree, fewer than {m.images.min_points}"]
        if state == ABSENT:
            known = known or ["no reason was recorded"]
        known += [f"no depth map: {dense[name]}"] if name in dense else []
        gsd = float(m.gsd[k])
        out.append(ImageRow(name=name, state=state, reason="; ".join(known), points=points, ties=pairs[k], gsd=gsd))
    nowhere = "no wide image of its frame has a place" if run.hanging[1] else "nothing tells the scale"
    for name, posed in run.hung:  # it stands where the rig places it, or has no place
        state, reason = (HANGING, "") if posed else (ABSENT, f"hangs on the rig, but {nowhere}")
        out.append(ImageRow(name, state, f"no depth map: {dense[name]}" if posed and name in dense else reason))
    order = (LEFT_OUT, ABSENT, BY_RIG, HANGING, REGISTERED)
    return sorted(out, key=lambda row: order.index(row.state))
