"""What the report says in words: the verdict, the numbers at the top, the warnings and the tables."""

from dataclasses import dataclass
from typing import Any

import numpy as np

from tiegraph.report import accuracy, formatting
from tiegraph.report.charts import is_matched, tied
from tiegraph.report.formatting import Table, is_number
from tiegraph.report.runfolder import STAGES, RunFolder
from tiegraph.report.tables import about, contradictions, section_name
from tiegraph.report.texts import many, said, t
from tiegraph.report.warnings import warnings, weak_placement
from tiegraph.scene.registered import BY_RIG

GOOD_SHARE, POOR_SHARE = 0.95, 0.6  # of the images registered


@dataclass(frozen=True)
class Verdict:
    """The box at the top: level good, check, doubtful, poor or open; sentences; what contradicts what; warnings."""

    level: str
    headline: str
    sentences: tuple[str, ...]
    warnings: tuple[str, ...]
    contradictions: tuple[str, ...] = ()


def verdict(run: RunFolder) -> Verdict:
    """The result in plain words, from what is there."""
    found = contradictions(run)
    if run.model is None or run.scene is None:
        last = [s for s in STAGES if run.done(s) and s != "report"]
        stop = t("The run has finished the stage {}.", last[-1]) if last else t("No stage has finished.")
        lost = any("lost" in r for r in run.receipts.values())
        return Verdict(
            level="poor" if lost else "open",
            headline=t("No model could be made of the images") if lost else t("No model yet"),
            sentences=(stop, *_pairs_sentence(run)),
            warnings=tuple(warnings(run)),
            contradictions=found,
        )
    registered, total = int(run.model.registered.sum()), len(run.scene)
    share = registered / max(total, 1)
    answer = run.accuracy.answer if run.accuracy is not None else None
    unplaced = run.done("georef") and not run.georeferenced
    open_question = answer is not None and answer.said != "yes"
    serious = any((run.model.others, unplaced, weak_placement(run), open_question))
    level = "poor" if share < POOR_SHARE else "check" if share < GOOD_SHARE or serious else "good"
    level = "doubtful" if found and level != "poor" else level
    headline = {
        "doubtful": t("The survey contradicts itself: {}", about(found)),
        "good": t("The survey is complete"),
        "check": t("The survey is usable with care"),
        "poor": t("A large part of the survey is missing"),
    }[level]
    of_world = georeference_sentences(run.world or {})
    known = accuracy.sentences(run.accuracy) if run.accuracy is not None else []
    if run.accuracy is None and run.done("georef"):
        known = [t("How good it is has not been evaluated yet.")]
    sentences = (*known, _registered_sentence(run, registered, total), _world_sentence(run), *of_world)
    return Verdict(
        level=level,
        headline=headline,
        sentences=tuple(s for s in sentences if s),
        warnings=tuple(warnings(run)),
        contradictions=found,
    )


def _pairs_sentence(run: RunFolder) -> tuple[str, ...]:
    if run.pairs is None or run.scene is None:
        return ()
    kept, n = int(np.sum(run.pairs.dropped == 0)), len(run.scene)
    every = n * (n - 1) // 2
    text = "{} of {} possible pairs of {} images are to be matched."
    return (t(text, *map(formatting.count, (kept, every, n))),) if every else ()


def _registered_sentence(run: RunFolder, registered: int, total: int) -> str:
    assert run.model is not None
    figures = formatting.count(registered), formatting.count(total), formatting.percent(registered / max(total, 1))
    by_rig = int(run.model.by_rig.sum())
    more = rest = ""
    if by_rig:
        text = "; the place of {} more rests on the rig, for fewer than {} points are seen"
        more = t(text, formatting.count(by_rig), run.model.images.min_points)
    hanging, posed = run.hanging
    if hanging and posed:
        text = "; {} images of other cameras hang on the rig and stand where it places them"
        more += t(text, formatting.count(posed))
    elif hanging:
        text = "; {} images of other cameras hang on the rig and have no place, for nothing tells the scale"
        more += t(text, formatting.count(hanging))
    if run.model.others:
        others = ", ".join(map(formatting.count, run.model.others[:4])) + (" ..." if len(run.model.others) > 4 else "")
        text = ", the largest of {}; the others have {} images and are not in the products"
        rest = t(text, len(run.model.others) + 1, others)
    return t("{} of {} images ({}) are registered in one connected model{}{}.", *figures, more, rest)


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
    if run.accuracy is not None and ((run.world or {}).get("accuracy") or {}).get("gcp"):
        come = t("; it is held there by {}", said(run.accuracy.held_by))
    elif prior and scale and prior != scale:
        come = t("; the position comes from {}, the scale from {}", prior, scale)
    elif scale:
        come = t("; position and scale come from {}", scale)
    text = t("It is georeferenced in {}{}.", crs_text(world.get("crs"), world.get("origin")), come)
    shift = world.get("shift_m") or [0, 0, 0]
    if any(shift):
        text += t(
            " The files of the cloud are in its coordinates; those of the model, to keep numbers short, in these minus "
            "({}, {}, {}) m.",
            *(f"{v:.0f}" for v in shift),
        )
    return text


def source_text(source: Any) -> str:
    """Where scale or position come from, in words; "" if from nowhere."""
    names = {"gnss": t("the GNSS positions"), "exif": t("the GPS positions in the images")}
    names["trajectory"] = t("the trajectory")
    names["rig baseline"] = names["rig"] = t("the distances between the rig's cameras")
    return "" if source in (None, "", "none") else names.get(str(source).lower(), str(source))


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
    """What was surveyed and what came of it, in one or two sentences."""
    if run.scene is None:
        return []
    passes = max(len(run.scene.sequences), 1)
    figures = formatting.count(len(run.scene)), formatting.count(run.scene.frames), passes
    if run.scene.sequences:
        out = [many(passes, "{} images of {} frames in {} pass", "{} images of {} frames in {} passes", *figures)]
    else:
        out = [t("{} loose photographs", figures[0])]
    if run.model is not None:
        share = formatting.percent(float(np.mean(run.model.registered)))
        out.append(t("{} of them used in the model", share))
    if run.cloud is not None:
        out.append(t("a cloud of {} points", formatting.count(run.cloud.count)))
    return out


def tiles(run: RunFolder) -> list[tuple[str, str]]:
    """(number, label) of what stands at the top."""
    out: list[tuple[str, str]] = [*accuracy.tiles(run.accuracy)] if run.accuracy is not None else []
    if run.scene is not None:
        n = len(run.scene)
        used = f"{int(run.model.registered.sum())} / {n}" if run.model is not None else formatting.count(n)
        out.append((used, t("registered images") if run.model is not None else t("images")))
    if run.pairs is not None:
        label = t("verified pairs") if is_matched(run.pairs) else t("pairs to match")
        out.append((formatting.count(len(tied(run.pairs))), label))
    if run.model is not None:
        out.append((formatting.count(run.model.figures.points), t("sparse points")))
        if run.model.figures.reprojection_px > 0:
            error = formatting.number(run.model.figures.reprojection_px, 2)
            out.append((f"{error} px", t("mean reprojection error")))
    if run.cloud is not None:
        out.append((formatting.count(run.cloud.count), t("points in the cloud")))
    total = sum(r.get("seconds") or 0 for r in run.receipts.values())
    if total:
        out.append((formatting.seconds(total), t("computing time")))
    return out


def metric_values(run: RunFolder) -> dict[str, float]:
    """name -> value of the known figures of merit."""
    found = (run.metrics or {}).get("metrics") or []
    return {m["name"]: m["value"] for m in found if isinstance(m, dict) and is_number(m.get("value"))}


def registered_tables(run: RunFolder) -> list[Table]:
    """Registered of all images: a matrix of passes and cameras, and by section; those their rig places beside them."""
    if run.scene is None or run.model is None:
        return []
    scene, registered = run.scene, run.model.registered
    labels = scene.image_label()
    cameras = list(dict.fromkeys(c for _, c in labels))
    passes = [t for t in (*scene.sequences, "") if t in {p for p, _ in labels}]
    names = np.array(labels).reshape(-1, 2)
    rows = []
    for camera in [*cameras, None]:
        own = names[:, 1] == camera if camera is not None else np.ones(len(scene), bool)
        row = [camera if camera is not None else t("all cameras")]
        for track in [*passes, None] if len(passes) > 1 else [None]:
            of = own & (names[:, 0] == track if track is not None else True)
            row.append(t("{} of {}", int(registered[of].sum()), int(of.sum())) if of.any() else formatting.NONE)
        rows.append((*row, formatting.count(int(run.model.by_rig[own].sum()))))
    columns = [t("camera"), *([p or t("(loose)") for p in passes] if len(passes) > 1 else []), t("all images")]
    columns.append(said(BY_RIG))
    out = [
        Table(
            columns=tuple(columns),
            rows=tuple(rows),
            numeric=(False, *[True] * (len(columns) - 1)),
            title=t("Registered images"),
        )
    ]
    sections = scene.section[scene.frame]
    if len(np.unique(sections)) > 1:
        body = []
        for s in np.unique(sections):
            of = sections == s
            count = formatting.count(int(of.sum()))
            by_rig = formatting.count(int(run.model.by_rig[of].sum()))
            name = section_name(run, int(s))
            body.append((name, formatting.count(int(registered[of].sum())), by_rig, count))
        columns = [t("section"), t("registered"), said(BY_RIG), t("images")]
        numeric = False, True, True, True
        out.append(Table(columns=tuple(columns), rows=tuple(body), numeric=numeric, title=t("By section")))
    return out


def stage_rows(run: RunFolder) -> list[tuple[str, float, float, float]]:
    """(stage, wall s, CPU s, peak MiB) of the stages that have finished."""
    out = []
    for stage in STAGES:
        r = run.receipts.get(stage, {})
        if is_number(r.get("seconds")):
            out.append((stage, float(r["seconds"]), float(r.get("cpu_s") or 0), float(r.get("peak_mib") or 0)))
    return out


def georeference_sentences(world: dict[str, Any]) -> list[str]:
    """In words: what heights count from, the lever arm of the antenna, and whether the model was adjusted."""
    out = []
    if world.get("vertical") and world.get("placed"):
        text = said(str(world["vertical"]))
        out.append(t("{}.", text[0].upper() + text[1:]))
    arm = world.get("antenna_m")
    if world.get("placed") and isinstance(arm, list) and len(arm) == 3:
        given = ", ".join(f"{v:.2f}" for v in arm)
        out.append(t("The lever arm of the GNSS antenna is {} m in the frame of the rig's first camera.", given))
    if world.get("adjusted"):
        if (world.get("accuracy") or {}).get("gcp"):
            text = "The model was adjusted together with its positions and control points, not only shifted to them."
        else:
            text = "The model was adjusted together with its positions, not only shifted to them."
        out.append(t(text))
    return out
