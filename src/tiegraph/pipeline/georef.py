"""Glue of the engine ``sfm``: the verified pairs become models (sparse), the models are placed in the world with all
measurements there (georef); and the predicted accuracy of a run."""

from collections.abc import Mapping
from dataclasses import replace
from pathlib import Path

import numpy as np

from tiegraph.child import run_in_child
from tiegraph.errors import ChildDied, InputError, ReconstructionError, UnreadableArtefact
from tiegraph.evaluate.accuracy import Hold, Predicted, Stated
from tiegraph.geometry import transforms
from tiegraph.geometry.geodesy import world_from_geodetic
from tiegraph.geometry.transforms import rms_length
from tiegraph.pipeline import files
from tiegraph.pipeline.features import dim_images, with_contrast
from tiegraph.pipeline.inputs import control_file, orientations, target_marks
from tiegraph.project.run import Run
from tiegraph.project.stages import Outcome, save_json
from tiegraph.scan.priors.startmodel import read_start
from tiegraph.scan.priors.trajectory import images_by_name
from tiegraph.scene import evidence
from tiegraph.scene.atomic import claim, remove
from tiegraph.scene.colmapmodel import image_poses, model_centres, tracks
from tiegraph.scene.composed import carries, with_hanging
from tiegraph.scene.control import locate, locate_bars
from tiegraph.scene.gnss import read_gnss
from tiegraph.scene.gnss.fixes import moved_within, on_clock_of, step_of
from tiegraph.scene.scene import Scene
from tiegraph.sfm.covariance import MOUNTING
from tiegraph.sfm.mapper import Source, reconstruct
from tiegraph.sfm.mapping import believed_cameras
from tiegraph.sfm.rig.rig import rig_modes
from tiegraph.sfm.shape import SHAPE, Shape
from tiegraph.sfm.start import check_start, start_told
from tiegraph.sfm.world.fixes import Measurements, PositionRows
from tiegraph.sfm.world.georef import Georeference
from tiegraph.sfm.world.georeferencing import ConstantParameters, GeorefRequest, georeference_folders
from tiegraph.sfm.world.oneworld import OneWorld


def sparse(run: Run) -> Outcome:
    """The models, with the rig, by COLMAP's mappers."""

    def progress(registered: int, total: int) -> None:
        run.reporter.total(total, registered)

    scene, apart = files.checked(run), ()
    if run.settings.network.sections == "split":  # pairs between sections, which are mapped separately
        pairs, of_image = files.pairs_of(run, "match.npz"), scene.section[scene.frame]
        across = of_image[pairs.i] != of_image[pairs.j]
        apart = tuple(sorted(zip(pairs.i[across].tolist(), pairs.j[across].tolist())))
    database, start = run.path("database.db"), files.trusted_poses(run.folder)
    source = Source(database, run.path("images"), apart=apart, preview=start, on_progress=progress)
    settings, tuning = run.settings.sparse, run.settings.tuning
    try:
        made = reconstruct(source, run.path("sparse"), scene.measured(), settings, tuning.sfm, tuning.scene, run.log)
    except ReconstructionError as error:
        raise with_contrast(error, run, scene) from None
    counts = dict(made.counts)
    if made.shape is not None:
        files.save_npz(run.path("sparse", SHAPE), **vars(made.shape))
    if made.sigma is not None:
        counts |= {"position_sigma_median": made.sigma.median, "position_sigma_p90": made.sigma.p90}
        counts["position_sigma_largest"] = float(np.linalg.norm(made.sigma.sigma, axis=1).max())
        counts |= {} if made.sigma.scale is None else {"scale_sigma": made.sigma.scale}
    said, started = made.remarks, _against_start(run)
    counts |= started.counts
    notes, contradictions = (*said.notes, *started.notes), (*said.contradictions, *started.contradictions)
    dim = dim_images(run.folder, [name for name, _ in said.dropped], tuning.features)
    darker = "; it shows {:.1f} grey levels of contrast: more light, or nearer"
    dropped = tuple((name, why + (darker.format(dim[name]) if name in dim else "")) for name, why in said.dropped)
    return Outcome(counts, dropped=dropped, notes=notes, tables=made.tables, contradictions=contradictions)


def _against_start(run: Run) -> Outcome:
    if run.inputs.start is None:
        return Outcome({})
    scene, start = files.load_scene(run.path("scene.json")), read_start(run.inputs.start)
    model, tuning = files.load_model(run.path("sparse", "0")), run.settings.tuning.sfm.start_check
    sources = [scene.source_name(k) for k in range(len(scene))]
    names = list(start.poses)
    given = np.full((len(scene), 4, 4), np.nan)
    for k, row in images_by_name(names, start.path, sources).items():
        given[k] = start.poses[names[row]]
    made = transforms.invert(image_poses(model, scene))
    xyz, image, point = tracks(model, scene)
    reach = float(np.median(np.linalg.norm(xyz[point] - made[image, :3, 3], axis=1)))
    found = check_start(given, made, reach, tuning)
    text, contradicts = start_told(found, scene, tuning)
    counts = {"start_images": int(found.both.sum()), "start_disagrees": int(found.bad.sum())}
    return Outcome(counts, notes=() if contradicts else (text,), contradictions=(text,) if contradicts else ())


def georef(run: Run) -> Outcome:
    """The largest model into the world, and the others to it."""
    scene = files.checked(run).measured()
    receipt = run.receipts.read("sparse")
    sigma = receipt.get("counts", {})
    measured, said, unfit = _measured_in_images(run, scene)
    given = replace(
        measured,
        rows=_rows(run, scene),
        shape=Shape(**files.load_npz(path)) if (path := run.path("sparse", SHAPE)).exists() else None,
        model_scale_sigma=sigma.get("scale_sigma", float("nan")),
        firm_frames=sigma.get("frames", float("inf")) - sigma.get("on_few_points", 0),
    )
    folders = sorted((p for p in run.path("sparse").iterdir() if p.name.isdigit()), key=lambda p: int(p.name))
    scratch = run.path("sparse", ".world")
    remove(scratch)
    sparse = run.settings.sparse
    modes = rig_modes(scene, sparse.rig)
    rigs = tuple(k + 1 for k, mode in modes.items() if mode == "fixed")
    soft = tuple(k for k, mode in modes.items() if mode == "soft")
    held = ConstantParameters(rigs, believed_cameras(scene, sparse), soft)
    tuning = run.settings.tuning.sfm
    request = GeorefRequest(
        folders=tuple(folders),
        target=scratch,
        scene=scene.to_json(),
        settings=run.settings.georef,
        measurements=given,
        constant=held,
        tuning=tuning,
        database=run.path("database.db"),
    )
    found, missing = _georeferenced(run, request)
    main, notes = found.first, [*found.notes(), *said, *([] if tuning.placement.ties.trials else found.by_hand())]
    world = main.to_dict()
    if (shape := main.uncertainty.shape) is not None:  # of the survey, not its place on the Earth
        world["model_sigma"] = shape.sizes()
        world["between_frames"] = [row[:2] for row in shape.between(tuning.sigma.between_pairs)]  # apart, sigma
    hanging, said_of_them = _hang(run, scratch, main.scale_source)
    notes += said_of_them
    remove(run.path("sparse", "world"))
    claim(run.path("sparse", "world"))
    scratch.rename(run.path("sparse", "world"))
    save_json(run.path("world.json"), {**world, "models": found.records(), "notes": notes})
    tables = {**_tables(main), **_mounting(receipt, main), **found.table()}
    contradictions = (*unfit, *main.findings.contradictions, *found.contradictions, *missing)
    counts = {
        **main.counts(),
        "models": 1 + sum(bool(o.by) for o in found.others),
        "contradictions": len(contradictions),
        **({"hanging": hanging} if said_of_them else {}),
    }
    return Outcome(counts, notes=tuple(notes), tables=tables, contradictions=contradictions)


def _hang(run: Run, folder: Path, scale_source: str) -> tuple[int, list[str]]:
    """Add the images with poses by their rig to the model in a folder; how many have a pose now, and notes."""
    if not run.path("whole.json").exists():
        return 0, []
    survey = files.whole(run)
    count = int((~carries(survey)).sum())
    if scale_source == "none":
        return 0, [
            f"{count} images that depend on their rig have no pose in the model: its scale is unknown (positions, "
            "control points, scale bars, a second wide camera); `tiegraph shots --posed` takes them from the shots"
        ]
    model = files.load_model(folder)
    hung = with_hanging(model, survey)
    hung.write(folder)
    more = hung.num_reg_images() - model.num_reg_images()
    return more, [f"{more} of {count} images that depend on their rig have poses by it"]


def _georeferenced(run: Run, request: GeorefRequest) -> tuple[OneWorld, tuple[str, ...]]:
    """The models in one world; once more by similarities alone if that ends its process, with a note."""
    try:
        return run_in_child(georeference_folders, request, log=run.log, task="georeferencing"), ()
    except ChildDied as error:
        remove(request.target)
        plain = replace(request, settings=request.settings.model_copy(update={"adjust": "no"}))
        found = run_in_child(georeference_folders, plain, log=run.log, task="georeferencing")
        return found, (f"not adjusted with the measurements in the world: {str(error).splitlines()[0]}",)


def _measured_in_images(run: Run, scene: Scene) -> tuple[Measurements, tuple[str, ...], tuple[str, ...]]:
    """Control points and scale bars of the settings with their marks, those of coded targets found by the cameras of
    the largest model; notes on the search, and contradictions, if the file does not fit the images: then nothing."""
    file = control_file(run)
    if file is None:
        return Measurements(), (), ()
    model = files.load_model(run.path("sparse", "0")) if file.targets else None
    try:
        marks, notes = target_marks(run, scene, file, model)
        turned = orientations(run, scene, file)
        crs, heights = run.settings.scan.crs, run.settings.scan.heights_m
        control = locate(file, scene, crs, marks, turned, heights) if file.points else None
        return Measurements(control=control, bars=locate_bars(file, scene, marks, turned)), notes, ()
    except UnreadableArtefact:
        raise
    except InputError as error:
        return Measurements(), (), (f"no control point is used: {error}",)


def _rows(run: Run, scene: Scene) -> PositionRows | None:
    """All rows of a GNSS file with times: a receiver writes more often than cameras fire."""
    if scene.prior != "gnss" or scene.origin is None or run.inputs.gnss is None:
        return None
    gnss = read_gnss(run.inputs.gnss, run.settings.scan.heights_m)
    if gnss.names:
        return None
    gnss = on_clock_of(gnss, scene.time_s)
    world = world_from_geodetic(gnss.lat_lon_height, scene.origin)
    cut = moved_within(gnss.time_s, world, 0.0 if run.inputs.times is not None else step_of(scene.time_s))
    return PositionRows(gnss.time_s, world, np.hypot(gnss.sigma_m, cut))


def _tables(placed: Georeference) -> dict[str, dict]:
    """Statements of the sources; control and check points, one a row, and their accuracy."""
    said = {"evidence": evidence.table(placed.findings.statements)} if placed.findings.statements else {}
    if placed.control.bars:
        columns = ["from", "to", "role", "length m", "model m", "off mm", "sigma mm", "not used because"]
        said["scale bars"] = {"columns": columns, "rows": [list(row.values()) for row in placed.control.bars]}
    if not placed.control.rows:
        return said
    rows = []
    for point in placed.control.rows:
        off = point["off_m"] or [None, None, None]
        rows.append([point["name"], point["role"], point["marks"], *off, point["rms_px"], point["why_not"]])
    columns = ["point", "role", "marks", "dE m", "dN m", "dU m", "px", "not used because"]
    sums = [[role, *values.values()] for role, values in placed.control.accuracy.items()]
    heads = ["", "points", "east m", "north m", "up m", "plan m", "RMSE m", "CE90 m", "LE90 m", "predicted m"]
    out = {**said, "control and check points": {"columns": columns, "rows": rows}}
    return {**out, "accuracy of points (model minus survey)": {"columns": heads, "rows": sums}} if sums else out


def _mounting(receipt: dict, placed: Georeference) -> dict[str, dict]:
    """Lever arms of the cameras with their sigmas in metres, if the scale is known."""
    found = receipt.get("tables", {}).get(MOUNTING)
    if found is None or placed.scale_source == "none":
        return {}
    scale = placed.world_from_model.scale
    rows = [[row[0], *(round(scale * v, 5) for v in row[1:5]), round(row[5], 4)] for row in found["rows"]]
    columns = ["camera", "x m", "y m", "z m", "sigma m", "sigma of the rotation deg"]
    return {"lever arms of the cameras, in the frame of the first": {"columns": columns, "rows": rows}}


_CARRIER_M = 0.1  # positions stated to this are of a carrier phase (RTK, PPK): code alone gives a metre
_SOURCES = {"gnss": "GNSS positions", "exif": "the images' GPS positions", "trajectory": "the trajectory's positions"}


def stated(run: Run, points: Mapping[str, float]) -> Stated:
    """All of it; ``points``: counts of the sigmas of points in the cloud's receipt."""
    world = files.load_json(run.path("world.json"))
    predicted = _predicted(run, world, points)
    return Stated(predicted=predicted, hold=_hold(run, world), world=world)


def _predicted(run: Run, world: dict, points: Mapping[str, float]) -> Predicted:
    sigma, inside = world.get("sigma") or {}, world.get("model_sigma") or {}
    half, most = inside.get("median", np.nan), inside.get("p90", np.nan)
    scale = sigma.get("scale", np.nan)
    if not sigma and world["scale_source"] != "none":  # not placed: only the rig determines its size
        rows = world.get("evidence", {}).get("rows", [])
        scale = next((row[3] for row in rows if row[0] == "scale"), np.nan)
    model, error = files.load_model(run.path("sparse", "world")), files.placement_error(run.folder)
    centres = model_centres(model)
    return Predicted(
        inside_m=float(np.hypot(half, most) / np.sqrt(2)),
        scale=float(scale),
        spread_m=rms_length(centres - centres.mean(axis=0)),
        placed_m=np.nan if error is None else rms_length(error.sigma(centres)),
        point_m=points.get("sigma_median_m", np.nan),
        world_m=points.get("world_sigma_median_m", np.nan),
        world_90_m=points.get("world_sigma_p90_m", np.nan),
        between=np.array(world.get("between_frames") or []).reshape(-1, 2),
    )


def _hold(run: Run, world: dict) -> Hold:
    scene = files.checked(run)
    if not world["placed"]:
        return Hold(frames=scene.frames)
    rows = [row["frame"] for row in world["frames"] if row["inlier"]]
    source, stated_m = _SOURCES.get(scene.prior, "positions"), scene.position_sigma_m[rows]
    if scene.prior == "gnss" and np.isfinite(stated_m).any():
        source += " of RTK quality" if np.nanmedian(stated_m) <= _CARRIER_M else ""
    without = np.setdiff1d(np.arange(scene.frames), rows)
    sections = files.load_json(run.path("network", "sections.json"))
    bridges = [row["number"] for row in sections if row["kind"] == "bridge"]
    under = int(np.isin(scene.section[without], bridges).sum())
    found = [row["role"] for row in world["control"] if row["off_m"] is not None and not row["why_not"]]
    points = {"control": found.count("gcp"), "checks": found.count("check")}
    return Hold(source=source, positions=len(rows), frames=scene.frames, covered=under, **points)
