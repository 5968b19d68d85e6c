"""What the report says in words: the verdict, the numbers at the top, the warnings and the tables."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any

import numpy as np

from tiegraph.report import accuracy, formatting, georeference
from tiegraph.report.contradictions import about, contradictions
from tiegraph.report.formatting import Table, is_number
from tiegraph.report.runfolder import STAGES, RunFolder
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


@dataclass(frozen=True)
class Tile:
    """A number at the top."""

    value: str
    label: str


def verdict(run: RunFolder) -> Verdict:
    """The result in plain words, from what is there."""
    said = contradictions(run)
    if run.model is None or run.scene is None:
        last = [s for s in STAGES if run.done(s) and s != "report"]
        stop = f"The run has finished the stage {last[-1]}." if last else "No stage has finished."
        return Verdict(
            level="open",
            headline="No model yet",
            sentences=(stop, *_pairs_sentence(run)),
            warnings=tuple(warnings(run)),
            contradictions=said,
        )
    registered, total = int(run.model.registered.sum()), len(run.scene)
    share = registered / max(total, 1)
    answer = run.accuracy.answer if run.accuracy is not None else None
    unplaced = run.done("georef") and not run.georeferenced
    open_question = answer is not None and answer.said != "yes"
    serious = any((run.model.others, unplaced, weak_placement(run), open_question))
    level = "poor" if share < POOR_SHARE else "check" if share < GOOD_SHARE or serious else "good"
    level = "doubtful" if said and level != "poor" else level
    headline = {
        "doubtful": f"The survey contradicts itself: {about(said)}",
        "good": "The survey is complete",
        "check": "The survey is usable with care",
        "poor": "A large part of the survey is missing",
    }[level]
    of_world = georeference.sentences(run.world or {})
    said_of_model = (_registered_sentence(run, registered, total), _world_sentence(run), *of_world)
    sentences = (*_accuracy_sentences(run), *said_of_model)
    return Verdict(
        level=level,
        headline=headline,
        sentences=tuple(s for s in sentences if s),
        warnings=tuple(warnings(run)),
        contradictions=said,
    )


def _pairs_sentence(run: RunFolder) -> tuple[str, ...]:
    if run.pairs is None or run.scene is None:
        return ()
    kept, n = int(np.sum(run.pairs.dropped == 0)), len(run.scene)
    every = n * (n - 1) // 2
    text = (
        f"{formatting.count(kept)} of {formatting.count(every)} possible pairs of {formatting.count(n)} images are to "
        f"be matched."
    )
    return (text,) if every else ()


def _registered_sentence(run: RunFolder, registered: int, total: int) -> str:
    assert run.model is not None
    share = formatting.percent(registered / max(total, 1))
    text = (
        f"{formatting.count(registered)} of {formatting.count(total)} images ({share}) are registered in one "
        f"connected model"
    )
    by_rig = int(run.model.by_rig.sum())
    if by_rig:
        text += (
            f"; the place of {formatting.count(by_rig)} more rests on the rig, for fewer than "
            f"{run.model.images.min_points} points are seen"
        )
    if not run.model.others:
        return text + "."
    rest = ", ".join(map(formatting.count, run.model.others[:4])) + (" ..." if len(run.model.others) > 4 else "")
    several = len(run.model.others) + 1
    return text + f", the largest of {several}; the others have {rest} images and are not in the products."


def _world_sentence(run: RunFolder) -> str:
    world = run.world or {}
    scale = source_text(world.get("scale_from"))
    if not run.georeferenced and world.get("placed"):
        return f"It lies in the frame of {scale or 'the given positions'}, which is not tied to the Earth."
    if not run.georeferenced:
        based = f", with the scale from {scale}" if scale else " and without scale"
        return f"It is not georeferenced: coordinates are in the model's own frame{based}."
    text = f"It is georeferenced in {crs_text(world.get('crs'), world.get('origin'))}"
    prior = source_text(run.scene.prior) if run.scene is not None else ""
    if prior and scale and prior != scale:
        text += f"; the position comes from {prior}, the scale from {scale}."
    else:
        text += f"; position and scale come from {scale}." if scale else "."
    shift = world.get("shift_m") or [0, 0, 0]
    if any(shift):
        east, north, up = (f"{v:.0f}" for v in shift)
        text += " The files of the cloud are in its coordinates; those of the model, to keep numbers short, in these "
        text += f"minus ({east}, {north}, {up}) m."
    return text


def source_text(source: Any) -> str:
    """Where scale or position come from, in words; "" if from nowhere."""
    names = {"gnss": "the GNSS positions", "exif": "the GPS positions in the images", "trajectory": "the trajectory"}
    names["rig baseline"] = names["rig"] = "the distances between the rig's cameras"
    return "" if source in (None, "", "none") else names.get(str(source).lower(), str(source))


def crs_text(crs: Any, origin: Any = None) -> str:
    """Code and name of a CRS; of a local frame its origin."""
    if str(crs).upper() == "ENU":
        at = [(origin or {}).get(k) for k in ("lat_deg", "lon_deg", "height_m")]
        place = "its origin"
        if all(map(is_number, at)):
            place = f"latitude {at[0]:.6f}°, longitude {at[1]:.6f}°, height {at[2]:.2f} m"
        return f"a local east-north-up frame about {place} (WGS 84)"
    try:
        import pyproj

        return f"{crs} ({pyproj.CRS.from_user_input(crs).name})"
    except Exception:
        return str(crs)


def _accuracy_sentences(run: RunFolder) -> list[str]:
    if run.accuracy is not None:
        return [*accuracy.sentences(run.accuracy)]
    return ["How good it is has not been evaluated yet: `tiegraph evaluate` says so."] if run.done("georef") else []


def tiles(run: RunFolder) -> list[Tile]:
    """The numbers at the top."""
    out = [Tile(*t) for t in accuracy.tiles(run.accuracy)] if run.accuracy is not None else []
    if run.scene is not None:
        n = len(run.scene)
        used = f"{int(run.model.registered.sum())} / {n}" if run.model is not None else formatting.count(n)
        out.append(Tile(used, "registered images" if run.model is not None else "images"))
    if run.pairs is not None:
        kept = run.pairs.kept()
        matched = bool(np.any(kept.inliers >= 0))
        amount = int(np.sum(kept.inliers > 0)) if matched else len(kept)
        out.append(Tile(formatting.count(amount), "verified pairs" if matched else "pairs to match"))
    if run.model is not None:
        out.append(Tile(formatting.count(run.model.figures.points), "sparse points"))
        if run.model.figures.reprojection_px > 0:
            out.append(Tile(f"{formatting.number(run.model.figures.reprojection_px, 2)} px", "mean reprojection error"))
    if run.cloud is not None:
        out.append(Tile(formatting.count(run.cloud.count), "points in the cloud"))
    total = sum(r.get("seconds") or 0 for r in run.receipts.values())
    if total:
        out.append(Tile(formatting.seconds(total), "computing time"))
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
        row: list[Any] = [camera if camera is not None else "all cameras"]
        for track in [*passes, None] if len(passes) > 1 else [None]:
            of = np.ones(len(scene), bool)
            of &= names[:, 1] == camera if camera is not None else True
            of &= names[:, 0] == track if track is not None else True
            row.append(f"{int(registered[of].sum())} of {int(of.sum())}" if of.any() else formatting.NONE)
        rows.append(row)
    for row, camera in zip(rows, [*cameras, None]):
        of = run.model.by_rig & (names[:, 1] == camera if camera is not None else True)
        row.append(formatting.count(int(of.sum())))
    columns = ["camera", *([p or "(loose)" for p in passes] if len(passes) > 1 else []), "all images"]
    columns.append(BY_RIG)
    out = [
        Table(
            columns=tuple(columns),
            rows=tuple(map(tuple, rows)),
            numeric=(False, *[True] * (len(columns) - 1)),
            title="Registered images",
        )
    ]
    sections = scene.section[scene.frame]
    if len(np.unique(sections)) > 1:
        body = []
        for s in np.unique(sections):
            of = sections == s
            count = formatting.count(int(of.sum()))
            by_rig = formatting.count(int(run.model.by_rig[of].sum()))
            body.append((str(s) if s >= 0 else "(none)", formatting.count(int(registered[of].sum())), by_rig, count))
        columns = ["section", "registered", BY_RIG, "images"]
        numeric = False, True, True, True
        out.append(Table(columns=tuple(columns), rows=tuple(body), numeric=numeric, title="By section"))
    return out


def stage_rows(run: RunFolder) -> list[tuple[str, float, float, float]]:
    """(stage, wall s, CPU s, peak MiB) of the stages that have finished."""
    out = []
    for stage in STAGES:
        r = run.receipts.get(stage, {})
        if is_number(r.get("seconds")):
            out.append((stage, float(r["seconds"]), float(r.get("cpu_s") or 0), float(r.get("peak_mib") or 0)))
    return out
